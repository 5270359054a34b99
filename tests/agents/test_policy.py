"""Policy artefacts: what is exported acts as the model does, in NumPy and compiled alike; nothing else is loaded."""

import json
import re
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from safetensors.numpy import load, save
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

import kerfgym  # noqa: F401
from kerfgym.agents import policy as artefact
from kerfgym.agents.export import BOUND, export
from kerfgym.agents.network import Layer, Memory, Network, Normaliser, linear, logistic, run, tanh
from kerfgym.agents.policy import Policy
from kerfgym.agents.vec_env import ContourFollowingVecEnv, CuttingVecEnv, HeightFollowingVecEnv
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import gantry
from kerfgym.envs.tasks import workshop
from kerfgym.envs.tasks.batch import Batch
from kerfgym.envs.tasks.interface import FEATURES, TASK
from kerfgym.envs.tasks.job_interface import CONTOUR, CUTTING
from kerfgym.experiments.measure import cost, rollout, stability

torch.set_num_threads(1)
SEED, SIZE = 3, len(FEATURES)
SHORT = scenarios.load("wavy").varied(duration=0.4, settle=0.1)
SETTINGS = {
    PPO: {"n_steps": 8, "batch_size": 8, "policy_kwargs": {"net_arch": [16, 7]}},
    RecurrentPPO: {
        "n_steps": 8,
        "batch_size": 8,
        "policy_kwargs": {"lstm_hidden_size": 8, "n_lstm_layers": 2, "net_arch": [5]},
    },
    SAC: {"policy_kwargs": {"net_arch": [16, 16]}},
    TD3: {"policy_kwargs": {"net_arch": [16, 16]}},
    TQC: {"policy_kwargs": {"net_arch": [16, 16]}},
}


def model(kind, env, steps=0, **settings):
    """A small model that explores widely: the last layer's weights are large enough to move the head."""
    name = "MlpLstmPolicy" if kind is RecurrentPPO else "MlpPolicy"
    made = kind(name, env, device="cpu", seed=1, **{**SETTINGS[kind], **settings})
    if steps:
        made.learn(steps)
    last = made.policy.action_net if hasattr(made.policy, "action_net") else made.actor.mu
    last = last[-2] if isinstance(last, torch.nn.Sequential) else last
    with torch.no_grad():
        last.weight.normal_(0.0, 0.3, generator=torch.Generator().manual_seed(5))
    return made


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The artefact of a PPO for residual control."""
    place = tmp_path_factory.mktemp("ppo") / "policy"
    export(model(PPO, HeightFollowingVecEnv(2), 16), place, provenance={"command": "kerfgym train", "cpu_seconds": 1.5})
    return place


def loop(folder, env, seed=SEED, longest=400):
    """True gaps of an episode in the Gymnasium loop with the policy in NumPy, and the last observation."""
    policy, gaps, over = Policy.load(folder), [], False
    observation, _ = env.reset(options={"scenario_seed": seed})
    while not over and len(gaps) < longest:
        observation, _, terminated, truncated, info = env.step(policy.act(observation, start=not gaps))
        gaps.append(info["true_gap"])
        over = terminated or truncated
    return np.float32(gaps)


@pytest.mark.parametrize(
    ("kind", "settings", "wrap"),
    [
        (PPO, {"control": "residual"}, None),
        (SAC, {"control": "direct"}, None),
        (TD3, {"control": "residual", "base": "pid"}, None),
        (TQC, {"control": "schedule"}, None),
        (RecurrentPPO, {"control": "residual", "observation": "raw"}, "normalised"),
        (PPO, {"control": "schedule"}, "normalised, then stacked"),
        (PPO, {"control": "residual"}, "stacked, then normalised"),
    ],
)
def test_a_seed_gives_the_same_trajectory_in_the_gymnasium_loop_and_compiled(kind, settings, wrap, tmp_path):
    """Bit for bit: sums are taken in the same order."""
    env = HeightFollowingVecEnv(2, **settings)
    if wrap:
        env = {
            "normalised": VecNormalize,
            "normalised, then stacked": lambda e: VecFrameStack(VecNormalize(e), 3),
            "stacked, then normalised": lambda e: VecNormalize(VecFrameStack(e, 3)),
        }[wrap](env)
    exported = export(model(kind, env, 16 if "PPO" in kind.__name__ else 0), tmp_path, onnx=False)
    assert exported.difference <= BOUND
    assert exported.compared >= 800
    gaps = loop(tmp_path, gym.make("kerfgym/HeightFollowing-v0", scenario=SHORT, split="tune", **settings))
    record = rollout.roll(SHORT, stack.resolve(str(tmp_path)), [9, SEED, 4])
    np.testing.assert_array_equal(record["gap"][: len(gaps), 1], gaps)
    base = rollout.roll(SHORT, stack.resolve(settings.get("base", "xi2023-improved")), [SEED])
    assert np.abs(record["gap"][: len(gaps), 1] - base["gap"][: len(gaps), 0]).max() > 1e-4  # the policy does something


@pytest.mark.parametrize(
    ("name", "vec", "scenario", "control"),
    [
        ("ContourFollowing", ContourFollowingVecEnv, "contour-square", "residual"),
        ("Cutting", CuttingVecEnv, "cut-square", "residual"),
        ("Cutting", CuttingVecEnv, "cut-square", "direct"),
    ],
)
def test_a_policy_for_jobs_decides_compiled_as_it_does_in_the_gymnasium_loop(name, vec, scenario, control, tmp_path):
    export(model(PPO, vec(2, control=control)), tmp_path, onnx=False)
    moving = scenarios.load(scenario).varied(job={"pierce": False})
    env = gym.make(f"kerfgym/{name}-v0", scenario=moving, control=control, split="tune")
    policy, seen = Policy.load(tmp_path), []
    observation, _ = env.reset(options={"scenario_seed": SEED})
    for step in range(60):
        observation, _, over, _, info = env.step(policy.act(observation, start=step == 0))
        assert not over
        seen.append([info["x"], info["y"], info["contour_error"], info["gap_error"], info.get("frequency", 0.0)])
    team = stack.team(str(tmp_path))
    fleet = workshop.fleet_for(moving, team, [7, SEED])
    record = fleet.gantries.start_recording(480, fleet.tick)
    for periods in (100, 3, 377):  # decisions do not depend on how the periods are grouped
        fleet.advance(periods)
    channels = [gantry.CHANNELS.index(channel) for channel in ("x", "y", "error", "gap_error", "command_frequency")]
    np.testing.assert_array_equal(record[7::8, channels, 1], np.float32(seen))
    assert np.ptp(record[:, channels[:2], 1]) > 0.5  # mm: the axes move


def test_threads_change_nothing(folder):
    one, two = (rollout.roll(SHORT, stack.resolve(str(folder)), range(40), threads) for threads in (1, 2))
    np.testing.assert_array_equal(one["gap"], two["gap"])


def test_the_network_is_torchs():
    rng = np.random.default_rng(0)
    x = rng.normal(0, 2, (6, 5)).astype(np.float32)
    lstm = torch.nn.LSTM(5, 4)
    parts = {k: v.detach().numpy() for k, v in lstm.named_parameters()}
    weight = np.concatenate([parts["weight_ih_l0"], parts["weight_hh_l0"]], axis=1)
    network = Network(5, 1, None, (Layer("lstm", weight, parts["bias_ih_l0"] + parts["bias_hh_l0"]),), "clip")
    memory = Memory(network, 1)
    ours = np.concatenate([run(network, memory, row[None]) for row in x])
    theirs, _ = lstm(torch.from_numpy(x)[:, None])
    np.testing.assert_allclose(ours, theirs.detach().numpy()[:, 0], atol=3e-7)
    z = np.linspace(-30, 30, 4001, dtype=np.float32)
    np.testing.assert_allclose(tanh(z), np.tanh(z.astype(float)), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(logistic(z), 1 / (1 + np.exp(-z.astype(float))), rtol=1e-6)
    many = rng.normal(size=(9, 5)).astype(np.float32)
    singly = [linear(weight[:, :5], weight[:, 5], row[None])[0] for row in many]
    np.testing.assert_array_equal(linear(weight[:, :5], weight[:, 5], many), singly)


def test_the_onnx_graph_acts_as_the_policy_does(tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    rng = np.random.default_rng(1)

    def session(network_model, place):
        exported = export(network_model, place)
        return Policy.load(place), runtime.InferenceSession(exported.onnx.read_bytes())

    env = VecFrameStack(VecNormalize(HeightFollowingVecEnv(2)), 2)
    policy, graph = session(model(SAC, env), tmp_path / "sac")
    env.reset()
    seen = rng.normal(0, 0.3, (6, SIZE)).astype(np.float32)
    before = np.zeros(SIZE, np.float32)
    for i, row in enumerate(seen):
        (action,) = graph.run(["action"], {"observation": np.concatenate([before, row])[None]})
        np.testing.assert_allclose(action[0], policy.act(row, start=i == 0), atol=2e-6)
        before = row
    policy, graph = session(model(RecurrentPPO, HeightFollowingVecEnv(2)), tmp_path / "lstm")
    state = {f"{k}_{i}": np.zeros((1, 8), np.float32) for i in range(2) for k in ("hidden", "cell")}
    for i, row in enumerate(seen):
        names = ["action", *(f"next_{name}" for name in state)]
        action, *rest = graph.run(names, {"observation": row[None], **state})
        state = dict(zip(state, rest, strict=True))
        np.testing.assert_allclose(action[0], policy.act(row, start=i == 0), atol=2e-6)


def test_an_artefact_runs_where_torch_is_not_installed(folder):
    program = f"""
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "stable_baselines3", "sb3_contrib", "optuna", "onnx", "pickle5"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Blocked())
import gymnasium, kerfgym, numpy
from kerfgym.agents.policy import Policy
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.experiments.measure import rollout
folder = {str(folder)!r}
env = gymnasium.make("kerfgym/HeightFollowing-v0", split="tune", max_steps=50)
observation, info = env.reset(options={{"scenario_seed": {SEED}}})
policy = Policy.load(folder)
for step in range(50):
    observation, *_, info = env.step(policy.act(observation, start=step == 0))
record = rollout.roll(scenarios.load("wavy"), stack.resolve(folder), [{SEED}])
assert record["gap"][49, 0] == numpy.float32(info["true_gap"])
print("ran", record["gap"][49, 0])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout.startswith("ran"), done.stderr


def test_provenance_tells_where_a_policy_comes_from_and_what_was_spent(folder, tmp_path):
    found = Policy.load(folder).provenance
    assert found["algorithm"] == "PPO"
    assert (found["seed"], found["simulated_steps"]) == (1, 16)
    assert (found["command"], found["cpu_seconds"]) == ("kerfgym train", 1.5)
    assert found["versions"]["torch"] == torch.__version__.split("+")[0] or found["versions"]["torch"]
    tuned = stack.resolve("pid").provenance
    export(model(PPO, HeightFollowingVecEnv(1, base="pid"), 16), tmp_path, {"ledger": {"simulated_steps": 900}})
    spent = stack.resolve(str(tmp_path)).provenance
    assert spent["simulated_steps"] == 900 + tuned.get("simulated_steps", tuned.get("steps"))
    assert spent["trials"] == tuned["trials"]
    assert found["equivalence"]["largest_difference"] <= found["equivalence"]["bound"] == BOUND


# ------------------------------------------------------------------------------------------- as a controller


def test_a_policy_has_a_sensitivity_like_any_controller(tmp_path):
    """One that does nothing has its base's."""
    idle = model(PPO, HeightFollowingVecEnv(1, base="pid"))
    with torch.no_grad():
        idle.policy.action_net.weight.zero_()
        idle.policy.action_net.bias.zero_()
    export(idle, tmp_path / "idle", onnx=False)
    frequencies = np.array([5.0, 30.0])

    def measured(name):
        found = stack.resolve(name)
        return stability.Injection(found, frequencies, 0.2, 0.4).measure(found).magnitude

    np.testing.assert_array_equal(measured(str(tmp_path / "idle")), measured("pid"))
    active = model(PPO, HeightFollowingVecEnv(1, base="pid"))
    export(active, tmp_path / "active", onnx=False)
    assert np.abs(measured(str(tmp_path / "active")) - measured("pid")).max() > 1e-3


def test_its_decisions_cost_more_than_its_bases(folder):
    alone = cost.measure("xi2023-improved", 2000)
    assert cost.measure(str(folder), 2000).median_us > alone.median_us + 0.1


def test_its_base_can_be_varied_and_it_drives_the_slot_of_its_environment(folder):
    varied = stack.resolve(f"z={folder}:filter.window=5")
    assert varied.part("filter").window == 5
    assert varied.pilot is not None
    assert stack.resolve(str(folder)).program != stack.resolve("xi2023-improved").program
    with pytest.raises(InvalidInput, match="drives slot 'z'"):
        stack.resolve(f"process={folder}")


def test_it_can_follow_the_sheet_in_a_job_but_not_be_the_base_of_its_own_kind(folder, tmp_path):
    with pytest.raises(InvalidInput, match="is a policy"):
        Batch(TASK, 1, base=str(folder))
    job = Batch(CONTOUR, 1, base=f"z={folder}", split="tune")
    job.start(np.array([0]), np.array([SEED]))
    for _ in range(40):
        job.advance()
    plain = Batch(CONTOUR, 1, base="z=xi2023-improved", split="tune")
    plain.start(np.array([0]), np.array([SEED]))
    for _ in range(40):
        plain.advance()
    gaps = [b.info(0)["true_gap"] for b in (job, plain)]
    assert gaps[0] != gaps[1]
    export(model(PPO, CuttingVecEnv(1)), tmp_path, onnx=False)
    with pytest.raises(InvalidInput, match="is a policy"):
        Batch(CUTTING, 1, base=str(tmp_path))
    both = stack.team(f"z={folder},process={tmp_path}")
    fleet = workshop.fleet_for(scenarios.load("cut-square"), both, [SEED])
    fleet.advance(80)
    alone = workshop.fleet_for(scenarios.load("cut-square"), stack.team(f"process={tmp_path}"), [SEED])
    alone.advance(80)
    assert fleet.column("hand.residual")[0] != 0.0
    assert alone.column("hand.residual")[0] == 0.0
    assert fleet.gantries.column("hand.process.override")[0] != 0.0


# ---------------------------------------------------------------------------------------------- what is refused


def copy_of(folder, place, numbers=None, **changes):
    """A copy with other words in its document (dotted names, ``None`` takes one away), or other weights."""
    place.mkdir()
    document = json.loads((folder / "policy.json").read_text())
    document["sha256"] = ""
    data = numbers if numbers is not None else (folder / "weights.safetensors").read_bytes()
    for name, value in changes.items():
        *path, last = name.split("__")
        inner = document
        for key in path:
            inner = inner[int(key) if key.isdigit() else key]
        if value is None:
            del inner[last]
        else:
            inner[last] = value
    (place / "policy.json").write_text(json.dumps(document))
    (place / "weights.safetensors").write_bytes(data)
    return place


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"environment": "kerfgym/HeightFollowing-v1"}, "this version of kerfgym has kerfgym/HeightFollowing-v0"),
        ({"environment": "kerfgym/Heightfollow-v0"}, "did you mean 'kerfgym/HeightFollowing-v0'"),
        ({"environment": "kerfgym/Cutting-v0"}, "observation.shape is"),
        ({"version": 1}, "version 1 of environment"),
        ({"format": 2}, "format 2"),
        ({"control": "schedule"}, "action.shape is"),
        ({"observation__shape": [SIZE + 1]}, "observation.shape is"),
        ({"action__at_one": [100.0]}, "action.at_one is"),
        ({"network": None}, "network: Field required"),
        ({"base": {}}, "base controllers for slots"),
        ({"base__z__law": "kerfgym.pif"}, "did you mean 'kerfgym.pid'"),
        ({"base__z__parameters": {"filter.window": 1000.0}}, "out of range"),
        ({"network__layers__0__inputs": SIZE - 1}, f"takes {SIZE - 1} numbers, but gets {SIZE}"),
        ({"network__layers__0__activation": "gelu"}, "activation"),
        ({"network__layers__2__outputs": 2}, "gives 2 numbers"),
        ({"network__frames": 0}, "network.frames"),
        ({"surprise": 1}, "surprise: Extra inputs"),
    ],
)
def test_another_environment_version_or_shape_is_refused(folder, tmp_path, changes, message):
    with pytest.raises(InvalidInput, match=message.replace(".", r"\.")):
        stack.resolve(str(copy_of(folder, tmp_path / "copy", **changes)))


def test_a_document_that_was_changed_is_refused(folder, tmp_path):
    place = copy_of(folder, tmp_path / "copy")
    text = (folder / "policy.json").read_text()
    (place / "policy.json").write_text(text)
    assert Policy.load(place).document == Policy.load(folder).document
    one = re.search(r'"filter.window": (\d)', text)
    for changed in (
        text.replace(one[0], '"filter.window": 2'),
        text.replace('"training_steps": ', '"training_steps": 1'),
        text.replace('"sha256": "', '"sha256": "0'),
    ):
        assert changed != text
        (place / "policy.json").write_text(changed)
        with pytest.raises(InvalidInput, match=r"policy\.json is not as it was written"):
            Policy.load(place)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base__z__law": "os.system"}, "unknown law 'os.system' in slot 'z'"),
        ({"base__z__parameters": {"law.kv": 1e9}}, "law.kv = 1000000000.0 is out of range"),
    ],
)
def test_a_base_that_does_not_exist_is_refused_on_loading(folder, tmp_path, changes, message):
    with pytest.raises(InvalidInput, match=message):
        Policy.load(copy_of(folder, tmp_path / "copy", **changes))


def test_damaged_weights_are_refused(folder, tmp_path):
    data = (folder / "weights.safetensors").read_bytes()
    flipped = bytearray(data)
    flipped[-3] ^= 1
    for i, bad in enumerate((data[:-4], bytes(flipped), b"")):
        with pytest.raises(InvalidInput, match="damaged"):
            Policy.load(copy_of(folder, tmp_path / f"damaged{i}", bad))

    def forged(i, bad):
        """The digest fits."""
        return copy_of(folder, tmp_path / f"forged{i}", bad, weights=artefact.hashlib.sha256(bad).hexdigest())

    tensors = load(data)
    name = "layers.0.weight"
    for i, (bad, message) in enumerate(
        [
            (data[:-4], "no safetensors file"),
            (b"\x80\x04\x95pickle", "no safetensors file"),
            (save({**tensors, name: tensors[name].astype(np.float64)}), "type float64"),
            (save({**tensors, name: tensors[name][:, 1:].copy()}), "has shape"),
            (save({**tensors, name: tensors[name] * np.float32(np.nan)}), "not finite"),
            (save({k: v for k, v in tensors.items() if k != name}), "do not fit: layers.0.weight"),
        ]
    ):
        with pytest.raises(InvalidInput, match=message):
            Policy.load(forged(i, bad))
    place = copy_of(folder, tmp_path / "without")
    (place / "weights.safetensors").unlink()
    with pytest.raises(InvalidInput, match="cannot be read"):
        Policy.load(place)
    with pytest.raises(InvalidInput, match=r"no policy\.json"):
        stack.resolve(str(tmp_path))


def test_observations_that_do_not_fit_are_refused(folder):
    policy = Policy.load(folder)
    for bad in (np.zeros(SIZE - 1), np.zeros((1, 1, SIZE)), np.full(SIZE, np.nan), np.array(["x"] * SIZE)):
        with pytest.raises(InvalidInput, match="observation"):
            policy.act(bad)
    assert policy.act(np.zeros((3, SIZE), np.float32)).shape == (3, 1)
    with pytest.raises(InvalidInput, match="after 3 before"):
        policy.act(np.zeros((2, SIZE), np.float32))


def test_what_an_artefact_cannot_do_is_refused_with_what_it_can(tmp_path):
    env = HeightFollowingVecEnv(1)
    with pytest.raises(InvalidInput, match="layer ELU; supported: PPO"):
        export(model(PPO, env, policy_kwargs={"activation_fn": torch.nn.ELU, "net_arch": [4]}), tmp_path)
    with pytest.raises(InvalidInput, match="layer Hardtanh; supported"):
        export(model(SAC, env, use_sde=True), tmp_path)
    wrapped = gym.wrappers.TransformObservation(gym.make("kerfgym/HeightFollowing-v0"), lambda x: 2 * x, None)
    with pytest.raises(InvalidInput, match="wrapper TransformObservation; supported"):
        export(model(PPO, env), tmp_path, env=wrapped)
    with pytest.raises(InvalidInput, match="give one of kerfgym's"):
        export(model(PPO, env), tmp_path, env=gym.make("Pendulum-v1"))
    assert not (tmp_path / "policy.json").exists()


def test_an_artefact_that_differs_from_its_model_is_not_written(tmp_path, monkeypatch):
    made, original = model(PPO, HeightFollowingVecEnv(1)), made_layers()
    monkeypatch.setattr("kerfgym.agents.export._layers", lambda m: original(m, 1e-3))
    with pytest.raises(InvalidInput, match="differ from the model's"):
        export(made, tmp_path)
    assert not (tmp_path / "policy.json").exists()


def made_layers():
    """The exporter's layers, the last bias shifted."""
    from kerfgym.agents.export import _layers

    def shifted(made, by):
        layers, output = _layers(made)
        return (*layers[:-1], layers[-1]._replace(bias=layers[-1].bias + np.float32(by))), output

    return shifted


def test_the_normaliser_is_stable_baselines3s():
    env = VecNormalize(HeightFollowingVecEnv(3))
    env.reset()
    for _ in range(20):
        env.step(np.zeros((3, 1), np.float32))
    from kerfgym.agents.network import normalised

    raw = env.get_original_obs()
    scale = np.sqrt(env.obs_rms.var + env.epsilon)
    np.testing.assert_array_equal(
        normalised(Normaliser(env.obs_rms.mean, scale, env.clip_obs), raw), env.normalize_obs(raw)
    )
