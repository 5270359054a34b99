"""The scenarios that a followed sheet makes: the very sheet, as a measured profile, and others drawn from its spectrum.

A line of the spectrum becomes a wave of its amplitude and wavelength, whose phase each seed draws; the continuous part
becomes ``[sheet.random]``, of which each seed has another stretch. Steps, holes and bulges are in the profile alone.
"""

import csv
import io
from pathlib import Path

import numpy as np

from ...envs.scenarios import Scenario, reading
from ..store.runs import write_text
from .followed import Followed
from .roughness import Spectrum

LONGEST, DRAWN = 600.0, 8.0
"""s of the scenario with the very sheet at most, and of those that draw others: each seed draws another stretch."""

ENDS = (".sheet.csv", ".sheet.toml", ".sheets.toml")
"""Of the files' names: the profile, the scenario with it, and the one that draws others."""


def profile_csv(found: Followed) -> str:
    """The profile, as ``[sheet.profile]`` takes it; ``tip_mm`` is beside it for those who read it."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["position_mm", "height_mm", "tip_mm"])
    columns = zip(found.position, found.height, found.tip, strict=True)
    writer.writerows((f"{x:.4f}", f"{z:.5f}", f"{tip:.5f}") for x, z, tip in columns)
    return text.getvalue()


def of_profile(found: Followed, name: str, file: str) -> str:
    """A scenario with the very sheet, as TOML; ``file`` is that of its profile."""
    return (
        f'name = "{name}"\nsummary = "the sheet that was followed, {found.position[-1] / 1e3:.3g} m of it"\n'
        f"{_journey(found, LONGEST)}[sheet.profile]\n"
        f'file = "{file}"\nspacing = {max(float(found.spacing), 0.01):.6g}  # mm, from sample to sample\n'
    )


def of_spectrum(found: Followed, made: Spectrum, name: str) -> str:
    """A scenario that draws sheets of this spectrum, as TOML."""
    text = [
        f'name = "{name}"\nsummary = "sheets of the spectrum of the one that was followed"\n',
        f"{_journey(found, DRAWN)}[sheet]\n",
        f"tilt = {{ choice = [{-abs(made.tilt):.4g}, {abs(made.tilt):.4g}] }}  # mm/mm, up or down\n",
    ]
    if made.continuous:
        c = made.continuous
        text.append(
            f"[sheet.random]\nrms = {c.rms:.4g}  # mm\nexponent = {c.exponent:.4g}\nrolloff = {c.rolloff:.4g}  # mm\n"
        )
    for line in made.lines:
        text.append(
            f"[[sheet.waves]]\namplitude = {line.amplitude:.4g}  # mm\nwavelength = {line.wavelength:.6g}  # mm\n"
        )
    return "".join(text)


def _journey(found: Followed, longest: float) -> str:
    return (
        f"duration = {min(max(round(found.duration, 3), 0.4), longest):g}\n"
        f"feed = {min(max(found.feed, 0.0), 2000.0):.4g}  # mm/s\n"
        f"set_height = {float(np.clip(found.set_height, 0.05, 9.0)):.4g}  # mm\n"
    )


def told(found: Followed, made: Spectrum) -> list[str]:
    """A sheet in words, a line each."""
    lines = [
        f"follow: {found.position[-1] / 1e3:.3g} m of sheet at {found.feed:.4g} mm/s and {found.set_height:.3g} mm, "
        f"{1e3 * float(np.std(found.height)):.4g} µm RMS, slope {made.tilt:.3g}; noise {found.noise:.2g} µm a sample; "
        f"{found.left_out:.1%} left out"
    ]
    if made.continuous:
        c = made.continuous
        lines.append(
            f"follow: a continuous part of {1e3 * c.rms:.3g} µm RMS, which falls with k^{-c.exponent:.2g} below "
            f"{c.rolloff:.3g} mm"
        )
    lines += [f"follow: a wave of {1e3 * w.amplitude:.3g} µm every {w.wavelength:.4g} mm" for w in made.lines]
    return lines + [f"follow: {note}" for note in found.notes]


def write(found: Followed, made: Spectrum, beside: Path) -> tuple[Path, Path]:
    """Writes ``mine.sheet.csv``, ``mine.sheet.toml`` and ``mine.sheets.toml`` beside ``mine.toml``; both scenarios."""
    table, very, drawn = (beside.with_suffix(end) for end in ENDS)
    write_text(table, profile_csv(found))
    write_text(very, of_profile(found, f"{beside.stem} sheet", table.name))
    write_text(drawn, of_spectrum(found, made, f"{beside.stem} sheets"))
    return very, drawn


def scenario_of(found: Followed, made: Spectrum, name: str = "sheets") -> Scenario:
    """What :func:`of_spectrum` writes, as a scenario."""
    return reading.parse(of_spectrum(found, made, name), name)
