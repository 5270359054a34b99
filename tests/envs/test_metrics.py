"""Metrics against closed forms, on recordings made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import metrics
from kerfgym.envs.figures.metrics import METRICS, broken, evaluate, failed
from kerfgym.envs.figures.recording import Recording
from kerfgym.envs.figures.registered import EVERY, TAKEN, Called, Registry, Shown
from kerfgym.envs.plant.machine import CHANNELS
from kerfgym.envs.plant.supervisor import ALARM, FOLLOW
from kerfgym.envs.scenarios import load

SET = 0.8


def recording(periods=3000, settle=0.0, collided=(), lowest=None, **channels):
    """A recording in which everything lies still at the set height, but for the channels given.

    A channel has the shape (periods,) or (periods, machines); ``error`` and ``reported`` are about the set height, mm.
    """
    for error, channel in (("error", "gap"), ("reported", "height")):
        if error in channels:
            channels[channel] = SET + np.asarray(channels.pop(error))
    columns = {name: np.asarray(c, float).reshape(len(c), -1) for name, c in channels.items()}
    periods = next((len(c) for c in columns.values()), periods)
    machines = max([c.shape[1] for c in columns.values()], default=1)
    still = {"gap": SET, "height": SET, "raw_height": SET, "scored": 1.0, "mode": 4.0}
    data = np.zeros((periods, len(CHANNELS), machines), np.float32)
    for i, name in enumerate(CHANNELS):
        data[:, i] = columns.get(name, still.get(name, 0.0))
    hits = np.zeros(machines, bool)
    hits[list(collided)] = True
    scenario = load("flat").varied(duration=periods * 1e-3, settle=settle)
    gap = data[:, CHANNELS.index("gap")]
    least = gap.min(axis=0).astype(float) if lowest is None else np.asarray(lowest, float)
    return Recording(scenario, np.arange(machines), np.full(machines, SET), data, hits, least)


def value(name, r):
    (number,) = METRICS[name].function(r)
    return float(number)


t = np.arange(3000) * 1e-3

# ------------------------------------------------------------------------------------------------------ following


@pytest.mark.parametrize(("kind", "of"), [("true", "error"), ("reported", "reported")])
def test_a_sine_of_amplitude_a_has_an_rms_of_a_over_root_2(kind, of):
    sine = 0.06 * np.sin(2 * np.pi * 10 * t)
    r = recording(**{of: sine})
    assert value(f"rms_{kind}", r) == pytest.approx(60 / np.sqrt(2), rel=1e-4)
    assert value(f"max_{kind}", r) == pytest.approx(60, rel=1e-3)
    other = "reported" if kind == "true" else "true"
    assert value(f"rms_{other}", r) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(("kind", "of"), [("true", "error"), ("reported", "reported")])
def test_percentile_and_maximum_are_numpys(kind, of):
    errors = np.random.default_rng(0).normal(0, 0.03, (3000, 4)).astype(np.float32)
    r = recording(**{of: errors})
    magnitude = 1e3 * np.abs(r.error if kind == "true" else r.reported_error)
    quantile = np.percentile(magnitude, 99, axis=0, method="inverted_cdf")
    assert METRICS[f"p99_{kind}"].function(r) == pytest.approx(quantile)
    assert METRICS[f"max_{kind}"].function(r) == pytest.approx(magnitude.max(axis=0))
    assert METRICS[f"rms_{kind}"].function(r) == pytest.approx(np.sqrt((magnitude**2).mean(axis=0)))


def test_each_machine_is_measured_by_itself():
    errors = np.stack([np.full(3000, 0.01), np.full(3000, -0.02), np.full(3000, 0.5)], axis=1)
    r = recording(error=errors)
    for name in ("rms_true", "p99_true", "max_true"):
        assert METRICS[name].function(r) == pytest.approx([10, 20, 500], rel=1e-4)


def test_the_settling_time_and_periods_over_voids_do_not_count():
    errors = np.full(3000, 0.01)
    errors[:300] = 3.0
    errors[1000:1100] = -2.0
    scored = np.ones(3000)
    scored[1000:1100] = 0.0
    r = recording(error=errors, reported=errors, scored=scored, settle=0.3)
    assert r.scored.sum() == 2600
    for kind in ("true", "reported"):
        for figure in ("rms", "p99", "max"):
            assert value(f"{figure}_{kind}", r) == pytest.approx(10.0, rel=1e-4)
    assert value("max_true", recording(error=errors)) == pytest.approx(3000, rel=1e-6)


# ------------------------------------------------------------------------------------------------------- settling


def test_the_settling_time_of_an_exponential_approach_is_tau_times_the_logarithm():
    start, tau = 1.0, 0.1
    errors = start * np.exp(-(t + 1e-3) / tau)  # a period's value is that at its end
    r = recording(error=errors)
    for name, band in (("settling_20um", 0.02), ("settling_10um", 0.01)):
        assert value(name, r) == pytest.approx(tau * np.log(start / band), abs=1e-3)


def test_a_run_that_leaves_the_band_again_settles_when_it_is_back_for_good():
    errors = np.zeros(3000)
    errors[500], errors[1200] = 0.015, -0.5
    r = recording(error=errors)
    assert value("settling_20um", r) == pytest.approx(1.201)
    assert value("settling_10um", r) == pytest.approx(1.201)
    errors[1200] = 0.0
    assert value("settling_20um", recording(error=errors)) == 0.0
    assert value("settling_10um", recording(error=errors)) == pytest.approx(0.501)


def test_a_run_that_ends_outside_the_band_never_settles():
    errors = np.zeros(3000)
    errors[-1] = 0.03
    assert value("settling_20um", recording(error=errors)) == np.inf


def test_the_overshoot_of_a_second_order_approach_is_that_of_its_damping():
    zeta, omega = 0.4, 2 * np.pi * 5
    damped = omega * np.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * t)
    errors = 2.0 * decay * (np.cos(damped * t) + zeta / np.sqrt(1 - zeta**2) * np.sin(damped * t))
    first = 2.0 * np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    r = recording(error=errors)
    assert value("overshoot", r) == pytest.approx(first, rel=1e-3)  # below the set height
    assert value("undershoot", r) == pytest.approx(first**2 / 2.0, rel=1e-3)  # and above it again


def test_a_descent_that_never_arrives_neither_over_nor_undershoots():
    r = recording(error=np.linspace(5.0, 1.0, 3000))
    assert value("overshoot", r) == 0.0
    assert value("undershoot", r) == 0.0


# -------------------------------------------------------------------------------------------------- gap and actuator


def test_collisions_and_the_smallest_gap_are_those_of_the_substeps():
    r = recording(error=np.zeros((100, 3)), collided=[1], lowest=[0.3, -0.01, 0.7])
    assert METRICS["collision"].function(r).tolist() == [0.0, 1.0, 0.0]
    assert METRICS["min_gap"].function(r).tolist() == [0.3, -0.01, 0.7]


def test_a_ramp_of_the_command_has_the_jitter_of_its_slope():
    assert value("jitter", recording(command=np.linspace(0.0, 29.99, 3000))) == pytest.approx(0.01, rel=1e-3)
    assert value("jitter", recording(command=np.where(np.arange(3000) % 2, 3.0, -3.0))) == pytest.approx(6.0)
    assert value("jitter", recording(command=np.full(3000, 50.0))) == 0.0


def test_travel_acceleration_and_jerk_of_a_sine():
    amplitude, omega = 0.4, 2 * np.pi * 5
    r = recording(
        velocity=amplitude * omega * np.cos(omega * t), acceleration=-amplitude * omega**2 * np.sin(omega * t)
    )
    assert value("z_travel", r) == pytest.approx(4 * amplitude * 5, rel=1e-3)  # four amplitudes a turn
    assert value("rms_acceleration", r) == pytest.approx(amplitude * omega**2 / np.sqrt(2), rel=1e-3)
    assert value("rms_jerk", r) == pytest.approx(amplitude * omega**3 / np.sqrt(2), rel=1e-3)


def test_the_share_of_held_time_is_that_of_the_override():
    override = np.zeros(3000)
    override[600:1200] = 1.0
    assert value("held", recording(override=override)) == pytest.approx(0.2)


# ------------------------------------------------------------------------------------------------------------ failures


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_run_with_a_value_that_is_not_finite_has_failed(channel, bad):
    values = np.ones((3000, 2))
    values[7, 1] = bad
    assert failed(recording(**{channel: values})).tolist() == [False, True]


def test_a_run_with_nothing_to_score_has_failed():
    assert failed(recording(scored=np.stack([np.zeros(3000), np.ones(3000)], axis=1))).tolist() == [True, False]


@pytest.mark.parametrize("when", [slice(1500, 1501), slice(100, 101), slice(2999, 3000), slice(500, 3000)])
def test_a_failed_run_shows_as_nan_and_not_as_a_good_figure(when):
    errors = np.full((3000, 2), 0.005)
    errors[when, 1] = np.nan
    r = recording(error=errors, reported=errors, settle=0.3)
    assert failed(r).tolist() == [False, True]
    figures = evaluate(r)
    for name in (
        "rms_true",
        "p99_true",
        "max_true",
        "rms_reported",
        "p99_reported",
        "max_reported",
        "settling_20um",
        "settling_10um",
        "overshoot",
        "undershoot",
    ):
        assert np.isfinite(figures[name][0]), name
        assert np.isnan(figures[name][1]), name


def test_what_follows_a_touch_is_not_scored():
    """Up to period 1000 the error is 5 µm; then the gap is closed, and the head goes up by 5 mm."""
    errors = np.full((3000, 2), 0.005)
    errors[1000, 1], errors[1001:, 1] = -SET, 5.0
    mode = np.full((3000, 2), FOLLOW)
    mode[1001:, 1] = ALARM
    r = recording(error=errors, mode=mode, collided=[1])
    assert r.touched.tolist() == [3000, 1000]
    assert r.scored.sum(axis=0).tolist() == [3000, 1000]
    assert METRICS["rms_true"].function(r) == pytest.approx([5.0, 5.0], rel=1e-3)
    assert METRICS["max_true"].function(r) == pytest.approx([5.0, 5.0], rel=1e-3)
    assert failed(r).tolist() == [False, True]
    assert evaluate(r)["rms_true"][1] == pytest.approx(5.0, rel=1e-3)  # a figure of its own, which no table pools
    whole = replace(r, to_the_end=True)
    assert METRICS["rms_true"].function(whole)[1] > 4000


def test_a_touch_between_two_periods_is_known_by_the_alarm():
    mode = np.full(3000, FOLLOW)
    mode[700:] = ALARM
    r = recording(error=np.full(3000, 0.01), mode=mode, collided=[0])
    assert r.touched.tolist() == [700]


def test_an_alarm_without_a_touch_ends_nothing():
    mode = np.full(3000, FOLLOW)
    mode[700:] = ALARM
    assert recording(mode=mode).scored.sum() == 3000


def test_a_touch_before_anything_is_scored_leaves_no_figure():
    mode = np.full(3000, FOLLOW)
    mode[100:] = ALARM
    r = recording(mode=mode, collided=[0], settle=0.3)
    assert failed(r).tolist() == broken(r).tolist() == [True]
    figures = evaluate(r)
    assert np.isnan(figures["rms_true"][0])
    assert figures["collision"][0] == 1.0


def test_who_touches_where_it_is_expected_has_not_failed():
    r = recording(error=np.full(3000, 0.01), collided=[0])
    assert failed(r).tolist() == [True]
    assert failed(replace(r, scenario=r.scenario.varied(exempt=True))).tolist() == [False]


# ------------------------------------------------------------------------------------------------------------ registry


def test_every_metric_is_registered_with_unit_direction_and_meaning():
    figures = evaluate(recording(error=np.zeros((50, 3))))
    assert set(figures) == set(METRICS)
    for name, metric in METRICS.items():
        assert metric.name == name
        assert metric.unit
        assert metric.summary
        assert metric.better in ("lower", "higher")
        assert figures[name].shape == (3,)
    assert METRICS["min_gap"].better == "higher"
    assert METRICS["rms_true"].better == "lower"


def test_an_unknown_metric_is_answered_with_the_nearest():
    assert metrics.get("rms_true") is METRICS["rms_true"]
    with pytest.raises(InvalidInput, match=r"unknown metric 'rms_ture'; did you mean 'rms_true'\? \(known: .*jitter"):
        metrics.get("rms_ture")


def depth(r):
    """How deep it is"""
    return r.lowest


def named(name, about="Something"):
    """The same function by another name."""
    other = type(depth)(depth.__code__, {}, name)
    other.__doc__ = about
    return other


@pytest.fixture
def registry():
    """One of its own; what it adds to the names of all is forgotten after the test."""
    before = dict(EVERY)
    yield Registry()
    EVERY.clear()
    EVERY.update(before)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"better": "more"}, "metric 'depth': better = 'more'; .*lower.*higher"),
        ({"pooled": "median"}, "metric 'depth': pooled = 'median'; .*mean.*rms.*largest.*smallest"),
        ({"better": "higher", "called": Called("depth", "less")}, "what is better lower; this is better higher"),
        ({"better": "higher", "shown": Shown(compared=True)}, "what is better lower; this is better higher"),
        ({"shown": Shown(column="score")}, "metric 'depth': that name means something else"),
    ],
)
def test_a_metric_that_is_declared_wrongly_is_refused(registry, wrong, said):
    with pytest.raises(InvalidInput, match=said):
        registry.metric("mm", **wrong)(depth)
    assert not registry
    assert "depth" not in EVERY


def test_a_metric_without_a_docstring_is_refused(registry):
    with pytest.raises(InvalidInput, match="metric 'bare': its docstring is missing"):
        registry.metric("mm")(named("bare", None))


@pytest.mark.parametrize("name", TAKEN)
def test_a_name_that_tables_use_for_something_else_is_refused(registry, name):
    with pytest.raises(InvalidInput, match=f"metric '{name}': that name means something else already"):
        registry.metric("mm")(named(name))


def test_followers_and_jobs_must_mean_the_same_by_a_name(registry):
    registry.metric("mm", pooled="largest")(depth)
    with pytest.raises(InvalidInput, match="metric 'depth': that name means something else already"):
        Registry().metric("mm")(depth)
    Registry().metric("mm", pooled="largest", shown=Shown("deep"))(depth)  # how it is shown is each one's own
    registry.metric("µm")(depth)  # declared anew, as in a notebook
    assert registry["depth"].unit == "µm"


def test_two_metrics_have_no_column_in_common(registry):
    registry.metric("mm", shown=Shown(column="deep"))(depth)
    with pytest.raises(InvalidInput, match="metric 'other': that name means something else already"):
        registry.metric("mm", shown=Shown(column="deep"))(named("other"))
