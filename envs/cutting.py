"""Gymnasium environment: the policy sets the process of a cut."""

from typing import Any, Literal

from .tasks.job_interface import CUTTING
from .tasks.single import SingleEnv
from .tasks.vector import KernelVectorEnv


class CuttingEnv(SingleEnv):
    """
    ## Description

    The whole machine cuts a job; the policy is the *trajectory-parameter adjusting unit* of Huang2024: every 8 ms it
    sets feed override, laser power, dither, focus and standoff. Position loops and height follower run as in `base`.

    ## Action Space

    `Box(-1, 1, (8,), float32)`; `control="residual"` adds to the command of the base's process control,
    `control="direct"` takes its place.

    | | action | residual at ±1 | direct, −1 to 1 | `extrapolate`, direct |
    |-|--------|----------------|-----------------|-----------------------|
    | 0 | feed override | ±0.5 | 3.33 to 16.7 mm/s | 0 to the scenario's limit (2) |
    | 1 | laser power, of the nominal | ±0.2 | 1 | 0 to the scenario's limit (1 in the suite) |
    | 2 | frequency of the dither | ±2 kHz | 2 to 4 kHz | 0 to 4 kHz |
    | 3 | amplitude of the dither in x | ±0.15 mm | 0 to 0.3 mm | 0 to 0.3 mm |
    | 4 | amplitude of the dither in y | ±0.15 mm | 0 to 0.3 mm | 0 to 0.3 mm |
    | 5 | amplitude of the focus' dither | ±1 mm | 0 to 1 mm at 2 kHz, to 5 mm at 4 kHz | 0 to 5 mm |
    | 6 | offset of the focus, up positive | ±1 mm | ±0.1 mm | ±5 mm |
    | 7 | standoff, added to the nominal | ±0.3 mm | ±0.05 mm | ±1 mm |

    What comes out is limited to the settings that were published of the material (`envs/figures/evidence.py`; for C45
    by Huang2024): the third column, with equal amplitudes in x and y, the smaller of the two, and a feed of at most
    8.33 mm/s without dither, 16.7 mm/s with ±0.3 mm of it. `extrapolate=True` leaves only what the optics, the recipe
    and the axes allow.

    What was published is more than what the figures of the cut were calibrated on: no cut at another frequency than 2
    kHz or with more than ±1 mm of focus dither has a published result. Outside the calibrated settings figures are
    *extrapolated*: `info` says by how much, and a benchmark does not rank them. Of materials whose coefficients are
    assumed nothing was published: they are not limited, and always marked. The override holds in lead-ins and cuts;
    rapids and piercing take the time they take.

    ## Observation Space

    `Box(-10, 10, (31,), float32)`, names in `job_interface.FEATURES["cutting"]`: those of ContourFollowing without the
    corrections, the measured height's error and the set height, the eight commands in force, and the cosines of two
    (`axial`) and of four times the path's angle (`diagonal`), since two axes dither the spot forth as back. The quality
    of the cut is no observation: no sensor of the machine measures it.

    ## Rewards

    Per step: −`quality`·mm cut·((dross/a + Rz/R0)/2 − 1), −`through`·mm not cut through, −`time`·share of the step that
    is lost against the plan, −`collision` once, −`outside`·mm cut outside the calibrated settings (weight 0 unless set:
    who wants to be ranked must stay inside); a and R0 are the material's coefficients. The quality model is a proxy,
    see `plant/cut.py`.

    ## Starting State

    The axes stand at the first pierce point, the head above it. `reset(seed=s)` begins the sequence of episodes `s`;
    `options={"scenario_seed": n}` asks for one scenario seed of the split.

    ## Episode End

    1. Termination: the job is done, or the nozzle touches the sheet (`info["cost"]` is 1).
    2. Truncation: three times the planned time is over, or `max_steps`.

    ## Info

    Numbers in mm, mm/s, s, W and Hz, names in `job_interface.INFO["cutting"]`;
    `objectives` is the vector of dross, roughness, share cut through of the step, and time. `extrapolated` is 1 while
    the settings lie outside those that the figures were calibrated on, `beyond_…` say by how much each does.

    ## Arguments

    | argument      | default            | meaning                                                                     |
    |---------------|--------------------|-----------------------------------------------------------------------------|
    | `scenario`    | `"cut-square"`     | name, TOML file, `Scenario`, suite, or a list: one is drawn per episode     |
    | `path`        | `None`             | drawing or programme (DXF, SVG, G-code) in place of the scenario's part     |
    | `control`     | `"residual"`       | what the action does, see above                                             |
    | `observation` | `"features"`       | or `"raw"`                                                                  |
    | `split`       | `"train"`          | seeds: `train`, `tune`, `test`, `reserve`                                   |
    | `reward`      | `None`             | weights that differ from the default                                        |
    | `base`        | `"recipe"`         | does what the action leaves open: `"z=pid,xy=wu,process=recipe"`            |
    | `machine`     | `None`             | a machine's name or file, or changes: `{"gantry": {"preset": "modern"}}` |
    | `extrapolate` | `False`            | actions and base may leave the published settings                           |
    | `max_steps`   | `None`             | shorter episodes, for training                                              |
    | `render_mode` | `None`             | `"rgb_array"`                                                               |
    | `colour`      | `"standoff"`       | of the kerf: `standoff`, `contour`, `dross`, `roughness`                    |

    ## Vectorised environment

    `gymnasium.make_vec(id, num_envs=256)` gives the same machines in one kernel; the same scenario seed gives the same
    bits in either.

    ## Version History

    * v0: first version. Before release 1.0 its spaces and rewards may change; policies say for which they were made.
    """

    TASK = CUTTING

    def __init__(
        self,
        scenario: Any = "cut-square",
        control: Literal["residual", "direct"] = "residual",
        observation: Literal["features", "raw"] = "features",
        split: str = "train",
        reward: dict[str, float] | None = None,
        base: Any = "recipe",
        machine: Any = None,
        path: str | None = None,
        extrapolate: bool = False,
        max_steps: int | None = None,
        render_mode: str | None = None,
        colour: str = "standoff",
    ) -> None:
        super().__init__(
            render_mode, scenario=scenario, control=control, observation=observation, split=split, reward=reward,
            base=base, machine=machine, path=path, extrapolate=extrapolate, max_steps=max_steps, colour=colour,
        )  # fmt: skip


class CuttingVectorEnv(KernelVectorEnv):
    """``num_envs`` environments of :class:`CuttingEnv` in one kernel; see :class:`vector.KernelVectorEnv`."""

    SINGLE = CuttingEnv
