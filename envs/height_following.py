"""Gymnasium environment of the height follower: the policy moves the cutting head, the machine does the rest."""

from typing import Any, Literal, NamedTuple

import gymnasium as gym
import numpy as np

from . import scenarios
from . import stack as stacks
from .film import Film, begin
from .plant import filters, heads, lanes, machine, supervisor
from .plant.controller import PERIOD, Privileged, stage_address
from .plant.fleet import Fleet
from .plant.lanes import U1, UW, U, clip, doubles, load, logarithm, part, singles, words
from .plant.quantity import InvalidInput, did_you_mean
from .scenarios import Scenario

CONTROLS = ("direct", "residual", "schedule")
OBSERVATIONS = ("features", "raw")

DIRECT_SPEED, RESIDUAL_SPEED = 200.0, 50.0
"""mm/s of head velocity that an action of 1 means."""

LONGEST_WINDOW, LARGEST_TRIM = 15, 3
LEAST_GAIN, LARGEST_GAIN = 0.2, 3.0
"""Limits of ``control="schedule"``."""

TOLERANCE = 0.002
"""mm; errors are felt in multiples of it."""

LARGEST = 3.4e38
"""Largest finite action (float32)."""

LIMIT = 10.0
"""Bound of every normalised feature."""

ERROR_LAGS = (0, 1, 2, 3, 5, 8)
SURFACE_LAGS = (0, 1, 2, 3, 5, 8, 13)
SPEED_LAGS = (0, 1, 2, 4)
COMMAND_LAGS = (0, 1, 2, 3)
RAW_HISTORY = 8

FEATURES = (
    *(f"error_{k}" for k in ERROR_LAGS),
    *(f"surface_step_{a}_{b}" for a, b in zip(SURFACE_LAGS[:-1], SURFACE_LAGS[1:], strict=True)),
    *(f"speed_{k}" for k in SPEED_LAGS),
    *(f"command_{k}" for k in COMMAND_LAGS),
    "base_command", "set_height", "override", "captured", "holding",
)  # fmt: skip
"""Names of the normalised features, in order."""

RAW = (
    *(f"height_{k}" for k in range(RAW_HISTORY)),
    *(f"raw_height_{k}" for k in range(RAW_HISTORY)),
    *(f"head_position_{k}" for k in range(RAW_HISTORY)),
    *(f"command_{k}" for k in range(RAW_HISTORY)),
    "base_command", "set_height", "feed", "override", "captured", "mode",
)  # fmt: skip
"""Names of the physical signals, in order: newest first; mm and mm/s."""

INFO = (
    "true_gap", "measured_height", "true_error", "reported_error", "cost", "scored", "mode", "override", "distance",
    "reward_error", "reward_rate", "reward_collision", "weighted_error", "weighted_rate", "weighted_collision",
)  # fmt: skip
"""What ``info`` holds, in order; mm, terms of the reward raw and weighted."""


class Reward(NamedTuple):
    """Weights of the reward's terms; 0 switches one off."""

    error: float = 0.3  # per unit of log(1 + |true error|/2 µm), while cutting
    rate: float = 0.3  # per (change of command/10 mm/s)²
    collision: float = 100.0  # once


class _Io(NamedTuple):
    """Words that the stages below share with Python."""

    actions: int
    observations: int
    rewards: int
    infos: int
    weights: int
    control: int
    raw: int
    size: int  # of an observation
    width: int  # of an action


(_ACTIONS, _OBSERVATIONS, _REWARDS, _INFOS, _WEIGHTS, _CONTROL, _RAW, _SIZE, _WIDTH) = (
    range(len(_Io._fields))
)  # fmt: skip
_COST, _WEIGHTED = INFO.index("cost"), INFO.index("weighted_error")
_ANY = U(2**40)
_INFO = U(len(INFO))


@part
def _symlog(x):
    """x in units of the tolerance, compressed: sign·ln(1 + |x|)/5."""
    s = logarithm(1.0 + abs(x) / TOLERANCE) * 0.2
    return s if x >= 0.0 else -s


def act(block_address, at, n, io_address, first):
    """Stage before a period: the action becomes a change of the stack or of its command."""
    block, io = doubles(block_address, _ANY), words(io_address, U(9))
    actions, count = singles(io[_ACTIONS], _ANY), io[_WIDTH]
    for lane in range(n):
        a, i = at + lane, (first + lane) * count
        x = clip(np.float64(actions[i]), -1.0, 1.0)
        if io[_CONTROL] == U(0):
            lanes.store(block, a + machine.HAND, machine.Hand(1.0, DIRECT_SPEED * x))
        elif io[_CONTROL] == U1:
            lanes.store(block, a + machine.HAND, machine.Hand(1.0, RESIDUAL_SPEED * x))
        else:
            y, z = clip(np.float64(actions[i + U1]), -1.0, 1.0), clip(np.float64(actions[i + U(2)]), -1.0, 1.0)
            window = np.rint(1.0 + 0.5 * (x + 1.0) * (LONGEST_WINDOW - 1))
            trim = min(np.rint(0.5 * (y + 1.0) * LARGEST_TRIM), np.floor(0.5 * (window - 1.0)))
            p = load(filters.Params, block, a + machine.P_FILTER)
            lanes.store(block, a + machine.P_FILTER, filters.Params(
                filters.IMPROVED, window, trim, p.ratio, p.tau, p.jump, p.hold, p.trust
            ))  # fmt: skip
            gain = LEAST_GAIN + 0.5 * (z + 1.0) * (LARGEST_GAIN - LEAST_GAIN)
            lanes.store(block, a + machine.HAND, machine.Hand(gain, 0.0))


@part
def _back(block, ring, tick, k):
    """Entry of a history ring ``k`` periods ago."""
    return block[ring + ((tick - U(k)) & machine.HISTORY_LAST) * UW]


def observe(block_address, at, n, io_address, first):
    """Stage after a period: observation, reward and info of each machine."""
    block, io = doubles(block_address, _ANY), words(io_address, U(9))
    out, rewards = singles(io[_OBSERVATIONS], _ANY), doubles(io[_REWARDS], _ANY)
    infos, weights = doubles(io[_INFOS], _ANY), doubles(io[_WEIGHTS], U(3))
    for lane in range(n):
        a = at + lane
        x = load(Privileged, block, a + machine.SIGNALS)
        tick = U(np.int64(block[a + machine.CLOCK]))
        heights, raws = a + machine.HEIGHTS, a + machine.RAW_HEIGHTS
        positions, commands = a + machine.POSITIONS, a + machine.COMMANDS
        holding = 1.0 if x.mode == supervisor.HOLD else 0.0
        override, captured = 1.0 if x.override else 0.0, 1.0 if x.captured else 0.0
        base = block[a + machine.WISH]
        o = (first + lane) * io[_SIZE]
        if io[_RAW] == U1:
            start = block[a + machine.ORIGIN]
            for k in range(RAW_HISTORY):
                out[o + U(k)] = _back(block, heights, tick, k)
                out[o + U(RAW_HISTORY + k)] = _back(block, raws, tick, k)
                out[o + U(2 * RAW_HISTORY + k)] = clip(_back(block, positions, tick, k) - start, -200.0, 200.0)
                out[o + U(3 * RAW_HISTORY + k)] = _back(block, commands, tick, k)
            o += U(4 * RAW_HISTORY)
            out[o] = clip(base, -2000.0, 2000.0)
            out[o + U1], out[o + U(2)], out[o + U(3)] = x.set_height, x.feed, override
            out[o + U(4)], out[o + U(5)] = captured, x.mode
        else:
            for k in ERROR_LAGS:
                out[o] = _symlog(_back(block, heights, tick, k) - x.set_height)
                o += U1
            newer = _back(block, positions, tick, 0) - _back(block, raws, tick, 0)
            for k in SURFACE_LAGS[1:]:
                older = _back(block, positions, tick, k) - _back(block, raws, tick, k)
                out[o] = _symlog(newer - older)
                newer = older
                o += U1
            for k in SPEED_LAGS:
                speed = (_back(block, positions, tick, k) - _back(block, positions, tick, k + 1)) / PERIOD
                out[o] = clip(0.01 * speed, -LIMIT, LIMIT)
                o += U1
            for k in COMMAND_LAGS:
                out[o] = 0.01 * _back(block, commands, tick, k)
                o += U1
            out[o], out[o + U1] = clip(0.01 * base, -LIMIT, LIMIT), x.set_height
            out[o + U(2)], out[o + U(3)], out[o + U(4)] = override, captured, holding

        scored = block[a + machine.COURSE + U(7) * UW]
        collided = load(machine.Tally, block, a + machine.TALLY).collided
        error = x.gap - x.set_height
        felt = logarithm(1.0 + abs(error) / TOLERANCE) if scored > 0.5 else 0.0
        change = 0.1 * (_back(block, commands, tick, 0) - _back(block, commands, tick, 1))
        hit = 1.0 if collided else 0.0
        w = (-weights[0] * felt, -weights[1] * change * change, -weights[2] * hit)
        rewards[first + lane] = w[0] + w[1] + w[2]
        j = (first + lane) * _INFO
        values = (
            x.gap, x.height, error, x.height - x.set_height, hit, scored, x.mode, override,
            block[a + machine.S_PATH + UW] - x.feed * machine.AHEAD_S,
            felt, change * change, hit, w[0], w[1], w[2],
        )  # fmt: skip
        for v in values:
            infos[j] = v
            j += U1


class HeightFollowingEnv(gym.Env):
    """
    ## Description

    The cutting head of a laser machine travels over a sheet that is tilted, wavy, stepped, vibrating or full of holes.
    A capacitive sensor measures the gap between nozzle and sheet once per millisecond; the head has to stay at the set
    height (0.5 to 1 mm). The whole chain is simulated: gap → capacitance → oscillator → counted frequency → filter →
    calibration table, and command → supervisor → dead time → velocity loop → head, with the limits, friction, backlash
    and resonance of a real axis. The true gap is never observed, but it is what is scored.

    The supervisor stays in charge: it plans the approach, holds over holes (where the scenario's guard is on) and
    retracts after contact. While it acts, the action has no effect; `override` tells.

    ## Action Space

    `Box(-1, 1, (k,), float32)`, held for 1 ms.

    | `control`    | k | action                                        | -1      | 1     | unit    |
    |--------------|---|-----------------------------------------------|---------|-------|---------|
    | `"direct"`   | 1 | head velocity command, up positive            | -200    | 200   | mm/s    |
    | `"residual"` | 1 | head velocity added to the base controller's  | -50     | 50    | mm/s    |
    | `"schedule"` | 3 | filter window                                 | 1       | 15    | samples |
    |              |   | samples trimmed at each end                   | 0       | 3     | samples |
    |              |   | factor on the base controller's command       | 0.2     | 3     | 1       |

    ## Observation Space

    `observation="features"`: `Box(-10, 10, (25,), float32)`, normalised. symlog(x) = sign(x)·ln(1 + |x|/2 µm)/5.

    | index | signal                                                                     | unit       |
    |-------|----------------------------------------------------------------------------|------------|
    | 0–5   | measured height − set height, 0, 1, 2, 3, 5, 8 ms ago                       | symlog     |
    | 6–11  | change of (encoder − unfiltered height), the sheet, between 0, 1, 2, 3, 5, 8, 13 ms ago | symlog |
    | 12–15 | head velocity from the encoder, 0, 1, 2, 4 ms ago                           | 100 mm/s   |
    | 16–19 | last four commands sent to the drive                                       | 100 mm/s   |
    | 20    | command of the base controller for the coming period (0 if `direct`)        | 100 mm/s   |
    | 21    | set height                                                                 | mm         |
    | 22    | 1 while the supervisor's command replaces the stack's                       | 1          |
    | 23    | 1 once the approach is over                                                | 1          |
    | 24    | 1 while the supervisor holds over a hole                                    | 1          |

    `observation="raw"`: `Box(low, high, (38,), float32)`, physical.

    | index | signal                                            | unit | low   | high |
    |-------|---------------------------------------------------|------|-------|------|
    | 0–7   | measured height, 0 … 7 ms ago                     | mm   | 0     | 10.1 |
    | 8–15  | unfiltered height, 0 … 7 ms ago                   | mm   | 0     | 10.1 |
    | 16–23 | encoder position from the start, 0 … 7 ms ago     | mm   | -200  | 200  |
    | 24–31 | commands sent to the drive, 0 … 7 ms ago          | mm/s | -2000 | 2000 |
    | 32    | command of the base controller                    | mm/s | -2000 | 2000 |
    | 33    | set height                                        | mm   | 0     | 10   |
    | 34    | feed                                              | mm/s | 0     | 2000 |
    | 35–37 | override, approach over, supervisor's mode (0–6)  | 1    | 0     | 6    |

    ## Rewards

    `-0.3·ln(1 + |true error|/2 µm)` while the beam is over the sheet, `-0.3·(change of command/10 mm/s)²`, and `-100` for
    a collision. `reward={"error": 0.3, "rate": 0.3, "collision": 100}` changes the weights. `info` holds each term raw and
    weighted, besides the true gap, the measured height, the errors (mm) and `cost` (1 for a collision).

    ## Starting State

    The head rests at the set height above the sheet (higher in `descent`), with the filter full. The scenario's seed
    fixes machine, sheet and noise; it is drawn from the split (`train`: 10 000 and up, `tune`: 0–999, `test`: 1000–1199).
    `reset(seed=s)` starts a sequence of episodes; `reset(options={"scenario_seed": n})` asks for one particular episode.
    For `tune` and `test` the sequence goes through the split in order, from `s` on.

    ## Episode End

    1. Termination: the nozzle touches the sheet.
    2. Truncation: the scenario's duration is over (3 s, 3000 steps in the following suite).

    ## Arguments

    | argument      | default             | meaning                                                                     |
    |---------------|---------------------|-----------------------------------------------------------------------------|
    | `scenario`    | `"wavy"`            | name, TOML file, `Scenario`, suite (`"following"`), or a list: one is drawn per episode |
    | `control`     | `"residual"`        | what the action does, see above                                             |
    | `observation` | `"features"`        | or `"raw"`                                                                  |
    | `split`       | `"train"`           | seeds: `train`, `tune`, `test`, `reserve`                                   |
    | `reward`      | `None`              | weights that differ from the default                                        |
    | `base`        | `"xi2023-improved"` | controller that `residual` and `schedule` start from; any name `kerfgym list` shows |
    | `machine`     | `None`              | tables that change the scenario's plant: `{"axis": {"dead_time": 0.003}}`    |
    | `max_steps`   | `None`              | shorter episodes, for training                                              |
    | `render_mode` | `None`              | `"rgb_array"`                                                                |

    ## Vectorised environment

    The kernel steps one machine or thousands; the same scenario seed gives the same bits in either.

    ## Version History

    * v0: first version.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(
        self,
        scenario: Any = "wavy",
        control: Literal["direct", "residual", "schedule"] = "residual",
        observation: Literal["features", "raw"] = "features",
        split: str = "train",
        reward: dict[str, float] | None = None,
        base: Any = "xi2023-improved",
        machine: dict[str, Any] | None = None,
        max_steps: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        for value, allowed, what in (
            (control, CONTROLS, "control"), (observation, OBSERVATIONS, "observation"), (split, scenarios.SPLITS, "split"),
            (render_mode or "rgb_array", self.metadata["render_modes"], "render_mode"),
        ):  # fmt: skip
            if value not in allowed:
                raise InvalidInput(f"unknown {what} '{value}'; {did_you_mean(str(value), allowed)}")
        self.scenarios = _scenarios(scenario, machine)
        self.control, self.split, self.render_mode = control, split, render_mode
        self.base = stacks.resolve("idle" if control == "direct" else base)
        if self.base.python is not None:
            raise InvalidInput(f"base controller '{self.base.name}' is plain Python; a base must be a compiled law")
        if max_steps is not None and max_steps < 1:
            raise InvalidInput(f"max_steps = {max_steps} is out of range; at least 1")
        self.max_steps = max_steps
        self.weights = _weights(reward)
        self._fleet = Fleet(1, self.base.law, heads.POOL)
        if control == "schedule":
            self._fleet.widest_window(LONGEST_WINDOW, LARGEST_TRIM)

        count = 3 if control == "schedule" else 1
        self.action_space = gym.spaces.Box(-1.0, 1.0, (count,), np.float32)
        self.observation_space = _observation_space(observation)
        self._actions = np.zeros(count, np.float32)
        self._view = self._actions.data  # writes a number three times as fast as the array does
        self._observation = np.zeros(self.observation_space.shape, np.float32)
        self._reward, self._info = np.zeros(1), np.zeros(len(INFO))
        self._weights = np.array(self.weights)
        self._io = np.array(_Io(
            self._actions.ctypes.data, self._observation.ctypes.data, self._reward.ctypes.data, self._info.ctypes.data,
            self._weights.ctypes.data, CONTROLS.index(control), int(observation == "raw"), self._observation.size, count,
        ), np.uint64)  # fmt: skip
        self._fleet.hook(stage_address(act), stage_address(observe), self._io)
        self._advance, self._shape = self._fleet.stepper(), self._actions.shape
        self._observed, self._values = self._observation.copy, self._info.tolist
        self._episode, self._seed, self._left = 0, 0, 0
        self._film: Film | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Starts an episode; see *Starting State*.

        Raises:
            InvalidInput: unknown option, or a scenario seed that is not in the split.
        """
        super().reset(seed=seed)
        if seed is not None or self._episode == 0:
            self._seed = seed if seed is not None else int(self.np_random.integers(2**31))
            self._episode = 0
        scenario_seed = self._scenario_seed(options or {})
        which = int(lanes.mix(scenario_seed, 7) % np.uint64(len(self.scenarios)))
        self.scenario, self.scenario_seed = self.scenarios[which], scenario_seed
        self._episode += 1
        self._left = min(self.scenario.steps, self.max_steps or self.scenario.steps)
        begin(self._fleet, self.scenario, self.base, scenario_seed)
        if self.render_mode:
            self._film = Film(self.scenario, self.base.name, scenario_seed)
            self._film.take(self._fleet)
        return self._observed(), _named(self._values())

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        """One control period of 1 ms.

        Raises:
            InvalidInput: the action has the wrong shape or is not finite.
        """
        if self._left <= 0:
            raise InvalidInput("the episode is over; call reset() before step()")
        a = action if isinstance(action, np.ndarray) else np.asarray(action, np.float32)
        if a.shape != self._shape:
            raise InvalidInput(f"the action has shape {a.shape}; it must be {self._shape}")
        for i, x in enumerate(a.tolist()):
            if not -LARGEST <= x <= LARGEST:  # NaN neither
                raise InvalidInput(f"the action {action} is not finite; allowed: -1 to 1")
            self._view[i] = x
        self._advance()
        self._left -= 1
        if self._film is not None:
            self._film.take(self._fleet)
        values = self._values()
        terminated = values[_COST] > 0.5
        truncated = self._left <= 0 and not terminated
        if terminated:
            self._left = 0
        reward = values[_WEIGHTED] + values[_WEIGHTED + 1] + values[_WEIGHTED + 2]
        return self._observed(), reward, terminated, truncated, _named(values)

    def render(self) -> np.ndarray | None:
        """The machine now: sheet, nozzle, gap, set height, and the last second of true and reported error."""
        return self._film.frame() if self._film else None

    def _scenario_seed(self, options: dict[str, Any]) -> int:
        unknown = [key for key in options if key != "scenario_seed"]
        if unknown:
            raise InvalidInput(f"unknown option '{unknown[0]}'; {did_you_mean(unknown[0], ['scenario_seed'])}")
        seeds = scenarios.SPLITS[self.split]
        if "scenario_seed" in options:
            asked = int(options["scenario_seed"])
            if asked not in seeds:
                raise InvalidInput(
                    f"scenario_seed = {asked} is not in split '{self.split}': {seeds.start} to {seeds.stop - 1}"
                )
            return asked
        if self.split == "train":
            return seeds.start + int(lanes.mix(self._seed, self._episode) % np.uint64(len(seeds)))
        return seeds.start + (self._seed + self._episode) % len(seeds)


def _named(values: list[float]) -> dict[str, float]:
    """``dict(zip(INFO, values))`` in half the time; a step is too short for more."""
    gap, height, error, reported, cost, scored, mode, override, distance, e, r, c, we, wr, wc = values
    return {
        "true_gap": gap, "measured_height": height, "true_error": error, "reported_error": reported, "cost": cost,
        "scored": scored, "mode": mode, "override": override, "distance": distance, "reward_error": e,
        "reward_rate": r, "reward_collision": c, "weighted_error": we, "weighted_rate": wr, "weighted_collision": wc,
    }  # fmt: skip


def _scenarios(scenario: Any, changes: dict[str, Any] | None) -> list[Scenario]:
    """One or several scenarios from what the user gave."""
    if isinstance(scenario, str) and scenario in scenarios.suites():
        found = list(scenarios.suite(scenario).values())
    elif isinstance(scenario, list | tuple):
        found = [scenarios.load(s) for s in scenario]
    else:
        found = [scenarios.load(scenario)]
    if not found:
        raise InvalidInput("scenario is an empty list; at least one is needed")
    return [s.varied(**changes) for s in found] if changes else found


def _weights(reward: dict[str, float] | None) -> Reward:
    for name, value in (reward or {}).items():
        if name not in Reward._fields:
            raise InvalidInput(f"unknown reward term '{name}'; {did_you_mean(name, Reward._fields)}")
        if not np.isfinite(value) or value < 0:
            raise InvalidInput(f"reward.{name} = {value} is out of range; allowed: 0 and up")
    return Reward()._replace(**(reward or {}))


def _observation_space(observation: str) -> gym.spaces.Box:
    if observation == "features":
        return gym.spaces.Box(-LIMIT, LIMIT, (len(FEATURES),), np.float32)
    n = RAW_HISTORY
    low = np.array([0.0] * 2 * n + [-200.0] * n + [-2000.0] * (n + 1) + [0.0] * 5, np.float32)
    high = np.array([10.1] * 2 * n + [200.0] * n + [2000.0] * (n + 1) + [10.0, 2000.0, 1.0, 1.0, 6.0], np.float32)
    return gym.spaces.Box(low, high, dtype=np.float32)
