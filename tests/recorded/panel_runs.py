"""Command sequences and a calibration as ``figures.csv`` keeps them."""

from kerfgym.baselines import sequences
from kerfgym.envs import scenarios
from kerfgym.envs.control.panel import LEVEL, Outcome, Panel

SEED = 5


def _edged(at: float) -> scenarios.Scenario:
    return LEVEL.varied(sheet={"holes": {"pitch": 2.0 * (at + 50.0), "length": 100.0, "count": 1}})


def _ended(panel: Panel, outcome: Outcome) -> dict[str, float]:
    found = {name: float(panel[name]) for name in ("gap", "height", "distance")}
    return {"done": float(outcome.done), "seconds": outcome.seconds, "lowest": panel.lowest, **found}


def staged_pierce() -> dict[str, float]:
    """From 10 mm, two stages."""
    panel = Panel(seed=SEED, gap=10.0)
    return _ended(panel, sequences.staged_pierce(panel, 1.0, ((3.0, 0.3), (1.5, 0.2))))


def frog_leap() -> dict[str, float]:
    """Of 60 mm."""
    panel = Panel(seed=SEED, gap=1.0)
    panel.follow(1.0)
    return _ended(panel, sequences.frog_leap(panel, 60.0, 5.0, 1.0))


def lift_travel_land() -> dict[str, float]:
    """Of 60 mm."""
    panel = Panel(seed=SEED, gap=1.0)
    panel.follow(1.0)
    return _ended(panel, sequences.lift_travel_land(panel, 60.0, 5.0, 1.0))


def find_edge() -> dict[str, float]:
    """At 42 mm, and where the sheet goes on."""
    panel, beyond = Panel(scenario=_edged(42.0), seed=SEED, gap=1.0), Panel(scenario=_edged(400.0), seed=SEED, gap=1.0)
    edge, none = sequences.find_edge(panel, 1.0, 50.0, 150.0), sequences.find_edge(beyond, 1.0, 50.0, 60.0)
    return {**_ended(panel, edge.outcome), "place": edge.place, "beyond": none.outcome.seconds}


def focus_compensation() -> dict[str, float]:
    """Over 200 mm, 0.4 mm in all."""
    panel = Panel(seed=SEED, gap=1.0)
    return _ended(panel, sequences.focus_compensation(panel, 200.0, 50.0, 1.0, lambda x: 0.002 * x))


def calibrate() -> dict[str, float]:
    """Quickly, and some points of the table."""
    panel = Panel(seed=SEED, gap=2.0)
    ended = _ended(panel, panel.calibrate(5.0, 5.0))
    table = panel.table
    points = {f"frequency at {table.height[i]:g} mm": float(table.frequency[i]) for i in (0, 9, 99, 399, -1)}
    return {**ended, "noise": table.noise, "usable": float(table.usable), **points}


EVERY = {
    function.__name__: function
    for function in (staged_pierce, frog_leap, lift_travel_land, find_edge, focus_compensation, calibrate)
}
