"""Learning by exact gradients through the known machine.

A policy with ``control="weights"`` chooses weights of its base's signals. What it sees of the sheet does not depend on
what it does, so the error that a weight will have caused some milliseconds later has a derivative that can be computed:
drive and loop are the machine's own parts, run backwards (:mod:`envs.plant.derivatives`). One pass:

1. All machines live through an episode under the present policy. What their law's loop reads is kept.
2. Drive and loop alone live through it again, ``epochs`` times, by the policy as it is then, in pieces of ``horizon``
   periods; with the recorded policy it is what the machines did, to the bit. After each piece its adjoints give the
   loss by each action.
3. That gradient goes on through the network, whatever it is, and Adam (Kingma and Ba 2015) takes a step. What a network
   with memory knows goes on from piece to piece, its gradient ends with the piece.

No critic, no exploration, no reward. The loss is Σ MSE/usual MSE over the scenarios, whose gradient is that of the
score (twice the logarithm of the geometric mean), plus the same of the command's changes with the weight ``jitter``. A
machine whose mean square exceeds ``most`` times its scenario's usual one counts as if it did not, so that one bad sheet
does not rule. Adjoints end with the piece, which is long beside a drive's lag.

The class has the interface of stable-baselines3's algorithms, so settings, checkpoints, evaluation and export are the
same. Its steps are those of the machines and those of drive and loop alone.
"""

from typing import Any, cast

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.torch_layers import create_mlp
from torch import nn

from ..envs.engine.quantity import InvalidInput
from ..envs.plant.derivatives import Made, Period, Rollout
from ..envs.tasks.task import SHEET, WEIGHTS

FADE = 0.15
"""Share of the newest pass in what is usual."""

NEAR = 1e-9
"""mm by which drive and loop alone may lie beside the machines."""

_COURSE = Period._fields[:-1]
_GAP, _COMMAND = Made._fields.index("gap"), Made._fields.index("command")


class GradientPolicy(BasePolicy):
    """A network from observation to action, which tanh keeps within ±1.

    Args:
        observation_space, action_space, lr_schedule, optimizer_kwargs: as stable-baselines3 gives them.
        net_arch: sizes of the hidden layers.
        activation_fn: between them.
        gru_hidden_size: numbers of a GRU before them, which remembers (Cho et al. 2014); 0: there is none.

    Raises:
        InvalidInput: the size is not a whole number from 0 on.
    """

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        lr_schedule: Any,
        net_arch: list[int] | None = None,
        activation_fn: Any = nn.ReLU,
        gru_hidden_size: int = 0,
        optimizer_kwargs: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(observation_space, action_space, squash_output=True)
        sizes = [64, 64] if net_arch is None else list(net_arch)
        self.net_arch, self.activation_fn = sizes, activation_fn
        if (
            isinstance(gru_hidden_size, bool)
            or not isinstance(gru_hidden_size, int)
            or not 0 <= gru_hidden_size <= 4096
        ):
            raise InvalidInput(f"policy.gru_hidden_size = {gru_hidden_size!r}; a whole number, from 0 to 4096")
        seen = observation_space.shape[0]
        self.memory = nn.GRU(seen, gru_hidden_size, batch_first=True) if gru_hidden_size else None
        layers = create_mlp(gru_hidden_size or seen, action_space.shape[0], sizes, activation_fn)
        self.net = nn.Sequential(*layers)
        # The order of a network without memory is that of earlier versions' checkpoints.
        self.optimizer = torch.optim.Adam(self.parameters(), lr_schedule(1), **(optimizer_kwargs or {}))

    def nothing(self, count: int) -> torch.Tensor:
        """What is remembered of ``count`` machines when episodes begin, (1, n, h)."""
        return torch.zeros(1, count, self.memory.hidden_size if self.memory is not None else 0, device=self.device)

    def course(self, observations: torch.Tensor, known: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Actions, (n, t, k), of observations in a row, (n, t, d), and what is remembered then, (1, n, h)."""
        if self.memory is None:
            return torch.tanh(self.net(observations)), known
        found, known = self.memory(observations, known)
        return torch.tanh(self.net(found)), known

    def forward(self, observation: torch.Tensor, deterministic: bool = True) -> torch.Tensor:
        """Actions, (n, k), of observations, (n, d), of which nothing is remembered."""
        return self.course(observation[:, None], self.nothing(len(observation)))[0][:, 0]

    def _predict(self, observation: Any, deterministic: bool = True) -> torch.Tensor:
        return self(observation)

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """Actions of observations, (n, d) or (d,), and what is remembered, which the next call takes."""
        if self.memory is None:
            return super().predict(observation, state, episode_start, deterministic)
        seen = np.asarray(observation, np.float32)
        seen, single = np.atleast_2d(seen), seen.ndim == 1
        with torch.no_grad():
            known = self.nothing(len(seen)) if state is None else torch.as_tensor(state[0], device=self.device).clone()
            if episode_start is not None:
                known[:, torch.as_tensor(np.asarray(episode_start, bool))] = 0.0
            actions, known = self.course(torch.as_tensor(seen, device=self.device)[:, None], known)
        found = actions[:, 0].cpu().numpy()
        return (found[0] if single else found), (known.cpu().numpy(),)


class Gradient(BaseAlgorithm):
    """Gradients through the known machine; ``env`` is the native VecEnv of HeightFollowing with ``control="weights"``
    and ``observation="sheet"``.

    Args:
        learning_rate: of Adam.
        horizon: periods from update to update.
        epochs: how often a pass is learnt from.
        jitter: weight of the command's changes beside the error.
        most: times a scenario's usual mean square, above which a machine counts no more.
        clip: largest norm of a gradient.

    Raises:
        InvalidInput: another environment, a base whose law has no loop, or a loop that does not do what its law does.
    """

    policy_aliases = {"MlpPolicy": GradientPolicy}

    def __init__(
        self,
        policy: Any,
        env: Any,
        learning_rate: Any = 2e-3,
        horizon: int = 200,
        epochs: int = 3,
        jitter: float = 0.1,
        most: float = 8.0,
        clip: float = 1.0,
        policy_kwargs: dict[str, Any] | None = None,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: Any = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            policy,
            env,
            learning_rate,
            policy_kwargs=policy_kwargs,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            support_multi_env=True,
        )
        self.horizon, self.epochs = int(horizon), int(epochs)
        self.jitter, self.most, self.clip = float(jitter), float(most), float(clip)
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        for name in ("horizon", "epochs"):
            if getattr(self, name) < 1:
                raise InvalidInput(f"algorithm.{name} = {getattr(self, name)}; a whole number, at least 1")
        batch = getattr(self.env, "batch", None)
        if batch is None or batch.control != WEIGHTS or batch.observation != SHEET:
            raise InvalidInput(
                'gradient learns with control = "weights" and observation = "sheet" of the native environments'
            )
        if batch.base.z.law.weighing.loop is None:
            raise InvalidInput(f"the law of base '{batch.base.z.name}' has weights, but no loop to learn through")
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self.policy = self.policy_class(
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        )
        self.policy = self.policy.to(self.device)
        self._n_updates = 0
        # Mean squares of error, mm², and of the command's changes, (mm/s)², usual in each scenario; 0: not known yet.
        self.usual = torch.zeros(2, len(batch.scenarios), dtype=torch.float64)
        self.passed: Pass | None = None

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], ["usual"]

    def learn(
        self,
        total_timesteps: int,
        callback: Any = None,
        log_interval: int = 1,
        tb_log_name: str = "gradient",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> "Gradient":
        """Trains, in whole passes."""
        total, callback = self._setup_learn(total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar)
        callback.on_training_start(locals(), globals())
        while self.num_timesteps < total:
            callback.on_rollout_start()
            self._update_current_progress_remaining(self.num_timesteps, total)
            self._update_learning_rate(self.policy.optimizer)
            passed = self._live()
            callback.update_locals(locals())
            if not callback.on_step():
                return self
            callback.on_rollout_end()
            for _ in range(self.epochs):
                self._learn_from(passed)
        callback.on_training_end()
        return self

    def _live(self) -> "Pass":
        """An episode of all machines under the present policy."""
        env: Any = self.env
        first = self.passed is None
        self.passed = passed = self.passed or Pass(env.batch, self.horizon)
        seen = env.reset()
        passed.begin()
        known = self.remembering.nothing(len(seen))
        for t in range(passed.periods):
            actions, known = self.decided(seen[:, None], known)
            actions = actions[:, 0]
            passed.before(t, seen, actions)
            seen, _, dones, infos = env.step(actions)
            passed.after(t, dones)
            self._update_info_buffer(infos, dones)
        self._last_obs = seen
        if first:
            passed.check()
        self.num_timesteps += passed.lived.size
        return passed

    @property
    def remembering(self) -> GradientPolicy:
        """The policy, as what it is."""
        policy: Any = self.policy
        return cast(GradientPolicy, policy)

    def decided(self, observations: np.ndarray, known: torch.Tensor) -> tuple[np.ndarray, torch.Tensor]:
        """Actions for observations in a row, (n, t, d), and what is remembered then."""
        with torch.no_grad():
            actions, known = self.remembering.course(torch.as_tensor(observations, device=self.device), known)
            return actions.cpu().numpy(), known

    def _learn_from(self, passed: "Pass") -> None:
        passed.restart()
        known = self.remembering.nothing(len(passed.lived))
        count, squares = np.zeros(self.usual.shape[1]), np.zeros(self.usual.shape[1])
        for first in range(0, passed.periods, self.horizon):
            piece = slice(first, first + self.horizon)
            seen = np.ascontiguousarray(passed.observations[:, piece])
            actions, then = self.decided(seen, known)
            passed.decide(first, actions)
            errors, changes = passed.rolled(first)
            self._get_usual(passed, piece, errors, changes)
            self._step(seen, known, self._bars(passed, piece, errors, changes))
            known = then
            np.add.at(squares, passed.scenario, (errors**2).sum(axis=1))
            np.add.at(count, passed.scenario, passed.counts[:, piece].sum(axis=1))
            self.num_timesteps += errors.size
        self._remember(squares, count)

    def _bars(self, passed: "Pass", piece: slice, errors: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """Adjoints of the actions, (n, horizon, k): of the loss of a piece."""
        square, change = self.usual.numpy()
        each = passed.scenario
        known, length = square[each] > 0.0, errors.shape[1]
        share = known / (np.bincount(each, minlength=len(square))[each] * length * len(np.unique(each)))
        usual = np.where(known, square[each], 1.0)
        capped = np.minimum(1.0, self.most * usual / np.maximum((errors**2).mean(axis=1), 1e-12))
        made_ = np.zeros((*errors.shape, len(Made._fields)))
        made_[:, :, _GAP] = 2.0 * errors * (share * capped / usual)[:, None]
        pull = 2.0 * changes * (self.jitter * share / np.maximum(change[each], 1e-6))[:, None]
        made_[:, :, _COMMAND] = pull
        made_[:, :-1, _COMMAND] -= pull[:, 1:]
        return np.where(passed.lived[:, piece, None], passed.roll.backward(made_), 0.0)

    def _step(self, observations: np.ndarray, known: torch.Tensor, bars: np.ndarray) -> None:
        """One of Adam's, from the gradient by the actions, (n, t, k), after what was ``known``."""
        x = torch.as_tensor(observations, device=self.device)
        g = torch.as_tensor(bars.astype(np.float32), device=self.device)
        self.policy.optimizer.zero_grad()
        (self.remembering.course(x, known)[0] * g).sum().backward()
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.clip)
        self.policy.optimizer.step()
        self._n_updates += 1

    # ----------------------------------------------------------------------------------------- what is usual

    def _get_usual(self, passed: "Pass", piece: slice, errors: np.ndarray, changes: np.ndarray) -> None:
        """A first idea of it."""
        for s in np.unique(passed.scenario).tolist():
            mine = passed.scenario == s
            counts = passed.counts[mine, piece].sum()
            if self.usual[0, s] == 0.0 and counts:
                self.usual[0, s] = float((errors[mine] ** 2).sum() / counts)
            if self.usual[1, s] == 0.0:
                self.usual[1, s] = float((changes[mine] ** 2).mean()) + 1e-6

    def _remember(self, squares: np.ndarray, count: np.ndarray) -> None:
        """After an epoch: what is usual follows what was seen; the command's changes stay what they were at first."""
        now = torch.as_tensor(squares / np.maximum(count, 1))
        moved = (1.0 - FADE) * self.usual[0] + FADE * torch.minimum(now, 1.5 * self.usual[0])
        self.usual[0] = torch.where(torch.as_tensor(count > 0), moved, self.usual[0])
        env: Any = self.env
        for s, value in zip(env.batch.scenarios, self.usual[0].tolist(), strict=True):
            self.logger.record(f"train/rms_{s.name}", 1e3 * value**0.5)
        self.logger.dump(self.num_timesteps)


class Pass:
    """An episode of all machines: what was seen, and drive and loop to live through it again.

    Args:
        batch: the machines.
        horizon: periods of a piece; a pass is of whole pieces.
    """

    def __init__(self, batch: Any, horizon: int) -> None:
        law = batch.base.z.law
        self.batch, self.law, self.horizon = batch, law.weighing, horizon
        n, self.periods = batch.size, max(int(batch.longest.max()) // horizon, 1) * horizon
        actions = range(self.law.action, self.law.action + len(self.law.weights))
        self.roll = Rollout(n, self.law.loop, law.Params, self.law.Loop, self.law.reads, actions)
        self.roll.lay(self.periods)
        self.observations = np.empty((n, self.periods, len(self.law.features)), np.float32)
        self.lived, self.counts = np.zeros((n, self.periods), bool), np.zeros((n, self.periods), bool)
        self._gaps = np.empty((n, horizon))
        self._scored = batch.task.info.index("scored")

    def begin(self) -> None:
        """The machines have begun."""
        fleet = self.batch.fleet
        self.scenario = self.batch.scenario_of.copy()
        self.set_height = fleet.column("signals.set_height")
        self._settled = np.array([s.settle_steps for s in self.batch.scenarios])[self.scenario]
        self._alive = np.ones(fleet.size, bool)
        self.roll.put_state(fleet)
        self.roll.put_law(np.arange(fleet.size), self.batch.base.z.part("law"), self.law.Loop())
        self._start = self.roll.snapshot()

    def restart(self) -> None:
        """Drive and loop are where the machines began."""
        self.roll.restore(self._start)
        self._command = self.roll.column("felt.command")

    def check(self) -> None:
        """Drive and loop alone did in the first piece what the machines did.

        Raises:
            InvalidInput: they did not, so their derivatives would be those of something else.
        """
        self.restart()
        made = self.roll.forward(0, self.horizon)[:, :, _GAP]
        off = np.abs(np.where(self.lived[:, : self.horizon], made - self._gaps, 0.0)).max()
        if not off <= NEAR:
            raise InvalidInput(
                f"the law's loop does not do what its control does: after {self.horizon} ms they are {off:.2g} mm apart"
            )

    def before(self, t: int, observations: np.ndarray, actions: np.ndarray) -> None:
        """Notes what the policy sees and the law's loop reads at period ``t``."""
        self.observations[:, t] = observations
        self.roll.put_memory(t, self.batch.fleet.memories[:, : self.law.reads])
        self.roll.put_wanted(t, actions[:, None])

    def after(self, t: int, dones: np.ndarray) -> None:
        """Notes the period that followed; what comes after the end of an episode does not count."""
        fleet = self.batch.fleet
        course = [fleet.column(f"course.{name}") for name in _COURSE]
        overridden = fleet.column("signals.override") > 0.5
        self.roll.put_course(t, [*course, np.where(overridden, fleet.column("signals.command"), np.nan)])
        self._alive &= ~dones
        self.lived[:, t] = self._alive
        if t < self.horizon:
            self._gaps[:, t] = fleet.column("moment.gap")
        self.counts[:, t] = self._alive & (self.batch.infos[self._scored] > 0.5) & (t >= self._settled)

    def decide(self, first: int, actions: np.ndarray) -> None:
        """Other actions from period ``first`` on, of a piece."""
        self.roll.put_wanted(first, actions.reshape(len(self.lived), self.horizon, -1))

    def rolled(self, first: int) -> tuple[np.ndarray, np.ndarray]:
        """A piece once more: errors where they count, mm, and changes of the command, mm/s; (n, horizon)."""
        made, piece = self.roll.forward(first, self.horizon), slice(first, first + self.horizon)
        commands = made[:, :, _COMMAND]
        changes = np.diff(commands, axis=1, prepend=self._command[:, None]) * self.lived[:, piece]
        self._command = commands[:, -1].copy()
        return (made[:, :, _GAP] - self.set_height[:, None]) * self.counts[:, piece], changes
