"""X and Y axes from a square log: against an exact discretisation by SciPy, and blind on the simulated machine."""

import numpy as np
import pytest
from scipy import signal

from kerfgym.envs import scenarios
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import xy_axes
from kerfgym.envs.scenarios import machine_text, machines
from kerfgym.experiments.identify import identifying, log, slides, square

BASE = xy_axes.Params(gain=1.1, dac=0.0, speed=1e4, acceleration=1e9)


def exact(command, plus, minus, t1, t2, gain=BASE.gain):
    """Positions, mm, of a drive gain/((1 + T1·s)(1 + T2·s)·s) under commands that are held for a millisecond each."""
    system = signal.TransferFunction([gain], [t1 * t2, t1 + t2, 1.0, 0.0]).to_ss()
    a, b, c, _, _ = signal.cont2discrete((system.A, system.B, system.C, system.D), 1e-3)
    state, places = np.zeros((3, 1)), []
    for u in command:
        state = a @ state + b * u * (plus if u > 0 else minus)
        places.append((c @ state).item())
    return np.array(places)


def made(gains, t1, t2, count=1e-3):
    """A square log of such axes."""
    velocity = np.diff(square.path(150.0, 1000.0), axis=0, append=0.0) / 1e-3
    velocity += np.random.default_rng(0).normal(0, 0.5, velocity.shape)  # a host's corrections
    x, y = (exact(velocity[:, k], *gains[2 * k : 2 * k + 2], t1, t2) for k in (0, 1))
    columns = {"time": np.arange(len(x)) * 1e-3, "x": np.rint(x / count) * count, "y": np.rint(y / count) * count}
    return log.Log("square.csv", "square", {**columns, "x_command": velocity[:, 0], "y_command": velocity[:, 1]})


def test_candidates_move_as_the_exact_discretisation_says():
    command = made((1.0, 1.0, 1.0, 1.0), 0.02, 0.005)["x_command"][:3000]
    p = BASE._replace(x_plus=1.2, x_minus=0.9, t1=0.03, t2=0.004)
    (course,) = slides.courses([p], command, 2.0)
    assert course == pytest.approx(2.0 + exact(command, 1.2, 0.9, 0.03, 0.004), abs=1e-9)


@pytest.mark.parametrize(("t1", "t2"), [(0.03, 0.004), (0.004, 0.003)])
def test_gains_and_time_constants_of_foreign_axes_are_found(t1, t2):
    gains = (1.2, 0.9, 1.05, 0.8)
    found = slides.identify(made(gains, t1, t2), BASE)
    assert found.left == pytest.approx(1.0 / np.sqrt(12), rel=0.1)  # µm, a count
    assert found.explained
    assert not found.limited
    truth = dict(zip(("x_plus", "x_minus", "y_plus", "y_minus", "t1", "t2"), (*gains, t1, t2), strict=True))
    for key, value in truth.items():
        low, high = np.percentile(found.draws[key], [0.05, 99.95])
        assert low < value < high, key
        assert np.median(found.draws[key]) == pytest.approx(value, rel=0.01), key


def test_a_limit_of_acceleration_is_found_where_it_was_reached():
    machine = {"name": "known", "gantry": {"x_plus": 1.1, "y_minus": 0.8, "slower": 0.6, "acceleration": 1500.0}}
    found = slides.identify(square.record(machine), scenarios.axes_of(machines.load("standard").gantry))
    assert found.limited
    truth = {"x_plus": 1.1, "x_minus": 1.0, "y_plus": 1.0, "y_minus": 0.8, "t1": 0.012, "t2": 0.003}
    for key, value in {**truth, "acceleration": 1500.0}.items():
        assert np.median(found.draws[key]) == pytest.approx(value, rel=1e-3), key


def test_axes_of_another_kind_leave_more_than_counts():
    soft = made((1.0, 1.0, 1.0, 1.0), 0.02, 0.005)
    late = {name: np.roll(soft[name], 8 if name in "xy" else 0)[:15000] for name in soft.columns}  # a dead time of 8 ms
    found = slides.identify(log.Log("square.csv", "square", late), BASE)
    assert not found.explained
    assert found.left > 2.0


def test_the_machines_file_has_the_axes_of_the_log(tmp_path):
    machine = {"name": "known", "gantry": {"x_plus": 1.1, "y_minus": 0.8, "slower": 0.6}}
    found = identifying.identify([square.record(machine)])
    assert any("no motion log" in note for note in found.notes)
    (tmp_path / "mine.toml").write_text(machine_text.text_of(found.machine, whole=False), encoding="utf-8")
    drawn = square.truth(tmp_path / "mine.toml", 3)
    for key, value in square.truth(machine, 0).items():
        assert drawn[key] == pytest.approx(value, rel=1e-3), key
    assert found.machine.axis == machines.STANDARD.axis


def test_the_square_stays_within_small_travel_and_goes_every_way():
    path = square.path(1666.0, 30.0)
    assert np.ptp(path, axis=0).max() <= 15.0 + 1e-9
    speed = np.diff(path, axis=0) / 1e-3
    for k in (0, 1):
        assert speed[:, k].max() == pytest.approx(-speed[:, k].min(), rel=0.05)


@pytest.mark.parametrize(
    ("column", "change", "told"),
    [
        ("x", lambda v: v * 0 + 3.0, r"line 2, column x: 3 never changes"),
        ("x_command", lambda v: 0 * v, r"line 2, column x_command: 0 is the same throughout"),
        ("y_command", lambda v: -v, r"column y_command: .* opposite sign"),
        ("y_command", lambda v: v[::-1], r"column y_command: .* does not follow"),
        ("y", lambda v: 1e3 * v, r"column y: .* (is it in µm|units right)"),
        ("y", lambda v: 1e-3 * v, r"column y: .* are the units right"),
    ],
)
def test_a_square_log_that_cannot_be_is_refused(column, change, told, tmp_path):
    good = made((1.0, 1.0, 1.0, 1.0), 0.02, 0.005)
    file = tmp_path / "square.parquet"
    log.write(log.Log("square.csv", "square", {**good.columns, column: change(good[column])}), file)
    with pytest.raises(InvalidInput, match=told):
        log.read(file)
