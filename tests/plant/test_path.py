"""Path: corners that slow the feed down, and the place of the machine behind its preview."""

import numpy as np
import pytest

from kerfgym.envs.plant import heads, idle, path
from kerfgym.envs.plant.controller import AHEAD, PERIOD, make_law
from kerfgym.envs.plant.fleet import Fleet

LAW = make_law(idle, "idle")
JOURNEYS = {
    "wide": {"corner": 150.0, "corner_feed": 20.0, "corner_acceleration": 5000.0, "corner_phase": 0.3},
    "close": {"corner": 30.0, "corner_feed": 5.0, "corner_acceleration": 3000.0, "corner_phase": 0.85},
    "one after the other": {"corner": 10.0, "corner_feed": 2.0, "corner_acceleration": 200.0, "corner_phase": 0.0},
    "fast": {"feed": 1000.0, "corner": 400.0, "corner_feed": 40.0, "corner_acceleration": 10_000.0},
}


def fleet_on(**journey) -> Fleet:
    fleet = Fleet(1, LAW, heads.ensure([0]))
    fleet.set("start.gap", 0, 5.0)
    for name, value in journey.items():
        fleet.set(f"path.{name}", 0, value)
    return fleet


def lived(fleet: Fleet, periods: int, *columns: str) -> np.ndarray:
    """Columns when the episode has begun and after each period, shape (columns, periods + 1)."""
    fleet.begin(0, 1)
    out = np.empty((len(columns), periods + 1))
    for i in range(periods + 1):
        out[:, i] = [fleet.column(name)[0] for name in columns]
        fleet.advance()
    return out


def corners_before(distance: float, corner: float, corner_phase: float = 0.0, **_) -> np.ndarray:
    n = np.arange(-1, int(distance / corner) + 2)
    return corner * (n + 0.2 + 0.6 * np.mod(corner_phase + n * (np.sqrt(5) - 1) / 2, 1.0))


@pytest.mark.parametrize("name", JOURNEYS)
def test_the_feed_falls_before_a_corner_and_rises_after_it_by_the_acceleration(name):
    journey = {"feed": 200.0, **JOURNEYS[name]}
    here, feed = lived(fleet_on(**journey), 4000, "journey.here", "signals.feed")
    off = np.abs(here[:, None] - corners_before(here[-1], **journey)).min(axis=1)
    squared = np.minimum(journey["feed"] ** 2, journey["corner_feed"] ** 2 + 2 * journey["corner_acceleration"] * off)
    assert feed**2 == pytest.approx(squared, rel=1e-9)
    assert feed.min() < 1.2 * journey["corner_feed"] + journey["corner_acceleration"] * PERIOD
    assert np.ptp(feed) > 0.2 * journey["feed"]


@pytest.mark.parametrize("phase", np.linspace(0.0, 0.95, 6))
def test_each_pitch_has_one_corner_in_its_middle_three_fifths(phase):
    p = path.Params(corner=100.0, corner_phase=float(phase))
    places = np.array([path.corner_at(p, float(n)) for n in range(-3, 1000)])
    share = places / 100.0 - np.arange(-3, 1000)
    assert share.min() >= 0.2 - 1e-9
    assert share.max() < 0.8 + 1e-9
    assert share.mean() == pytest.approx(0.5, abs=0.01)
    assert share.std() == pytest.approx(0.6 / np.sqrt(12), rel=0.02)


def test_the_slow_places_that_are_driven_through_lie_one_in_each_pitch():
    pitch = 60.0
    here, feed = lived(
        fleet_on(corner=pitch, corner_feed=10.0, corner_acceleration=20_000.0, corner_phase=0.4),
        6000,
        "journey.here",
        "signals.feed",
    )
    slow = here[1:-1][(feed[1:-1] <= feed[:-2]) & (feed[1:-1] < feed[2:]) & (feed[1:-1] < 100.0)]
    whole = slow[slow < pitch * np.floor(here[-1] / pitch)]
    assert np.array_equal(np.floor(whole / pitch), np.arange(len(whole)))
    assert len(whole) >= 12
    assert np.all(np.abs(whole / pitch % 1.0 - 0.5) < 0.3 + 0.2 / pitch)


@pytest.mark.parametrize("name", JOURNEYS)
def test_the_machine_is_where_its_path_was_5_ms_ago_to_the_bit(name):
    ahead, here, feed = lived(fleet_on(**JOURNEYS[name]), 3000, "journey.distance", "journey.here", "signals.feed")
    assert here[0] == 0.0
    assert np.array_equal(here[AHEAD:], ahead[:-AHEAD])
    assert np.diff(here) == pytest.approx(feed[:-1] * PERIOD, abs=1e-9)  # the signal is the feed of the coming period


@pytest.mark.parametrize("name", JOURNEYS)
def test_with_corners_too_the_sheet_ahead_is_what_the_machine_meets(name):
    fleet = fleet_on(**JOURNEYS[name])
    fleet.put_plate(0, 5.6)
    fleet.put_wave(0, 0, 0.4, 0.2, 0.0, 0.3)
    fleet.put_random(0, (2.0, 300.0, 5.6), 0, (0.1, 0.2, 17.0, 900.0))
    fleet.put_vibration(0, 0, 0.02, 30.0, 0.3, 0.1)
    seen = lived(fleet, 600, *(f"signals.surface_{ahead}" for ahead in range(AHEAD + 1)))
    assert np.ptp(seen[0]) > 0.2
    for ahead in range(1, AHEAD + 1):
        assert np.array_equal(seen[ahead, :-ahead], seen[0, ahead:])


def test_the_sheet_lies_under_the_place_where_the_machine_is():
    journey = JOURNEYS["close"]
    fleet = fleet_on(**journey)
    fleet.set("sheet.tilt_x", 0, 0.01)
    fleet.put_feature(0, 0, 40.0, 1e9, 0.3, 0.0)
    here, z = lived(fleet, 2000, "journey.here", "signals.surface_0")
    away = np.abs(here - 40.0) > 2.0
    assert z[away] == pytest.approx((0.01 * here + np.where(here > 40.0, 0.3, 0.0))[away], abs=1e-9)
    assert here[-1] > 60.0


def test_without_corners_the_feed_is_constant():
    here, ahead, feed = lived(fleet_on(feed=137.0), 500, "journey.here", "journey.distance", "signals.feed")
    assert (feed == 137.0).all()
    assert here == pytest.approx(137.0 * 1e-3 * np.arange(501), abs=1e-9)
    assert ahead - here == pytest.approx(137.0 * 1e-3 * AHEAD, abs=1e-9)


def test_between_two_cuts_the_way_is_straight_and_the_beam_is_off():
    """Right along y = 0, up beside it, back along y = 10: 30, 10 and 20 mm."""
    cuts = [np.array([[0.0, 0.0], [12.0, 0.0], [30.0, 0.0]]), np.array([[30.0, 10.0], [10.0, 10.0]])]
    way = path.resample("two cuts", cuts)
    along = path.SPACING * np.arange(len(way.x))
    assert way.length == pytest.approx(60.0, abs=path.SPACING)
    assert way.x == pytest.approx(np.interp(along, [0.0, 30.0, 40.0, 60.0], [0.0, 30.0, 30.0, 10.0]), abs=1e-9)
    assert way.y == pytest.approx(np.clip(along - 30.0, 0.0, 10.0), abs=1e-9)
    away = np.minimum(np.abs(along - 30.0), np.abs(along - 40.0)) > 1e-6  # rounding says on which side an end lies
    assert np.array_equal(way.cutting[away] == 0.0, ((along > 30.0) & (along < 40.0))[away])
