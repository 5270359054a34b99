"""The compiled X/Y half and cut against the same equations in plain NumPy, over whole jobs, period by period."""

import functools
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import team
from kerfgym.envs.plant import cut as cut_model
from kerfgym.envs.plant import gantry, heads, published, spot, xy_axes
from kerfgym.envs.plant.controller import Process
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.tasks import workshop
from kerfgym.tests.oracle.xy_machine import SUMS, XYMachine

PERIODS = 1900
SMALL = scenarios.Scenario(
    name="small", job=scenarios.Job(part="square", size=5.0, material="mild-steel", thickness=3.0, lead_in=1.0),
    sheet=scenarios.Sheet(waves=(scenarios.Wave(amplitude=0.1, wavelength=60.0),)),
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A machine that differs from ``bare`` in something."""

    scenario: dict[str, Any] = field(default_factory=dict)
    axes: str = "wu"
    columns: dict[str, float] = field(default_factory=dict)
    law: dict[str, float] = field(default_factory=dict)  # of the axes
    process: dict[str, float] = field(default_factory=dict)  # of the recipe's law
    hand: float = 0.0  # mm, of random corrections


CASES = {
    "bare": Case(),
    "literal": Case({"gantry": {"literal": True}}),
    "modern": Case({"gantry": {"preset": "modern"}}, axes="wu-stiff"),
    "feed-forward": Case(axes="wu-feedforward"),
    "stiff": Case(axes="wu-stiff"),
    "gains of directions": Case(
        {"gantry": {"x_plus": 1.1, "x_minus": 0.9, "y_plus": 0.95}}, law={"x_plus": 0.8, "y_minus": 1.2}
    ),
    "zero of the drive": Case(columns={"xy.tau": 0.003}),
    "coarse D/A": Case(columns={"xy.dac": 1.5}),
    "coarse encoder": Case(columns={"xy.encoder": 0.05}),
    "ideal converters": Case(columns={"xy.dac": 0.0, "xy.encoder": 0.0}),
    "limit of speed": Case(columns={"xy.speed": 12.0}),
    "limit of acceleration": Case(columns={"xy.acceleration": 250.0}, law={"kp": 1.2}),
    "servo of 2 ms": Case(columns={"xy.servo": 2.0, "xy.interpolation": 6.0}),
    "no patience": Case(columns={"journey.patience": 24.0, "xy.x_minus": 0.05}),
    "corrections": Case(hand=0.3, columns={"journey.corrections": 0.2}),
    "constant feed": Case(axes="wu-no-corners"),
    "gear": Case({"job": {"part": "gear", "size": 8.0}}, law={"kp": 0.3}),
    "slow": Case(process={"override": 0.3}),
    "fast": Case(process={"override": 1.9}),
    "power": Case(process={"power": 0.7}),
    "dither": Case(process={"frequency": 1500.0, "x": 0.2, "y": 0.1, "z": 0.8, "focus": 0.6}),
    "hat": Case({"optics": {"shape": "hat"}}, process={"frequency": 3000.0, "x": 0.25, "y": 0.25}),
    "along the path": Case({"optics": {"along": True}}, process={"frequency": 900.0, "x": 0.2, "y": 0.05}),
    "slow dither": Case(process={"frequency": 60.0, "x": 0.1, "y": 0.1}),
    "beyond the optics": Case(
        columns={"optics.highest": 700.0, "optics.galvo_range": 0.05, "optics.piezo_range": 0.3},
        process={"frequency": 1500.0, "x": 0.2, "y": 0.1, "z": 0.8, "focus": -0.6},
    ),
    "standoff": Case(process={"standoff": 0.4}),
    "standoff of the machine": Case({"job": {"standoff": -0.2, "pressure": 0.8}}),
    "published": Case(
        {"job": {"material": "c45-10", "thickness": 10.0}},
        process={"override": 1.5, "power": 1.1, "frequency": 2000.0, "x": 0.25, "y": 0.3, "z": 2.0, "focus": 0.4},
    ),
    "far off": Case(process={"focus": 4.0, "power": 0.3}),
}
NAMES = list(CASES)

TUPLES = {
    "xy": xy_axes.Params, "recipe": gantry.Recipe, "optics": spot.Params, "cut": cut_model.Params,
    "published": published.Range, "journey": gantry.Journey,
}  # fmt: skip

AXES = {
    "x.position": "x.position", "y.position": "y.position", "x.issued": "x.issued", "y.issued": "y.issued",
    "x.command": "x.command", "y.command": "y.command", "x.summed": "x.summed", "progress.tau": "tau",
    "progress.override": "override", "progress.near": "near", "progress.aloft": "aloft", "progress.waited": "waited",
    "progress.dx": "dx", "progress.dy": "dy", "velocities.x": "x.velocity", "velocities.y": "y.velocity",
}  # fmt: skip
SHOWN = (
    "planned", "planned_50", "planned_100", "planned_200", "speed", "override", "lag", "contour_error", "height",
    "set_height", "phase", "beam", "progress", "thickness", "nominal_power", "standoff", "feed", "tangent_x",
    "tangent_y", "gap", "margin", "dross", "roughness",
)  # fmt: skip


@dataclass(frozen=True)
class Runs:
    """What both machines did, by channel: shape (periods, cases)."""

    kernel: dict[str, np.ndarray]
    wanted: dict[str, np.ndarray]


def _value(oracle: XYMachine, path: str) -> np.ndarray:
    value: Any = oracle
    for name in path.split("."):
        value = getattr(value, name)
    return np.array(value, float)


@functools.cache
def runs(process: str) -> Runs:
    """All cases as machines of one fleet under a law of the process."""
    base, every = team(f"xy=wu,process={process}"), np.arange(len(NAMES))
    fleet = Fleet(len(NAMES), base.z.law, heads.POOL)
    g = fleet.use_gantries(base.xy.law, base.process.law)
    jobs, law = [], {}
    for i, case in enumerate(CASES.values()):
        scenario, control = SMALL.varied(**case.scenario), team(f"xy={case.axes},process={process}")
        workshop.prepare(fleet, scenario, control, [i], [1000 + i])
        jobs.append(workshop.programme(scenario, control))
        control.install(fleet, [i])
        for column, value in case.columns.items():
            g.set(column, [i], value)
        axes = control.xy.part("law")._replace(**case.law)
        g.put_law("xy", [i], axes)
        law = {name: [*law.get(name, []), value] for name, value in axes._asdict().items()}
        if process == "recipe":
            for name, value in case.process.items():
                g.set_law("process", name, [i], value)
    parts: dict[str, Any] = {
        name: SimpleNamespace(**{f: g.column(f"{name}.{f}") for f in cls._fields}) for name, cls in TUPLES.items()
    }
    parts["law"] = SimpleNamespace(**{name: np.array(values) for name, values in law.items()})
    oracle = XYMachine(jobs, parts)
    fleet.begin(every, scenarios.noise_keys(1000 + every))

    def wish() -> dict[str, np.ndarray]:
        return {name: g.column(f"wish.{name}") for name in Process._fields}

    def z_half() -> list[np.ndarray]:
        return [fleet.column(f"signals.{name}") for name in ("gap", "height", "set_height")]

    gap, height, set_height = z_half()
    oracle.ready(wish(), height, gap, set_height)
    kernel: dict[str, list[np.ndarray]] = {}
    wanted: dict[str, list[np.ndarray]] = {}
    rng, most = np.random.default_rng(15), np.array([case.hand for case in CASES.values()])
    for period in range(PERIODS):
        if period % 8 == 0:
            oracle.hand_x, oracle.hand_y = (most * rng.uniform(-1.0, 1.0, len(NAMES)) for _ in range(2))
            g.set("hand.dx", every, oracle.hand_x)
            g.set("hand.dy", every, oracle.hand_y)
        fleet.advance()
        gap, height, set_height = z_half()
        oracle.step(gap, height, set_height, fleet.column("course.scored"), wish())
        rows = {name: (g.column(name), _value(oracle, path)) for name, path in AXES.items()}
        rows |= {f"sums.{name}": (g.column(f"sums.{name}"), oracle.sums[name]) for name in SUMS}
        rows |= {f"figures.{n}": (g.column(f"figures.{n}"), v) for n, v in oracle.figures.items()}
        rows |= {f"realised.{n}": (g.column(f"realised.{n}"), v) for n, v in oracle.realised.items()}
        rows |= {f"applied.{n}": (g.column(f"applied.{n}"), v) for n, v in oracle.applied.items()}
        rows |= {f"shown.{n}": (g.column(f"process_signals.{n}"), oracle.seen[n]) for n in SHOWN}
        rows["set height"] = fleet.column("job.set_height"), oracle.set_height
        rows["sheet ahead x"] = fleet.column("journey.x"), oracle.trail[-1]["x"]
        rows["sheet here"] = fleet.column("journey.here"), oracle.now["s"]
        for name, (one, other) in rows.items():
            kernel.setdefault(name, []).append(one)
            wanted.setdefault(name, []).append(other)
    return Runs({n: np.array(v, float) for n, v in kernel.items()}, {n: np.array(v, float) for n, v in wanted.items()})


# The kernel's polynomials for exponential, logarithm and power, good to 1e-9 and better, and its order of summing.
ABSOLUTE, RELATIVE = 1e-9, 1e-7


@pytest.mark.parametrize("process", ["recipe", "huang2024-adjusting"])
@pytest.mark.parametrize("name", NAMES)
def test_the_gantry_runs_and_cuts_as_its_equations_say(process, name):
    run, i = runs(process), NAMES.index(name)
    worst = {}
    for channel, wanted in run.wanted.items():
        off = np.abs(run.kernel[channel][:, i] - wanted[:, i]) - ABSOLUTE - RELATIVE * np.abs(wanted[:, i])
        if not off.max() <= 0.0:
            worst[channel] = (int(np.argmax(off > 0.0)), float(off.max()))
    assert not worst


@pytest.mark.parametrize("name", [name for name in NAMES if name != "bare"])
def test_each_case_shows_in_the_motion_or_in_the_cut(name):
    wanted, i = runs("recipe").wanted, NAMES.index(name)
    shown = ("x.position", "figures.margin", "figures.roughness", "set height", "x.command")
    assert max(np.abs(wanted[channel][:, i] - wanted[channel][:, 0]).max() for channel in shown) > 1e-4


def test_the_cases_reach_what_they_are_about():
    wanted = {channel: dict(zip(NAMES, v.T, strict=True)) for channel, v in runs("recipe").wanted.items()}
    assert np.abs(wanted["x.command"]["limit of speed"]).max() == 12.0
    assert wanted["progress.waited"]["no patience"].max() >= 24.0
    assert wanted["progress.waited"]["bare"].max() > 0.0
    assert 0.19 < np.abs(wanted["progress.dx"]["corrections"]).max() <= 0.2
    assert wanted["progress.override"]["slow"].min() == pytest.approx(0.3)
    assert wanted["progress.override"]["fast"].max() > 1.2
    assert wanted["realised.focus"]["dither"].max() == pytest.approx(0.6 - 0.02 * 5.0)
    assert wanted["realised.frequency"]["beyond the optics"].max() == 700.0
    assert wanted["applied.x"]["published"].max() <= 0.3
    assert (wanted["sums.length"]["bare"][-1]) > 15.0
    assert wanted["figures.through"]["far off"].min() == 0.0
