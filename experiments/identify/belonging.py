"""Whether a log and a calibration table are of the same head."""

import numpy as np

from ...envs.engine.quantity import InvalidInput
from ...envs.plant import calibration
from . import head
from .log import Log

USUAL, OVER = 0.01, {"motion": 0.04}
"""Share above a table's highest frequency that a log may have: some; a motion log goes far above its heights."""


def doubts(table: calibration.Table, logs: list[Log], whose: str = "the sweep's") -> list[str]:
    """Warnings about a table, or a sweep, of another head: frequencies that it does not have, and heights of a rest log
    that are other ones by it.

    Raises:
        InvalidInput: frequencies that lie further above the table's than the way of its log goes beyond it.
    """
    said: list[str] = []
    low, highest = 0.99 * float(table.frequency[0]), float(table.frequency[-1])
    for log in logs:
        if "frequency" not in log:
            continue
        f, over = log["frequency"], OVER.get(log.protocol, USUAL)
        where = f"{log.name}, line {{}}, column frequency: {{:.7g}} Hz"
        off = np.flatnonzero(f > (1 + over) * highest)
        if len(off) > 0.01 * len(f):
            raise InvalidInput(
                where.format(off[0] + 2, f[off[0]]) + f" lies over {over:.0%} above {whose} highest, "
                f"{table.frequency[-1]:.7g} Hz; is that of another head?"
            )
        below = np.flatnonzero((f < low) & (f > 0))
        if len(below) > 0.01 * len(f) and log.protocol != "sweep":  # which touches
            said.append(
                where.format(below[0] + 2, f[below[0]]) + f" lies over 1 % below {whose} lowest, "
                f"{table.frequency[0]:.7g} Hz; is that of another head?"
            )
        elif log.protocol == "rest":
            said += _heights(table, log, where, whose)
    return said


def _heights(table: calibration.Table, log: Log, where: str, whose: str) -> list[str]:
    """Warns where the head rose from rest to rest by another way than the table says, over 5 % of it."""
    stood = [(part, at) for part, at in head.rests(log) if np.any(log["frequency"][part] > 0)]
    middle = [float(np.median(f[f > 0])) for f in (log["frequency"][part] for part, _ in stood)]
    read = np.interp(middle, table.frequency, table.height)
    for i in range(1, len(stood)):
        rose, told = stood[i][1] - stood[i - 1][1], float(read[i] - read[i - 1])
        if read[i] < table.height[-1] and abs(rose) > 0.3 and abs(told - rose) > 0.05 * abs(rose):
            line = stood[i][0].start + 2
            return [
                where.format(line, middle[i]) + f" is {told:+.3g} mm from the rest before it by {whose} table, and the "
                f"encoder says {rose:+.3g} mm; within 5 % is usual; is that table of another head?"
            ]
    return []
