"""Gymnasium environment of the height follower: the policy moves the cutting head, the machine does the rest."""

from typing import Any, Literal

from .tasks.interface import TASK
from .tasks.single import SingleEnv
from .tasks.vector import KernelVectorEnv


class HeightFollowingEnv(SingleEnv):
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
    | `"weights"`  | k | weights of the signals that the base's law adds up | − its span | its span | each its own |

    With `"weights"` the action is added to the weights that the law takes itself, so 0 leaves the base as it is. There is
    a number for each of the law's `WEIGHTS`; `"weights"` and `observation="sheet"` need a base whose law declares them.

    ## Observation Space

    `observation="features"`: `Box(-10, 10, (32,), float32)`, normalised. symlog(x) = sign(x)·ln(1 + |x|/2 µm)/5.

    | index | signal                                                                     | unit       |
    |-------|----------------------------------------------------------------------------|------------|
    | 0–5   | measured height − set height, 0, 1, 2, 3, 5, 8 ms ago                       | symlog     |
    | 6–11  | change of (encoder − unfiltered height), the sheet, between 0, 1, 2, 3, 5, 8, 13 ms ago; from 1 ms ago on a median of three readings around, from 3 ms ago on of five, which leave out impulses | symlog |
    | 12–15 | head velocity from the encoder, 0, 1, 2, 4 ms ago                           | 100 mm/s   |
    | 16–19 | last four commands sent to the drive                                       | 100 mm/s   |
    | 20    | command of the base controller for the coming period (0 if `direct`)        | 100 mm/s   |
    | 21    | set height                                                                 | mm         |
    | 22    | 1 while the supervisor's command replaces the stack's                       | 1          |
    | 23    | 1 once the approach is over                                                | 1          |
    | 24    | 1 while the supervisor holds over a hole                                    | 1          |
    | 25    | how far the head has moved in 8 ms, running mean over 64 ms                 | symlog     |
    | 26–27 | size of how it moves otherwise, running mean of the symlog over 64 and 256 ms | 1        |
    | 28–29 | size of measured height − set height, running mean of the symlog over 64 and 256 ms | 1  |
    | 30–31 | measured height − set height, running mean over 64 and 256 ms               | symlog     |

    A running mean y takes in each x by y += (x − y)/n, n in periods; it begins at 0. They tell a policy how restless the
    sheet is, which 13 ms do not show, and where it is wrong on average.

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

    `observation="sheet"`: `Box(-10, 10, (k,), float32)`: what the base's law says of sheet, noise and drive, its
    `FEATURES`. They hardly depend on what the policy does, since the sheet is encoder minus reading.

    ## Rewards

    `-0.3·ln(1 + |true error|/2 µm)` while the beam is over the sheet, `-0.3·(change of command/10 mm/s)²`, and `-100` for
    a collision. `reward={"error": 0.3, "rate": 0.3, "collision": 100, "tolerance": 0.002}` changes the weights, and the
    2 µm (in mm). `info` holds each term raw and weighted, besides the true gap, the measured height, the errors (mm) and `cost` (1 for a collision).

    ## Starting State

    The head rests at the set height above the sheet (higher in `descent`), with the filter full. The scenario's seed
    fixes machine, sheet and noise; it is drawn from the split (`train`: 10 000 and up, `tune`: 0–999, `test`: 1000–1199).
    `reset(seed=s)` starts a sequence of episodes; `reset(options={"scenario_seed": n})` asks for one particular episode.
    For `tune` and `test` the sequence goes through the split in order, from `s` on.

    ## Episode End

    1. Termination: the nozzle touches the sheet.
    2. Truncation: the scenario's duration is over (3 s or 3000 steps in most of the following suite, 300 s in `shift`).

    ## Arguments

    | argument      | default             | meaning                                                                     |
    |---------------|---------------------|-----------------------------------------------------------------------------|
    | `scenario`    | `"wavy"`            | name, TOML file, `Scenario`, suite (`"following"`), or a list: one is drawn per episode |
    | `control`     | `"residual"`        | what the action does, see above                                             |
    | `observation` | `"features"`        | or `"raw"`, `"sheet"`                                                       |
    | `split`       | `"train"`           | seeds: `train`, `tune`, `test`, `reserve`                                   |
    | `reward`      | `None`              | weights that differ from the default                                        |
    | `base`        | `"xi2023-improved"` | controller that `residual` and `schedule` start from; any name `kerfgym list` shows |
    | `machine`     | `None`              | a machine's name or file, or changes: `{"axis": {"dead_time": 0.003}}` |
    | `max_steps`   | `None`              | shorter episodes, for training                                              |
    | `render_mode` | `None`              | `"rgb_array"`                                                                |

    ## Vectorised environment

    The kernel steps one machine or thousands; the same scenario seed gives the same bits in either.

    ## Version History

    * v0: first version.
    """

    TASK = TASK
    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(
        self,
        scenario: Any = "wavy",
        control: Literal["direct", "residual", "schedule", "weights"] = "residual",
        observation: Literal["features", "raw", "sheet"] = "features",
        split: str = "train",
        reward: dict[str, float] | None = None,
        base: Any = "xi2023-improved",
        machine: Any = None,
        max_steps: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(
            render_mode, scenario=scenario, control=control, observation=observation, split=split, reward=reward,
            base=base, machine=machine, max_steps=max_steps,
        )  # fmt: skip

    def _info(self) -> dict[str, Any]:
        # ``dict(zip(names, values))`` takes twice as long; a step of 1 ms is too short for that.
        gap, height, error, reported, cost, scored, mode, override, distance, e, r, c, we, wr, wc = self._values()
        return {
            "true_gap": gap, "measured_height": height, "true_error": error, "reported_error": reported, "cost": cost,
            "scored": scored, "mode": mode, "override": override, "distance": distance, "reward_error": e,
            "reward_rate": r, "reward_collision": c, "weighted_error": we, "weighted_rate": wr,
            "weighted_collision": wc,
        }  # fmt: skip


class HeightFollowingVectorEnv(KernelVectorEnv):
    """
    ## Description

    ``num_envs`` environments of :class:`HeightFollowingEnv` in one kernel:
    ``gymnasium.make_vec("kerfgym/HeightFollowing-v0", num_envs=256)``. Spaces, rewards, scenarios and arguments are
    those of the single environment, and so are the bits: environment ``i`` of ``reset(seed=s)`` lives through the
    episodes of a single environment that was reset with ``seed=s + i``.

    ## Episode End

    ``autoreset_mode`` is one of Gymnasium's three.

    | mode         | what happens to an environment whose episode is over                                       |
    |--------------|--------------------------------------------------------------------------------------------|
    | `NextStep`   | the next step ignores its action and begins its next episode (reward 0)                    |
    | `SameStep`   | the same step begins its next episode; `final_obs` and `final_info` hold how the last ended |
    | `Disabled`   | nothing; it must be reset with `options={"reset_mask": mask}` before the next step          |

    ## Info

    A float64 array of shape `(num_envs,)` for each entry of the single environment's `info`, with its mask `_name`.

    ## Arguments

    | argument         | default      | meaning                                                        |
    |------------------|--------------|----------------------------------------------------------------|
    | `num_envs`       | `1`          | environments                                                   |
    | `num_threads`    | `1`          | threads that step them; they sleep while they wait             |
    | `autoreset_mode` | `"NextStep"` | see above                                                      |
    | others           |              | those of the single environment, the same for all              |
    """

    SINGLE = HeightFollowingEnv
