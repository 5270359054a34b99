"""Classical controllers: those of the published documents, and what today's engineers would try.

Importing this package registers every stack by name; presets (``presets/*.toml``) hold parameters that the search of
``experiments/search.py`` found, with its record.
"""

import functools
import importlib
import tomllib
from pathlib import Path

from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.stack import Stack, register

PRESETS = Path(__file__).parent / "presets"

# name: (module, summary, values, whether a tuned preset of that name exists)
_CATALOGUE: dict[str, tuple[str, str, dict, bool]] = {
    "xi2023-ma": (
        "xi2023", "Xi2023: P law on a moving average of 5, assumed gain 50 1/s",
        {"filter.kind": "mean", "filter.window": 5, "law.kv": 50.0}, False,
    ),
    "xi2023-improved": (
        "xi2023", "Xi2023: P law on the improved (trimmed) average of 5, assumed gain 50 1/s",
        {"filter.kind": "improved", "filter.window": 5, "filter.trim": 1, "law.kv": 50.0}, False,
    ),
    "xi2023-tuned": (
        "xi2023", "Xi2023 improved, with window, trim and gain tuned: the reference of every ratio",
        {"filter.kind": "improved"}, True,
    ),
    "pid": (
        "pid", "PID with derivative filter and anti-windup behind an anti-impulse filter, tuned",
        {"filter.kind": "anti-impulse", "filter.hold": 4, "guard.rise": 0.05}, True,
    ),
    "observer": (
        "observer", "surface observer with feed-forward behind an anti-impulse filter, tuned",
        {"filter.kind": "anti-impulse", "filter.hold": 4, "guard.rise": 0.05}, True,
    ),
    "preview-5ms": ("preview", "knows the sheet 5 ms ahead, tuned: score 1", {}, True),
}  # fmt: skip


def preset(name: str) -> dict:
    """The tuned preset of a stack: tables ``parameters`` and ``provenance``; empty if there is none."""
    path = PRESETS / f"{name}.toml"
    return tomllib.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _make(name: str) -> Stack:
    module, summary, values, _ = _CATALOGUE[name]
    space = importlib.import_module(f"kerfgym.baselines.{module}")
    law = make_law(space, f"kerfgym.{module}", getattr(space, "INFORMATION", "sensor"))
    tuned = preset(name)
    return Stack(name, summary, law, {**values, **tuned.get("parameters", {})}, provenance=tuned.get("provenance", {}))


for _name in _CATALOGUE:
    register(_name, functools.partial(_make, _name))
