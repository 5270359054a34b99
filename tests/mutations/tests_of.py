"""Which tests can see a mistake in a module: those about it first, then those that run the whole machine."""

from pathlib import Path

FOLDERS = ("envs/plant", "baselines")

OLD = ("lanes", "quantity")
"""Modules that only give others their old names; they have no mutants."""

_Z = ("plant/test_oracle.py",)
_XY = ("plant/test_xy_oracle.py", "envs/test_jobs.py")
_EVERYTHING = ("recorded/test_recorded.py",)
_LAWS = (*_EVERYTHING, "baselines/test_every_controller.py", "baselines/test_laws.py")

OWN: dict[str, tuple[str, ...]] = {
    "envs/plant/calibration": ("plant/test_calibration.py", *_Z),
    "envs/plant/candidates": ("experiments/test_identify.py",),
    "envs/plant/controller": ("engine/test_kernels.py", *_Z),
    "envs/plant/cut": (
        "plant/test_xy_parts.py",
        "plant/test_xy_oracle.py",
        "envs/test_quality.py",
        "envs/test_jobs.py",
    ),
    "envs/plant/filters": ("plant/test_filters.py", *_Z),
    "envs/plant/fleet": ("engine/test_kernels.py", *_Z),
    "envs/plant/gantries": _XY,
    "envs/plant/gantry": (
        "plant/test_gantry.py",
        "plant/test_xy_oracle.py",
        "plant/test_xy_axes.py",
        "envs/test_jobs.py",
    ),
    "envs/plant/heads": ("plant/test_calibration.py", "plant/test_sensor.py", "envs/test_machines.py", *_Z),
    "envs/plant/ideal": ("envs/test_ideal.py",),
    "envs/plant/idle": _Z,
    "envs/plant/machine": (
        *_Z,
        "plant/test_supervisor.py",
        "plant/test_calibration.py",
        "plant/test_path.py",
        "plant/test_filters.py",
        "envs/test_height_following.py",
    ),
    "envs/plant/path": ("plant/test_path.py", *_Z),
    "envs/plant/planning": ("envs/test_jobs.py",),
    "envs/plant/prompt": ("engine/test_kernels.py",),
    "envs/plant/published": ("plant/test_xy_parts.py", "plant/test_xy_oracle.py", "envs/test_evidence.py"),
    "envs/plant/sensor": (*_Z, "plant/test_sensor.py", "plant/test_calibration.py"),
    "envs/plant/sheet": (*_Z, "plant/test_sheet.py"),
    "envs/plant/derivatives": ("plant/test_derivatives.py", "agents/test_gradient.py"),
    "envs/plant/spot": (
        "plant/test_xy_parts.py",
        "plant/test_gantry.py",
        "plant/test_xy_oracle.py",
        "envs/test_quality.py",
    ),
    "envs/plant/streamed": ("engine/test_kernels.py", "envs/test_hand.py", "envs/test_vector.py"),
    "envs/plant/supervisor": (*_Z, "plant/test_supervisor.py"),
    "envs/plant/xy_axes": ("plant/test_xy_parts.py", "plant/test_xy_oracle.py", "plant/test_xy_axes.py"),
    "envs/plant/z_axis": (*_Z, "plant/test_z_axis.py"),
    "baselines/__init__": _LAWS,
    "baselines/active_set": ("baselines/test_mpc.py", *_LAWS),
    "baselines/cn102528288a": ("baselines/test_cn102528288a.py", *_LAWS),
    "baselines/drive_bank": ("baselines/test_forecast.py", *_LAWS),
    "baselines/forecast": ("baselines/test_forecast.py", "baselines/test_laws_with_memory.py", *_LAWS),
    "baselines/huang2024": ("baselines/test_huang2024.py", "envs/test_jobs.py"),
    "baselines/ilc": ("baselines/test_ilc.py", *_LAWS),
    "baselines/lqg": ("baselines/test_lqg.py", "baselines/test_mpc.py", *_LAWS),
    "baselines/mpc": ("baselines/test_mpc.py", *_LAWS),
    "baselines/observer": _LAWS,
    "baselines/oracle": ("baselines/test_oracle_law.py", *_LAWS),
    "baselines/patent2022": ("baselines/test_patent2022.py", *_LAWS),
    "baselines/pid": (*_Z, *_LAWS),
    "baselines/plasma": ("baselines/test_plasma.py", *_LAWS),
    "baselines/preview": _LAWS,
    "baselines/ramps": ("baselines/test_forecast.py", *_LAWS),
    "baselines/recipe": _XY,
    "baselines/riccati": ("baselines/test_lqg.py", *_LAWS),
    "baselines/self_tuning": ("baselines/test_self_tuning.py", "baselines/test_laws_with_memory.py", *_LAWS),
    "baselines/sequences": ("baselines/test_sequences.py", "baselines/test_self_tuning.py"),
    "baselines/servo": ("baselines/test_lqg.py", "baselines/test_mpc.py", *_LAWS),
    "baselines/trends": ("baselines/test_forecast.py", *_LAWS),
    "baselines/inverse": ("baselines/test_inverse.py", *_XY),
    "baselines/slots": ("baselines/test_forecast.py", *_LAWS),
    "baselines/wu": ("baselines/test_wu.py", *_XY),
    "baselines/xi2023": (*_Z, *_LAWS),
}
"""Test files below ``tests/`` by module, in the order in which they run, the quickest first."""

QUICK = ("tests/baselines/", "tests/plant/test_gantry.py", "tests/plant/test_xy_parts.py", "tests/envs/test_quality.py")
"""Test files that need not compile the machine begin so: mutants that are theirs are judged first."""

_HERE = ("controller",)  # in every kernel
INSIDE: dict[str, tuple[str, ...]] = {
    "gantry": ("gantry", "cut", "spot", "xy_axes", "published", "path", "machine", "supervisor", *_HERE),
    "machine": ("machine", "calibration", "filters", "path", "sensor", "sheet", "supervisor", "z_axis", *_HERE),
    "controller": _HERE,  # a law's stage; its own text is part of its stamp
}
"""Modules whose code a kernel of a module can contain; of other kernels nothing is known."""


def modules(root: Path) -> list[str]:
    """Files with mutants, from the package's folder on."""
    found = (
        p
        for folder in FOLDERS
        for p in sorted((root / folder).glob("*.py"))
        if p.stem not in OLD and p.stat().st_size > 0
    )
    return [p.relative_to(root).as_posix() for p in found]


def of(file: str) -> tuple[str, ...]:
    """Test files that can see a mistake in a module."""
    return tuple(f"tests/{name}" for name in dict.fromkeys((*OWN[file.removesuffix(".py")], *_EVERYTHING)))
