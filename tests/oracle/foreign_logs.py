"""What a machine of another make says of itself: logs of the protocols, and how closely it follows a sheet."""

from pathlib import Path
from typing import Any

import numpy as np

from kerfgym.experiments.identify import log, protocols
from kerfgym.experiments.identify.outside import Outside
from kerfgym.tests.oracle.foreign import Foreign, Running

SCRIPTS: dict[str, Any] = {"rest": protocols._rest, "motion": protocols._motion}


def sweep(make: Foreign, seed: int) -> np.ndarray:
    """Feels for the plate, then rises to 10 mm at 10 mm/s: rows of encoder, command, frequency."""
    runs, rows, command, touched = Running(make, 0.2, seed=seed), [], 0.0, 0
    for k in range(4000):
        encoder, frequency = runs.step(command)
        rows.append((encoder, runs.converted(command), frequency))
        if frequency == 0.0:
            touched = k
        if touched and encoder > 10.4:
            break
        command = 10.0 if touched else (-0.5 if k > 50 else 0.0)
    return np.array(rows)


def scripted(make: Foreign, protocol: str, seed: int) -> np.ndarray:
    """The protocol's own script, which sends commands and receives the encoder."""
    runs, rows = Running(make, protocols.HEIGHTS[0], seed=seed), []
    script = SCRIPTS[protocol](np.random.default_rng(seed))
    asked = next(script)
    while True:
        encoder, frequency = runs.step(asked)
        rows.append((encoder, runs.converted(asked), frequency))
        try:
            asked = script.send(encoder)
        except StopIteration:
            return np.array(rows)


def recorded(make: Foreign, protocol: str, folder: Path, seed: int = 0) -> log.Log:
    """A log, written to a file and read from it."""
    encoder, command, frequency = (sweep(make, seed) if protocol == "sweep" else scripted(make, protocol, seed)).T
    columns = {"time": np.arange(len(encoder)) * 1e-3, "encoder": encoder, "command": command, "frequency": frequency}
    file = folder / f"{protocol}.csv"
    log.write(log.Log(file.name, protocol, columns), file)
    return log.read(file)


def followed(make: Foreign, controller: Outside, sheet: np.ndarray, spacing: float, feed: float, seconds: float,
             height: float, seed: int = 0) -> np.ndarray:  # fmt: skip
    """Gap at the end of each period, mm, under a controller of kerfgym's, which the machine's readings move."""
    runs, gaps = Running(make, height, sheet, spacing, feed, seed), []
    encoder, frequency = Running(make, height, sheet, spacing, 0.0, seed).step(0.0)
    command = controller.begin(frequency, encoder)
    for _ in range(round(1e3 * seconds)):
        encoder, frequency = runs.step(command)
        gaps.append(runs.gap)
        command = controller.step(frequency, encoder)
    return np.array(gaps)
