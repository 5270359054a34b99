"""One fault told from period to period, with what came of it in each repetition."""

from ....envs import scenarios
from ....envs.control import stack as stacks
from ....envs.engine.quantity import InvalidInput
from ....envs.plant import machine, supervisor
from ...report.terminal import TextTable
from .campaign import SCENARIOS
from .culprits import judged
from .drawn import drawn, words
from .inject import Without, check
from .trials import REPEATS, fleet_for, repeats

BEFORE, AFTER = 3, 60
"""Periods that are told before a fault and after its end."""


def story(case: str, seed: int = 0) -> list[TextTable]:
    """Two tables about the fault ``CONTROLLER/SCENARIO/NUMBER``: its repetitions, and the course of the shipped run.

    Raises:
        InvalidInput: ``case`` is not of that form, or names something unknown.
    """
    pieces = case.rsplit("/", 2)
    if len(pieces) != 3 or not pieces[2].isdigit():
        raise InvalidInput(f"--case {case}: allowed: CONTROLLER/SCENARIO/NUMBER, such as lqg/{SCENARIOS[0]}/12")
    stack, scenario = check(stacks.resolve(pieces[0])), scenarios.load(pieces[1])
    given = [drawn(pieces[1], int(pieces[2]), seed)]
    found, verdict = repeats(scenario, stack, given, list(REPEATS)), judged(scenario, stack, given).iloc[0]
    rows = []
    for name, r in found.items():
        alarm = supervisor.ALARMS[int(r.alarm[0])]
        rows.append([name, "yes" if r.lost[0] else "no", f"{r.lowest[0]:.3f}", f"{r.apart[0]:.3f}", alarm])
    why = f"cause: {verdict['cause']}." if verdict["cause"] else f"not lost; excess: {verdict['excess'] or 'none'}."
    title = f"{pieces[0]} · {pieces[1]}, seed {given[0].seed} · {given[0].name}: {words(given[0].fault)}"
    ways = TextTable(title, ["run", "lost", "lowest gap, mm", "moved by the fault, mm", "alarm"], [rows], [why])
    return [ways, _course(scenario, stack, given)]


def _course(scenario: scenarios.Scenario, stack: stacks.Stack, given: list) -> TextTable:
    fault = given[0].fault
    fleet = fleet_for(scenario, stack, given, Without())
    first = int(fault.start) - BEFORE
    count = min(int(fault.length) + BEFORE + AFTER, scenario.steps - first)
    fleet.advance(first - 1)
    record, rows = fleet.start_recording(count), []
    wishes = []
    for _ in range(count):
        fleet.advance()
        hand, wish = fleet.get("hand"), float(fleet.slots(machine.WISH, 1)[0])
        wishes.append(hand.gain * wish + hand.residual)
    names = {name: i for i, name in enumerate(machine.CHANNELS)}
    for i in range(count):
        x = record[i, :, 0]
        spoilt = "×" if fault.start <= first + i < fault.start + fault.length else ""
        heights = [f"{x[names[k]]:.3f}" for k in ("gap", "raw_height", "height")]
        speeds = [f"{wishes[i]:.5g}", f"{x[names['command']]:.5g}", f"{x[names['velocity']]:.1f}"]
        rows.append([f"{first + i}", spoilt, *heights, *speeds, supervisor.MODES[int(x[names["mode"]])]])
    notes = ["wish: what the supervisor gets after this period; command: what the drive got in it, mm/s."]
    titles = ["ms", "fault", "gap, mm", "raw height", "height", "wish", "command", "velocity", "mode"]
    return TextTable("the shipped run", titles, [rows], notes)
