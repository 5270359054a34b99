"""What a training is: algorithm, environment, and every number that differs from the libraries' defaults.

A preset is a TOML file, ``presets/<environment>-<algorithm>.toml``, with the tables of :class:`Settings`. Single values
are changed by dotted name: ``algorithm.gamma=0.97``, ``environment.reward.rate=0.1``.
"""

import importlib
import inspect
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict  # as pydantic wants it below Python 3.12

from ..envs.engine.quantity import InvalidInput, check_choice, did_you_mean
from ..envs.safety import consent, files
from ..envs.tasks.all_tasks import TASKS

PRESETS = Path(__file__).parent / "presets"

ALGORITHMS = {
    "ppo": ("stable_baselines3", "PPO"),
    "sac": ("stable_baselines3", "SAC"),
    "td3": ("stable_baselines3", "TD3"),
    "tqc": ("sb3_contrib", "TQC"),
    "recurrent-ppo": ("sb3_contrib", "RecurrentPPO"),
    "gradient": ("kerfgym.agents.gradient", "Gradient"),
}
"""Package and class of each algorithm: PPO (Schulman et al. 2017) with its advantages (Schulman et al. 2016), SAC
(Haarnoja et al. 2018), TD3 (Fujimoto et al. 2018), TQC (Kuznetsov et al. 2020), PPO with memory (Hochreiter and
Schmidhuber 1997)."""

LEARNS = {"gradient": ("kerfgym/HeightFollowing-v0",)}
"""Environments of an algorithm that does not learn all of them."""

PROVENANCE = "provenance"
"""Table of a settings file that tells where it comes from."""

ACTIVATIONS = ("tanh", "relu")
"""Of the network's layers; what a policy artefact can hold."""

_OURS = ("final_learning_rate", "noise")
_OUTSIDE = (  # set by the run itself, or not a plain value
    *("self", "policy", "env", "policy_kwargs", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"),
    *("action_noise", "replay_buffer_class", "replay_buffer_kwargs", "optimize_memory_usage", "rollout_buffer_class"),
    *("rollout_buffer_kwargs", "stats_window_size", "use_sde", "sde_sample_freq", "use_sde_at_warmup"),
)
_SHARES = ("gamma", "gae_lambda", "tau", "clip_range")
_POLICY = ("net_arch", "activation", "spread", "output_gain")
_MEMORY = ("gru_hidden_size",)
_RECURRENT = ("lstm_hidden_size", "n_lstm_layers", "shared_lstm", "enable_critic_lstm")
_BY_STATE = ("spread_by_state",)
_CRITICS = ("n_critics",)
_QUANTILES = ("n_quantiles", "top_quantiles_to_drop_per_net")  # the second belongs to the algorithm


class Arguments(TypedDict, total=False):
    """Kinds of what the tables ``environment`` and ``evaluation`` hold."""

    scenario: str | list[str]
    control: str
    observation: str
    split: str
    reward: dict[str, float]
    base: str
    machine: str | dict[str, Any]  # a scenario or a machine checks it
    path: str
    max_steps: int
    extrapolate: bool
    num_envs: int
    num_threads: int
    every: int
    episodes: int


LARGEST = 10**18
"""Any number that is larger is a slip; the libraries could not hold it."""

MOST_SCENARIOS = 1000
"""In a list; each is read and prepared by itself."""

MOST = {"environment.num_envs": 100_000, "environment.num_threads": 1024}
"""Machines, and threads that step them."""


@dataclass(frozen=True)
class Settings:
    """One training.

    ``algorithm`` holds arguments of the algorithm's class, besides ``final_learning_rate`` (the rate falls to it
    geometrically) and ``noise`` (standard deviation of TD3's exploration, share of the action's range of ±1).
    ``policy`` describes the network: ``net_arch``, ``activation``, ``spread`` (standard deviation of the first actions,
    one number or one for each), ``spread_by_state`` (PPO: that becomes a function of the observation, see
    :mod:`agents.spread`), ``output_gain`` (factor on the first weights of the action's layer: below 1, a residual
    begins small).
    """

    name: str  # of the algorithm
    env: str  # id of the environment
    steps: int = 1_000_000  # simulated steps of training
    environment: dict[str, Any] = field(default_factory=dict)  # its arguments, num_envs, num_threads
    algorithm: dict[str, Any] = field(default_factory=dict)
    policy: dict[str, Any] = field(default_factory=dict)
    evaluation: dict[str, Any] = field(default_factory=dict)  # every, episodes, and arguments that differ
    checkpoint: dict[str, Any] = field(default_factory=dict)  # every

    def varied(self, changes: dict[str, Any]) -> "Settings":
        """The settings with some values changed, by dotted name.

        Raises:
            InvalidInput: unknown name; the nearest is offered.
        """
        values = asdict(self)
        for key, value in changes.items():
            *tables, last = key.split(".")
            place = values
            for i, table in enumerate(tables):
                here = known(self, ".".join(tables[:i]))
                if table not in here:
                    raise InvalidInput(f"unknown setting '{key}'; {did_you_mean(table, here)}")
                place = place.setdefault(table, {})
                if not isinstance(place, dict):
                    raise InvalidInput(f"unknown setting '{key}'; '{table}' is not a table")
            allowed = known(self, ".".join(tables))
            if allowed and last not in allowed:
                shown = [".".join([*tables, name]) for name in allowed]
                raise InvalidInput(f"unknown setting '{key}'; {did_you_mean(key, shown)}")
            place[last] = value
        return checked(Settings(**values))

    def flat(self) -> dict[str, Any]:
        """Every value by dotted name."""
        return dict(_flat(asdict(self), ""))

    def value(self, key: str) -> Any:
        """What a dotted name stands for: the value set or, of the algorithm, its default; None if there is neither."""
        found = self.flat()
        table, _, last = key.partition(".")
        if key in found or table != "algorithm":
            return found.get(key)
        argument = _arguments(self.name).get(last)
        return argument.default if argument else None

    def plain(self) -> dict[str, Any]:
        """As a settings file holds it."""
        return {key: getattr(self, key) for key in ("name", "env", *known(self, ""))}


def _flat(table: dict[str, Any], before: str) -> Any:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def algorithm_class(name: str) -> Any:
    """The class of an algorithm; imports torch."""
    package, attribute = ALGORITHMS[name]
    return getattr(importlib.import_module(package), attribute)


def environment_class(env: str) -> Any:
    """The native VecEnv of an environment."""
    from . import vec_env

    return vec_env.KINDS[env]


def _arguments(name: str) -> dict[str, inspect.Parameter]:
    """Arguments of an algorithm's class that a user may set."""
    found = inspect.signature(algorithm_class(name).__init__).parameters
    return {key: parameter for key, parameter in found.items() if key not in _OUTSIDE}


def _check_argument(key: str, value: Any, default: Any) -> None:
    """A number where the default is one, not negative, and a share where it can only be one."""
    if isinstance(default, bool) or not isinstance(default, int | float):
        return
    if key == "algorithm.gradient_steps" and value == -1:  # as many as samples
        return
    most = 1.0 if key.split(".")[1] in _SHARES else LARGEST
    whole = isinstance(default, int)
    number = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    if not number or not 0 <= value <= most:
        kind = "a whole number" if whole else "a number"
        raise InvalidInput(
            f"{key} = {files.shown(value)}; {kind} {'from 0 to 1' if most == 1.0 else f'from 0 on, at most {most:g}'}"
        )


def known(settings: Settings, table: str) -> list[str]:
    """Names that a table may hold; empty: the environment checks them itself.

    Args:
        settings: whose algorithm and environment count.
        table: dotted name, "" for the top.
    """
    if table == "":
        return [f.name for f in fields(Settings) if f.name not in ("name", "env")]
    if table in ("environment", "evaluation"):
        arguments = inspect.signature(environment_class(settings.env).SINGLE.__init__).parameters
        plain = [n for n in arguments if n not in ("self", "split", "render_mode", "colour")]
        return [*plain, "num_envs", "num_threads"] if table == "environment" else ["every", "episodes", *plain]
    if table == "algorithm":
        return [*_arguments(settings.name), *(n for n in _OURS if n != "noise" or settings.name == "td3")]
    if table == "policy":
        more = {"recurrent-ppo": _RECURRENT, "ppo": _BY_STATE, "tqc": (*_CRITICS, _QUANTILES[0]), "gradient": _MEMORY}
        return [*_POLICY, *more.get(settings.name, _CRITICS)]
    if table == "checkpoint":
        return ["every"]
    return []


def checked(settings: Settings) -> Settings:
    """``settings`` if their names and plain numbers are good; what the environment alone knows, it checks itself.

    Raises:
        InvalidInput: what was wrong, what is allowed, the nearest valid name.
    """
    for table in ("environment", "algorithm", "policy", "evaluation", "checkpoint"):
        content, allowed = getattr(settings, table), known(settings, table)
        if not isinstance(content, dict):
            raise InvalidInput(f"setting '{table}' is a table, not {files.shown(content)}")
        for key in content:
            if key not in allowed:
                shown = [f"{table}.{name}" for name in allowed]
                raise InvalidInput(f"unknown setting '{table}.{key}'; {did_you_mean(f'{table}.{key}', shown)}")
        if table in ("environment", "evaluation"):
            files.fitting(Arguments, content, table)
            if isinstance(several := content.get("scenario"), list) and len(several) > MOST_SCENARIOS:
                raise InvalidInput(f"{table}.scenario has {len(several):,} entries; at most {MOST_SCENARIOS:,}")
    counts = {
        "steps": settings.steps,
        "environment.num_envs": settings.environment.get("num_envs", 1),
        "environment.num_threads": settings.environment.get("num_threads", 1),
        "evaluation.every": settings.evaluation.get("every", 1),
        "evaluation.episodes": settings.evaluation.get("episodes", 1),
        "checkpoint.every": settings.checkpoint.get("every", 1),
    }
    for key, value in counts.items():
        most = MOST.get(key, LARGEST)
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
            span = f"from 1 to {most:,}" if key in MOST else "at least 1"
            raise InvalidInput(f"{key} = {files.shown(value)}; a whole number, {span}")
    arguments = _arguments(settings.name)
    for key, value in settings.algorithm.items():
        if key in arguments:
            _check_argument(f"algorithm.{key}", value, arguments[key].default)
    by_state = settings.policy.get("spread_by_state", False)
    if not isinstance(by_state, bool):
        raise InvalidInput(f"policy.spread_by_state = {files.shown(by_state)}; true or false")
    activation = settings.policy.get("activation", "tanh")
    if activation not in ACTIVATIONS:
        given = files.shown(activation)
        raise InvalidInput(f"policy.activation = {given}; {did_you_mean(given, ACTIVATIONS)}")
    positive = {
        **{f"algorithm.{k}": settings.algorithm[k] for k in _OURS if k in settings.algorithm},
        **{f"policy.{k}": settings.policy[k] for k in ("spread", "output_gain") if k in settings.policy},
    }
    for key, value in positive.items():
        several = isinstance(value, list) and key == "policy.spread"
        for number in value if several else [value]:
            if isinstance(number, bool) or not isinstance(number, int | float) or not 0 < number <= LARGEST:
                which = "a number above 0" + ", or one for each action" * several
                raise InvalidInput(f"{key} = {files.shown(value)}; {which}")
    return settings


def preset_file(name: str, env: str) -> Path:
    """The preset of an algorithm on an environment.

    Raises:
        InvalidInput: there is no such algorithm or environment; the nearest is offered.
    """
    check_choice(name, ALGORITHMS, "algorithm")
    check_choice(env, TASKS, "environment")
    if env not in LEARNS.get(name, TASKS):
        raise InvalidInput(f"{name} learns {', '.join(LEARNS[name])} alone; of {env} it has no derivatives")
    return PRESETS / f"{TASKS[env].name}-{name}.toml"


def preset(name: str, env: str, changes: dict[str, Any] | None = None) -> Settings:
    """The shipped settings of an algorithm on an environment, with changes by dotted name.

    Raises:
        InvalidInput: unknown algorithm, environment or setting.
    """
    values = files.toml(preset_file(name, env))
    return checked(Settings(name, env, **values)).varied(changes or {})


def from_file(path: Path, name: str, env: str | None = None, changes: dict[str, Any] | None = None) -> Settings:
    """Settings of a file: a preset, the ``settings.toml`` of a training, or what a search has found.

    Args:
        path: of the file; if it, or its name, says for which algorithm and environment it is, it is for no others.
        name: of the algorithm.
        env: id of the environment; none: the file's.
        changes: by dotted name.

    Raises:
        InvalidInput: not such a file, or for another algorithm or environment, or an unknown setting, or its base is
            Python code and the user has not agreed to run it.
    """
    values = files.toml(path)
    named = _named(path)
    for what, kind, asked in (("name", "algorithm", name), ("env", "environment", env)):
        mine = values.pop(what, named.get(what))
        if mine is not None and asked is not None and mine != asked:
            raise InvalidInput(f"'{path}' is for {kind} '{mine}', not '{asked}'")
        env = mine if what == "env" and mine is not None else env
    env = env or next(iter(TASKS))
    if not isinstance(env, str):
        raise InvalidInput(f"'{path}': env = {files.shown(env)}; allowed: {', '.join(TASKS)}")
    preset_file(name, env)  # an unknown one is an error here
    values.pop(PROVENANCE, None)
    tables = known(Settings(name, env), "")
    for key in values:
        if key not in tables:
            raise InvalidInput(f"'{path}': unknown setting '{key}'; {did_you_mean(key, tables)}")
    for table in ("environment", "evaluation"):
        inner = values.get(table)
        consent.required(inner.get("base") if isinstance(inner, dict) else None, f"{path}: {table}.base")
    try:
        found = checked(Settings(name, env, **values))
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None
    return found.varied(changes or {})


def _named(path: Path) -> dict[str, str]:
    """Algorithm and environment of a preset, which its file's name tells."""
    shipped = ((name, env) for name in ALGORITHMS for env in LEARNS.get(name, tuple(TASKS)))
    files = {preset_file(name, env).name: {"name": name, "env": env} for name, env in shipped}
    return files.get(path.name, {})


def parsed(assignments: list[str], such_as: str = "algorithm.gamma=0.97") -> dict[str, Any]:
    """Changes from ``key=value`` as a user types them; values as in TOML, a bare word is text. ``such_as``: an example
    for the error.

    Raises:
        InvalidInput: no equals sign.
    """
    changes = {}
    for text in assignments:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise InvalidInput(f"--set {text}: not of the form key=value, as in {such_as}")
        try:
            changes[key.strip()] = files.toml_of(f"x = {value}", text)["x"]
        except InvalidInput:
            changes[key.strip()] = value.strip()
    return changes
