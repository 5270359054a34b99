"""Gymnasium environment: the policy corrects feed and axes along a contour."""

from typing import Any, Literal

from .tasks.job_interface import CONTOUR
from .tasks.single import SingleEnv
from .tasks.vector import KernelVectorEnv


class ContourFollowingEnv(SingleEnv):
    """
    ## Description

    A job is cut by axes with following error (Wu). Every 8 ms the policy changes the feed override and adds corrections
    to the reference of the position loops; these, the height follower and the process settings run as in `base`.

    ## Action Space

    `Box(-1, 1, (3,), float32)`:

    | | action | at ±1 |
    |-|--------|-------|
    | 0 | change of the feed override | ±0.5 of the planned feed |
    | 1 | correction of the reference to the left of the path | ±0.5 mm |
    | 2 | correction along the path | ±0.5 mm |

    Left and along are those of the path where the reference will be at the coming interpolation; with the axes' lag
    that is some mm ahead of the nozzle. Override and corrections hold in lead-ins and cuts; in rapids and while it
    pierces the machine keeps to the programme. Limits of speed and acceleration of the axes hold whatever is asked.

    ## Observation Space

    `Box(-10, 10, (46,), float32)`, names in `job_interface.FEATURES["contour"]`: contour error and lag
    (sign·log(1 + |x|) in units of 10 and 100 µm), speed and planned feed now and in 50, 100 and 200 ms over the cut's
    feed, the path's direction then against now (sine, cosine), feed override, direction, whether it is cutting, beam,
    progress, the corrections in force over 0.5 mm, the rate of the contour error (sign·log(1 + |x|), 10 µm per step),
    the direction at the reference against now (sine, cosine), and the acceleration of the planned path to the left
    (`turn`) and along (`push`) at the reference and every 16 ms from 96 ms behind to 64 ms ahead of it, over a quarter
    of what the axes can do: what axes with a linear lag do wrong is a weighted sum of these.
    `observation="raw"` gives the same in mm, mm/s and mm/s².

    ## Rewards

    Per step: −`contour`·RMS contour error of the step/10 µm while cutting, −`time`·share of the step that is lost
    against the plan, −`feed`·(feed override − 1)², −`collision` once. The process is set for the planned feed, so
    leaving it is charged either way; `feed = 0` lets the policy trade time for accuracy as it likes.

    ## Starting State

    The axes stand at the first pierce point, the head above it. `reset(seed=s)` begins the sequence of episodes `s`;
    `options={"scenario_seed": n}` asks for one scenario seed of the split.

    ## Episode End

    1. Termination: the job is done, or the nozzle touches the sheet (`info["cost"]` is 1).
    2. Truncation: three times the planned time is over, or `max_steps`.

    ## Info

    Numbers in mm, mm/s, s, W and Hz, names in `job_interface.INFO["contour"]`;
    `objectives` is the vector of contour error of the step (mm) and time (s).

    ## Arguments

    | argument      | default            | meaning                                                                     |
    |---------------|--------------------|-----------------------------------------------------------------------------|
    | `scenario`    | `"contour-square"` | name, TOML file, `Scenario`, suite, or a list: one is drawn per episode     |
    | `path`        | `None`             | drawing or programme (DXF, SVG, G-code) in place of the scenario's part     |
    | `control`     | `"residual"`       | the action is added to what `base` does                                     |
    | `observation` | `"features"`       | or `"raw"`                                                                  |
    | `split`       | `"train"`          | seeds: `train`, `tune`, `test`, `reserve`                                   |
    | `reward`      | `None`             | weights that differ from the default                                        |
    | `base`        | `"wu"`             | does what the action leaves open: `"z=pid,xy=wu,process=recipe"`            |
    | `machine`     | `None`             | a machine's name or file, or changes: `{"gantry": {"preset": "modern"}}` |
    | `max_steps`   | `None`             | shorter episodes, for training                                              |
    | `render_mode` | `None`             | `"rgb_array"`                                                               |
    | `colour`      | `"standoff"`       | of the kerf: `standoff`, `contour`, `dross`, `roughness`                    |

    ## Vectorised environment

    `gymnasium.make_vec(id, num_envs=256)` gives the same machines in one kernel; the same scenario seed gives the same
    bits in either.

    ## Version History

    * v0: first version. Before release 1.0 its spaces and rewards may change; policies say for which they were made.
    """

    TASK = CONTOUR

    def __init__(
        self,
        scenario: Any = "contour-square",
        control: Literal["residual"] = "residual",
        observation: Literal["features", "raw"] = "features",
        split: str = "train",
        reward: dict[str, float] | None = None,
        base: Any = "wu",
        machine: Any = None,
        path: str | None = None,
        max_steps: int | None = None,
        render_mode: str | None = None,
        colour: str = "standoff",
    ) -> None:
        super().__init__(
            render_mode, scenario=scenario, control=control, observation=observation, split=split, reward=reward,
            base=base, machine=machine, path=path, max_steps=max_steps, colour=colour,
        )  # fmt: skip


class ContourFollowingVectorEnv(KernelVectorEnv):
    """``num_envs`` environments of :class:`ContourFollowingEnv` in one kernel; see :class:`vector.KernelVectorEnv`."""

    SINGLE = ContourFollowingEnv
