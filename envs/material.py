"""Materials: thermal figures, recipe and coefficients of the cut, from ``materials/*.toml``."""

import functools
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .plant import cut
from .plant.quantity import InvalidInput, did_you_mean

FOLDER = Path(__file__).parent / "materials"


@dataclass(frozen=True)
class Material:
    """A sheet to be cut, and how it is usually cut.

    ``power`` in W, ``feed`` in mm/s, ``standoff`` in mm; ``pierce``: stages of (height in mm, seconds);
    ``calibration``: how the coefficients were found, empty if they are assumed.
    """

    name: str
    summary: str
    params: cut.Params
    power: float
    feed: float
    standoff: float
    pierce: tuple[tuple[float, float], ...]
    calibration: dict[str, Any]

    @property
    def thickness(self) -> float:
        """mm."""
        return self.params.thickness

    @property
    def label(self) -> str:
        """What to print beside its figures."""
        c = self.calibration
        if not c:
            return f"{self.name}: coefficients assumed, not validated"
        return (
            f"{self.name}: calibrated, {c['coefficients']} coefficients for {c['numbers']} numbers of {c['source']};"
            " not validated"
        )


def names() -> list[str]:
    """Known materials."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


@functools.cache
def material(name: str, thickness: float | None = None) -> Material:
    """A material by name, of a thickness in mm where it comes in several (default: the thinnest).

    Raises:
        InvalidInput: unknown name (the nearest is offered), or a thickness it does not come in.
    """
    if name not in names():
        raise InvalidInput(f"unknown material '{name}'; {did_you_mean(name, names())}")
    data = _read(name)
    low, high = data["thickness"]
    t = low if thickness is None else thickness
    if not low <= t <= high:
        allowed = f"{low:g} mm" if low == high else f"{low:g} to {high:g} mm"
        raise InvalidInput(f"material '{name}': thickness = {t:g} mm; allowed: {allowed}")
    recipe, given = data["recipe"], dict(data["cut"])
    focus = given.pop("focus") * t
    params = cut.Params(thickness=t, focus=focus, floor=1e-3 * (10.0 + 0.6 * t), **given)
    feed = recipe["feed"] if "feed" in recipe else float(np.interp(t, *np.transpose(recipe["feeds"])))
    power = recipe["power"] if "power" in recipe else power_for(params, feed, recipe["margin"])
    pierce = tuple((float(height), float(time)) for height, time in recipe["pierce"])
    calibration = data.get("calibration", {})
    return Material(name, data["summary"], params, power, feed, recipe["standoff"], pierce, calibration)


def power_for(params: cut.Params, feed: float, margin: float) -> float:
    """W that give the melt margin at a feed in mm/s, without dither."""

    def reached(power: float) -> float:
        return cut.step(params, cut.beam(params, power, 0.0, 0.0, 0.0, 0.0, 0.0), cut.fresh(), feed, 0.0, 0.0, 1e-3)[
            1
        ].margin

    none, one = reached(0.0), reached(1000.0)  # the margin is linear in the power
    return float(1000.0 * (margin - none) / (one - none))


def _read(name: str) -> dict[str, Any]:
    data = tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    if "like" in data:
        base = _read(data["like"])
        inherited = {**base["cut"], **base.get("coefficients", {})}
        data["cut"] = {**inherited, **data.get("cut", {})}
        data["recipe"] = {"standoff": base["recipe"]["standoff"], **data["recipe"]}
    else:
        data["cut"] = {**data["cut"], **data.get("coefficients", {})}
    return data
