"""Materials: thermal figures, recipe and coefficients of the cut, from ``materials/*.toml``."""

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.quantity import InvalidInput, check_choice, did_you_mean
from ..plant import cut
from ..safety import files

FOLDER = Path(__file__).parents[1] / "materials"


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

    @functools.cached_property
    def kerf(self) -> float:
        """mm, width of the kerf at the top with the recipe, by the model of the cut."""
        return float(_figures(self.params, self.power, self.feed).kerf_top)

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
    check_choice(name, names(), "material")
    return of_file(FOLDER / f"{name}.toml", thickness)


def of_file(file: Path, thickness: float | None = None) -> Material:
    """The material that a file holds.

    Raises:
        InvalidInput: something is missing, no number, or not finite; or a thickness it does not come in.
    """
    try:
        return _of(file.stem, _read(file), thickness)
    except InvalidInput:
        raise
    except KeyError as error:
        raise InvalidInput(f"{file}: {error} is missing") from None
    except (TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise InvalidInput(f"{file}: not a material: {error}") from None


def _of(name: str, data: dict[str, Any], thickness: float | None) -> Material:
    low, high = _numbers(data["thickness"], "thickness")
    t = low if thickness is None else thickness
    if not low <= t <= high:
        allowed = f"{low:g} mm" if low == high else f"{low:g} to {high:g} mm"
        raise InvalidInput(f"material '{name}': thickness = {t:g} mm; allowed: {allowed}")
    recipe, given = data["recipe"], dict(data["cut"])
    focus = given.pop("focus") * t
    params = cut.Params(thickness=t, focus=focus, floor=1e-3 * (10.0 + 0.6 * t), **given)
    _numbers(params, "cut")
    if not t > 0:
        raise InvalidInput(f"material '{name}': thickness = {t:g} mm; it must be above 0")
    feed = recipe["feed"] if "feed" in recipe else float(np.interp(t, *np.transpose(recipe["feeds"])))
    power = recipe["power"] if "power" in recipe else power_for(params, feed, recipe["margin"])
    pierce = tuple((float(height), float(time)) for height, time in recipe["pierce"])
    calibration = data.get("calibration", {})
    if not isinstance(calibration, dict) or not isinstance(data["summary"], str):
        raise InvalidInput(f"material '{name}': calibration is a table, summary a text")
    _numbers([power, feed, recipe["standoff"], *(x for stage in pierce for x in stage)], "recipe")
    return Material(name, data["summary"], params, power, feed, recipe["standoff"], pierce, calibration)


def _numbers(values: Any, what: str) -> Any:
    """The values, if they are finite numbers.

    Raises:
        InvalidInput: one is not.
    """
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InvalidInput(f"{what}: {value!r} is not a finite number")
    return values


def power_for(params: cut.Params, feed: float, margin: float) -> float:
    """W that give the melt margin at a feed in mm/s, without dither."""

    none, one = (_figures(params, power, feed).margin for power in (0.0, 1000.0))  # it is linear in the power
    return float(1000.0 * (margin - none) / (one - none))


def _figures(params: cut.Params, power: float, feed: float) -> cut.Figures:
    """The first millisecond of a cut, without dither."""
    beam = cut.beam(params, power, 0.0, 0.0, 0.0, 0.0, 0.0)
    return cut.step(params, beam, cut.fresh(), feed, 0.0, 0.0, 1e-3)[1]


def _read(file: Path) -> dict[str, Any]:
    data = files.toml(file)
    if "like" in data:
        if data["like"] not in names() or data["like"] == file.stem:
            raise InvalidInput(f"{file}: like = {data['like']!r}; {did_you_mean(str(data['like']), names())}")
        base = _read(FOLDER / f"{data['like']}.toml")
        inherited = {**base["cut"], **base.get("coefficients", {})}
        data["cut"] = {**inherited, **data.get("cut", {})}
        data["recipe"] = {"standoff": base["recipe"]["standoff"], **data["recipe"]}
    else:
        data["cut"] = {**data["cut"], **data.get("coefficients", {})}
    return data
