"""What a log cannot be, though each of its numbers can: a protocol that was not done, columns that do not fit together.

What would spoil an estimate is refused; what may be meant is a warning. Both name file, line, column and value, and
what is allowed. The figures are far from those of the logs of any machine that is shipped.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...envs.engine.quantity import InvalidInput
from ...envs.plant.controller import PERIOD

LONGEST = 300.0
"""s of a log; no protocol takes half of it [A]."""

FARTHEST = 500.0
"""mm of travel; no Z axis of a cutting machine has as much [A]."""

STUCK, SAME, REPEATED = 150, 200, 0.3
"""Samples that an encoder may stand while it is commanded to move, that a signal may stay the same to the last digit,
and share of samples that may repeat the one before while the head moves [A]."""

AWAY = 60
"""Samples by which an axis or a loop may be late: dead time, delay and the time that a drive takes."""

Columns = dict[str, np.ndarray]
Refuse = Callable[[Any, str, str], InvalidInput]
"""Of a sample, a column and what is wrong: an error with file, line, column, value and what is wrong."""


def doubts(columns: Columns, protocol: str, refuse: Refuse) -> list[str]:
    """Warnings about a log whose numbers are all in range and in order.

    Args:
        columns: in s, mm, mm/s and Hz.
        protocol: what it is to be a log of.
        refuse: makes an error, or the words of a warning.

    Raises:
        InvalidInput: what cannot be.
    """
    time = columns["time"]
    if time[-1] - time[0] > LONGEST:
        late = int(np.argmax(time - time[0] > LONGEST))
        raise refuse(
            late,
            "time",
            f"is over {LONGEST:g} s after the first sample, which is the longest; no protocol takes two minutes",
        )
    found = [*_axis(columns, protocol, refuse)] if "encoder" in columns else []
    if "frequency" in columns:
        found += _frequency(columns, protocol, refuse)
    of = {"sweep": _sweep, "rest": _rest, "motion": _motion, "follow": _follow}.get(protocol, _nothing)
    return [*found, *of(columns, refuse)]


def equal_runs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First sample and length of each run of equal values."""
    ends = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0, [True]]))
    return ends[:-1], np.diff(ends)


def _nothing(columns: Columns, refuse: Refuse) -> Iterator[str]:
    yield from ()


def _axis(columns: Columns, protocol: str, refuse: Refuse) -> Iterator[str]:
    """Encoder against command."""
    encoder = columns["encoder"]
    travel = float(np.ptp(encoder))
    if travel > FARTHEST:
        raise refuse(
            int(np.argmax(encoder)), "encoder", f"ends a travel of {travel:.4g} mm; a Z axis may have {FARTHEST:g} mm"
        )
    count = _count(encoder)
    moving = np.zeros(len(encoder), bool)
    moving[5:-5] = np.abs(encoder[10:] - encoder[:-10]) > 20.0 * count
    again = np.concatenate([[False], np.diff(encoder) == 0]) & moving
    if moving.sum() > 50 and again.sum() > REPEATED * moving.sum():
        raise refuse(
            int(np.argmax(again)),
            "encoder",
            f"repeats the sample before it, as {again.sum() / moving.sum():.0%} of the samples in "
            f"motion do; allowed: {REPEATED:.0%}; was it sampled more slowly?",
        )
    if "command" not in columns or protocol not in ("motion", "follow"):
        return
    command = columns["command"]
    asked = np.abs(command) > 5.0
    first, length = equal_runs(encoder)
    for i, n in zip(first[length > STUCK], length[length > STUCK], strict=True):
        # What the drive was told a little before, one way and the other, it may still have to answer.
        told = command[i : i + n - AWAY]
        if asked[i : i + n - AWAY].all() and np.ptp(np.sign(told)) == 0:
            raise refuse(
                i,
                "encoder",
                f"stays for {n} samples while the command is {told.mean():.4g} mm/s; allowed: {STUCK}; a frozen count?",
            )
    most = float(np.abs(command).max())
    rail = np.abs(command) > most * (1 - 1e-6)
    between = len(np.unique(command[~rail])) > 10
    if between and rail.mean() > (0.3 if protocol == "motion" else 0.1):
        yield str(
            refuse(
                int(np.argmax(rail)),
                "command",
                f"is the largest, as are {rail.mean():.0%} of the samples; was it clipped before it was written?",
            )
        )


def _count(encoder: np.ndarray) -> float:
    """mm of an encoder's count: the smallest step that is seen."""
    steps = np.abs(np.diff(encoder))
    return float(steps[steps > 1e-7].min()) if np.any(steps > 1e-7) else 1e-3


def _frequency(columns: Columns, protocol: str, refuse: Refuse) -> Iterator[str]:
    """A frozen or clipped count."""
    frequency, encoder = columns["frequency"], columns.get("encoder")
    first, length = equal_runs(frequency)
    long = np.flatnonzero((length > SAME) & (frequency[first] > 0))
    if not len(long):
        return
    i, n = int(first[long[0]]), int(length[long[0]])
    told = f"is the same in {n} samples on end; a counter that is frozen, clipped or coarse?"
    moved = 0.0 if encoder is None else float(np.ptp(encoder[i : i + n]))
    if protocol == "sweep" and moved > 0.3:
        raise refuse(i, "frequency", f"{told} The head rises by {moved:.3g} mm meanwhile; allowed: {SAME} samples")
    yield str(refuse(i, "frequency", told))


def _sweep(columns: Columns, refuse: Refuse) -> Iterator[str]:
    """A touch of the sheet, once, then up."""
    encoder, valid = columns["encoder"], columns["frequency"] > 0
    lowest = int(np.argmin(encoder))
    zero = float(encoder[lowest])
    rise = float(encoder[lowest:].max()) - zero
    if rise < 2.0:
        raise refuse(
            lowest,
            "encoder",
            f"is the lowest, and the head rises by {rise:.3g} mm from there; a "
            "sweep touches the sheet first and then rises by 2 mm or more; up "
            "is positive",
        )
    high = np.flatnonzero(~valid & (encoder > zero + 0.3))
    if len(high):
        raise refuse(
            int(high[0]),
            "frequency",
            f"is not valid {encoder[high[0]] - zero:.3g} mm above the "
            "lowest place; it may be so only where the nozzle touches "
            "(0.3 mm)",
        )
    touches = np.flatnonzero(~valid)
    if not len(touches):
        yield str(
            refuse(
                lowest,
                "encoder",
                "is the lowest, and the frequency is valid there; did the nozzle touch the sheet? "
                "Heights are counted from there",
            )
        )
    for a, b in zip(touches[:-1], touches[1:], strict=True):
        if b > a + 1 and encoder[a:b].max() > zero + 0.5:
            raise refuse(int(b), "frequency", f"is a second touch; the first is in line {a + 2}; a sweep has one")


def _rest(columns: Columns, refuse: Refuse) -> Iterator[str]:
    """Standing still at several heights."""
    encoder = columns["encoder"]
    away = np.zeros(len(encoder), bool)
    away[10:-10] = np.abs(encoder[20:] - encoder[:-20]) > 3.0 * max(_count(encoder), 1e-3)
    if away.mean() > 0.5:
        raise refuse(
            int(np.argmax(away)), "encoder", f"moves, as do {away.mean():.0%} of the samples; in a rest log 50 % may"
        )
    if np.ptp(encoder) < 0.2:
        yield str(
            refuse(
                int(np.argmax(encoder)),
                "encoder",
                f"is the highest, {1e3 * np.ptp(encoder):.3g} µm above the lowest; "
                "a rest log stands at three heights; is it in m?",
            )
        )
    signal = columns["frequency"] if "frequency" in columns else columns["height"]
    good = signal > 0
    if np.ptp(encoder) > 0.5 and _agreement(encoder[good], signal[good]) < 0.3:
        name = "frequency" if "frequency" in columns else "height"
        raise refuse(
            int(np.argmax(encoder)),
            name,
            f"is where the head is highest, and not above those nearer to the plate; {name} rises with height",
        )


def _motion(columns: Columns, refuse: Refuse) -> Iterator[str]:
    """Moves that begin at rest."""
    encoder, command = columns["encoder"], columns["command"]
    first = abs(float(encoder[2] - encoder[0]))
    if first > 0.01 + 2 * _count(encoder):
        raise refuse(
            2,
            "encoder",
            f"is {first:.3g} mm from the first sample: the axis moves already; a motion log begins at rest (0.01 mm)",
        )
    if (most := float(np.abs(command).max())) < 1.0:
        raise refuse(
            int(np.argmax(np.abs(command))),
            "command",
            f"is the largest, {most:.3g} mm/s; a motion log needs commands of 1 mm/s and more",
        )
    yield from ()


def _follow(columns: Columns, refuse: Refuse) -> Iterator[str]:
    """A closed loop: the height stays near the set height, and the command answers when it does not."""
    command = columns["command"]
    if not ("height" in columns and "set_height" in columns):
        return
    height, wanted = columns["height"], columns["set_height"]
    good = height > 0
    off = np.where(good, height - wanted, 0.0)
    if np.mean(off[good] == 0) > 0.9:
        raise refuse(
            int(np.argmax(good & (off == 0))),
            "height",
            "is the set height to the last digit, as over 90 % are; no loop is so good",
        )
    first, length = equal_runs(height)
    long = np.flatnonzero((length > SAME) & (height[first] > 0))
    if len(long):
        i, n = int(first[long[0]]), int(length[long[0]])
        raise refuse(i, "height", f"is the same in {n} samples on end; allowed: {SAME}; frozen?")
    if "frequency" in columns and (fit := _agreement(columns["frequency"][good], height[good])) < 0.3:
        raise refuse(
            int(np.argmax(height)),
            "height",
            "is the largest, and the frequency is not: they agree "
            f"by {fit:+.2f} (rank correlation; 0.3 or more is "
            "allowed); height rises with frequency",
        )
    usual = float(np.median(np.abs(off)[good]))
    limit = 0.5 * float(np.median(wanted))
    if usual > limit:
        i = int(np.argmax(np.abs(off) >= usual))
        yield str(
            refuse(
                i,
                "height",
                f"is {abs(off[i]):.3g} mm from the set height, and half of the samples are {usual:.3g} mm "
                f"or more; up to {limit:.3g} mm is usual; was the loop closed, and are the units right?",
            )
        )
    else:
        answers = [_correlation(command[k:], off[: len(off) - k]) for k in range(0, AWAY, 3)]
        if not min(answers) < -0.3:
            i = int(np.argmax(np.abs(off)))
            yield str(
                refuse(
                    i,
                    "height",
                    f"is {off[i]:+.3g} mm off, and the command does not answer: their correlation is "
                    f"{min(answers):+.2f} at best, in closed loop below −0.3; was the loop closed?",
                )
            )
    # The sheet is where the encoder and the height say; what no sheet does, the height cannot have been.
    sheet = (columns["encoder"] - height)[good]
    steps = np.abs(np.diff(sheet))
    moving = float(np.std(np.diff(columns["encoder"]))) * PERIOD**-1
    if len(steps) and float(np.percentile(steps, 90)) > 0.2:
        i = int(np.flatnonzero(good)[int(np.argmax(steps > 0.2)) + 1])
        yield str(
            refuse(
                i,
                "height",
                f"puts the sheet {steps[steps > 0.2][0]:.3g} mm from where it was a sample before, as over "
                f"10 % do; 0.2 mm is allowed; the head moves at {moving:.3g} mm/s: no such gap can be",
            )
        )


def _agreement(a: np.ndarray, b: np.ndarray) -> float:
    """Rank correlation."""
    return _correlation(np.argsort(np.argsort(a)).astype(float), np.argsort(np.argsort(b)).astype(float))


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation; 0 where one of them never changes."""
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
