"""Classical controllers: those of the published documents, and what today's engineers would try.

Importing this package registers every stack by name. Presets (``presets/*.toml``) hold parameters that a search found,
with its record: ``kerfgym tune --study`` finds those of ``followers``, of the ``axes`` and of the ``process``.
"""

import functools
import importlib
import tomllib
from pathlib import Path

from kerfgym.envs.control.stack import Stack, register
from kerfgym.envs.plant.controller import make_law

PRESETS = Path(__file__).parent / "presets"

UNTUNED = {"trials": 0, "origin": "as printed or assumed; not tuned"}
"""Record of a stack whose values nobody searched."""

_BRIDGED = {"filter.kind": "anti-impulse", "filter.hold": 4, "guard.rise": 0.05}

# name: (module, summary, values, name of the tuned preset on top of them, if there is one)
_CATALOGUE: dict[str, tuple[str, str, dict, str]] = {
    "xi2023-ma": (
        "xi2023", "Xi2023: P law on a moving average of 5, assumed gain 50 1/s",
        {"filter.kind": "mean", "filter.window": 5, "law.kv": 50.0}, "",
    ),
    "xi2023-improved": (
        "xi2023", "Xi2023: P law on the improved (trimmed) average of 5, assumed gain 50 1/s",
        {"filter.kind": "improved", "filter.window": 5, "filter.trim": 1, "law.kv": 50.0}, "",
    ),
    "xi2023-tuned": (
        "xi2023", "Xi2023 improved, with window, trim and gain tuned: the reference of every ratio",
        {"filter.kind": "improved"}, "xi2023-tuned",
    ),
    "pid": ("pid", "PID with derivative filter and anti-windup behind an anti-impulse filter, tuned", _BRIDGED, "pid"),
    "observer": (
        "observer", "surface observer with feed-forward behind an anti-impulse filter, tuned",
        _BRIDGED, "observer",
    ),
    "lqg": ("lqg", "Kalman filters and linear-quadratic regulator on an identified model, tuned", _BRIDGED, "lqg"),
    "mpc": (
        "mpc", "model-predictive: LQG under bounds on command and acceleration, planned anew each period, tuned",
        _BRIDGED, "mpc",
    ),
    "self-tuning": (
        "self_tuning", "self-tuning predictor: learns how the sheet goes on by recursive least squares, tuned",
        {**_BRIDGED, "filter.jump": 0.031}, "self-tuning",
    ),
    "forecast": (
        "forecast", "knows what the plate makes of bends and steps, and which drive it commands; learns the rest",
        {**_BRIDGED, "filter.jump": 0.031}, "forecast",
    ),
    "preview-5ms": ("preview", "knows the sheet 5 ms ahead, tuned: 1 on a report's scale", {}, "preview-5ms"),
    "patent2022": (
        "patent2022", "Patent2022 as printed: lift, hold, lower with factors of 0.01, planned descent", {}, "",
    ),
    "patent2022-free": (
        "patent2022", "Patent2022 with its constants free, behind an anti-impulse filter, tuned",
        _BRIDGED, "patent2022-free",
    ),
    "cn102528288a": (
        "cn102528288a", "CN102528288A: dual loop with scheduled gains, speed from the encoder, assumed gains",
        {"law.speed": "encoder", "law.gain": 250.0, "law.ki": 100.0, "law.kpv": 0.5, "law.kiv": 20.0}, "",
    ),
    "cn102528288a-gap": (
        "cn102528288a", "CN102528288A with the change of the measured height as following speed, assumed gains",
        {"law.speed": "gap", "law.gain": 100.0, "law.kpv": 0.5}, "",
    ),
    "cn102528288a-tuned": (
        "cn102528288a", "CN102528288A (speed of the gap) behind an anti-impulse filter, tuned",
        {
            "law.speed": "gap",
            # Where the search starts: what makes it the tuned PID, but for a little integral gain of the speed loop.
            "law.gain": 171.0, "law.ki": 4281.0, "law.kpv": 0.76, "law.kiv": 2.0, "law.lag": 8.17,
            "filter.jump": 0.0298, "filter.kind": "anti-impulse", "filter.hold": 4, "guard.rise": 0.05,
        }, "cn102528288a-tuned",
    ),
    "plasma-style": (
        "plasma", "PID with velocity anti-dive and void lock, as open-source plasma tables have",
        _BRIDGED, "plasma-style",
    ),
    "oracle": ("oracle", "knows sheet ahead, true gap and true motion, tuned", {}, "oracle"),
    "ilc": (
        "ilc", "iterative learning over laps of a closed contour, on a PID behind an anti-impulse filter",
        _BRIDGED, "pid",
    ),
    "wu": ("wu", "Wu: proportional position loops, Kv 30 1/s, slow in corners", {"law.kp": 0.54}, ""),
    "wu-no-corners": (
        "wu", "Wu without acceleration, deceleration and corner handling", {"law.kp": 0.54, "plan.corners": 0}, "",
    ),
    "wu-matched": (
        "wu", "Wu, gains of x and y corrected for a drive whose x is 3.5 % stronger and y 3.5 % weaker",
        {"law.kp": 0.54, "law.x_plus": 0.9662, "law.x_minus": 0.9662, "law.y_plus": 1.0363, "law.y_minus": 1.0363},
        "",
    ),
    "wu-tuned": ("wu", "Wu, gain tuned to an overshoot of at most 1 %: the reference of the slot xy", {}, "wu-tuned"),
    "wu-feedforward": ("wu", "Wu with feed-forward of velocity and acceleration, tuned", {}, "wu-feedforward"),
    "wu-stiff": ("wu", "Wu with half the gain that is unstable, and feed-forward, tuned", {}, "wu-stiff"),
    "wu-inverse": (
        "inverse", "inverse of Wu's drive, a little late, which learns the drive's gains and time constants, tuned",
        {}, "wu-inverse",
    ),
    "recipe": ("recipe", "the material's recipe: nominal feed and power, no dither", {}, ""),
    "huang2024-static-quality": (
        "recipe", "Huang2024 Table 2: static, surface quality first, 0.2 m/min", {"plan.feed": 200.0 / 60}, "",
    ),
    "huang2024-static-fast": ("recipe", "Huang2024 Table 2: static, fastest, 0.5 m/min", {"plan.feed": 500.0 / 60}, ""),
    "huang2024-dynamic": (
        "recipe", "Huang2024 Table 2: dynamic compound, 1 m/min, circular helix ±0.3 mm and ±1 mm at 2 kHz",
        {"plan.feed": 1000.0 / 60, "law.frequency": 2000.0, "law.x": 0.3, "law.y": 0.3, "law.z": 1.0}, "",
    ),
    "huang2024-adjusting": (
        "huang2024", "Huang2024: dynamic compound with a unit that adjusts feed, power, dither and focus by rules",
        {"plan.feed": 1000.0 / 60}, "huang2024-adjusting",
    ),
    "huang2024-tuned": (
        "huang2024", "Huang2024's adjusting unit, searched for what is better in time, dross and roughness at once",
        {"plan.feed": 1000.0 / 60}, "huang2024-tuned",
    ),
}  # fmt: skip


def preset(name: str) -> dict:
    """The tuned preset of a stack: tables ``parameters`` and ``provenance``; empty if there is none."""
    path = PRESETS / f"{name}.toml"
    return tomllib.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _make(name: str) -> Stack:
    module, summary, values, tuned = _CATALOGUE[name]
    space = importlib.import_module(f"kerfgym.baselines.{module}")
    law = make_law(space, f"kerfgym.{module}", getattr(space, "INFORMATION", "sensor"), getattr(space, "SLOT", "z"))
    found = preset(tuned) if tuned else {}
    provenance = found.get("provenance", {} if tuned else UNTUNED)
    return Stack(name, summary, law, {**values, **found.get("parameters", {})}, provenance=dict(provenance))


for _name in _CATALOGUE:
    register(_name, functools.partial(_make, _name))
