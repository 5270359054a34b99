"""Routes: micro-joints, kerf compensation, programmes."""

import numpy as np
import pytest
from shapely import LineString, Polygon, unary_union

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths import job as jobs
from kerfgym.envs.paths import kerf, parts
from kerfgym.envs.paths.curve import Curve
from kerfgym.envs.paths.drawing import drawing
from kerfgym.envs.paths.profile import corners_of
from kerfgym.envs.paths.read import read
from kerfgym.envs.paths.route import Cutting, routed

PROGRAMME = "G21 G90\nF{feed}\nG0 X10 Y10\nM3 S1\nG1 X30\nY30\nX10\nY10\nM5\nM2\n"


@pytest.fixture
def programme(tmp_path):
    def write(feed=1200):
        file = tmp_path / "part.ngc"
        file.write_text(PROGRAMME.format(feed=feed))
        return read(file)

    return write


def sheet(*rings):
    """A drawing of closed rings, in this order."""
    curves = []
    for ring in rings:
        points = np.array(ring, float)
        legs = np.diff(points, axis=0)
        curves.append(Curve(points, corners_of(points), complex(*legs[0]), complex(*legs[-1]), closed=True))
    return drawing("sheet", "sheet", curves)


def square(x, y, side):
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side), (x, y)]


def test_who_wants_no_lead_in_is_not_told_that_there_is_no_room_for_one():
    route = routed(sheet(square(0, 0, 50)), Cutting(lead_in=0.0, joints=3))
    assert [cut.how for cut in route.cuts] == ["none"] * 3
    assert route.warnings == []


# -------------------------------------------------------------------------------------------------- micro-joints


@pytest.mark.parametrize("name", ["square", "gear", "corners", "circle", "rosette"])
@pytest.mark.parametrize("count", [1, 3, 8])
def test_joints_hold_the_part_with_the_width_asked_for(name, count):
    """What the kerf leaves is one piece with the sheet; without the joints it would be two."""
    cutting = Cutting(lead_in=2.0, kerf=0.2, joints=count, joint_width=0.4)
    made = parts.part(name)
    route = routed(made, cutting)
    outline = [i for i, hole in enumerate(route.nesting.hole) if not hole]
    assert len(route.joints) == count
    around = [c for c in route.cuts if c.contour in outline]
    assert len(around) == count
    taken = unary_union(
        [LineString(p).buffer(0.1, quad_segs=16) for c in around for p in (c.way, c.path) if len(p) > 1]
    )
    part = Polygon(made.pieces[outline[0]])
    left = part.buffer(8.0).difference(taken)
    assert left.geom_type == "Polygon"  # held
    closed = taken.union(unary_union([LineString(j).buffer(0.1) for j in route.joints]))
    assert part.buffer(8.0).difference(closed).geom_type == "MultiPolygon"  # loose
    for joint in route.joints:
        assert np.hypot(*(joint[0] - joint[1])) == pytest.approx(0.4 + 0.2, rel=0.12)


def test_a_spacing_gives_as_many_joints_as_fit_it():
    route = routed(parts.part("square", side=50.0), Cutting(joint_spacing=40.0))
    assert len(route.joints) == 5


def test_a_part_too_short_for_its_joints_gets_fewer_and_is_named():
    route = routed(parts.part("square", side=5.0), Cutting(joints=20, joint_width=0.5, kerf=0.2))
    assert len(route.joints) == 7  # a quarter of 20 mm, 0.7 mm each
    assert "contour 1, which begins at x = 0.00, y = 0.00 mm, is too short for 20 joints" in route.warnings[0]


def test_joints_keep_away_from_corners():
    made = parts.part("square", side=50.0)
    for joint in routed(made, Cutting(joints=4)).joints:
        middle = joint.mean(axis=0)
        assert np.abs(middle - np.array([[0, 0], [0, 50], [50, 0], [50, 50]])).max(axis=1).min() > 1.0


def test_the_machine_leaves_joints_uncut():
    cutting = Cutting(lead_in=2.0, kerf=0.2, joints=2, joint_width=0.5)
    job = jobs.driven(routed(parts.part("square", side=20.0), cutting), jobs.Settings(feed=50.0))
    at = np.stack([job.x, job.y], axis=1)
    cut = at[(job.phase == jobs.CUT) & (job.beam > 0)]
    for joint in job.route.joints:
        middle = joint.mean(axis=0)
        assert np.hypot(*(cut - middle).T).min() > 0.3
    assert len(job.contours) == 2
    assert (job.phase == jobs.PIERCE).sum() > 0
    assert job.cut_length == pytest.approx(80.0 - 2 * 0.7 + 2 * 2.0, rel=1e-3)


# ----------------------------------------------------------------------------------------------------- compensation


def test_a_hole_that_the_kerf_is_too_wide_for_is_left_out_and_named():
    plate = parts.part("slot-plate")
    moved = kerf.compensated(plate, 5.0)
    assert len(moved.pieces) == len(plate.pieces) - 4  # holes of 4 mm
    assert sum("vanishes: it is left out at a kerf of 5 mm" in w for w in moved.warnings) == 4


def test_a_hole_with_a_waist_falls_apart_into_pieces_that_are_all_cut():
    below = [(10, 10), (15, 10), (15, 12.4), (25, 12.4), (25, 10), (30, 10)]
    dumbbell = [*below, *((x, 25 - y) for x, y in reversed(below)), below[0]]
    moved = kerf.compensated(sheet(dumbbell, square(0, 0, 40)), 0.3)
    assert len(moved.pieces) == 3
    assert "contour 1, which begins at x = 10.00, y = 10.00 mm, falls apart into 2 pieces at a kerf of 0.3 mm" in (
        moved.warnings
    )
    assert [Polygon(p).area for p in moved.pieces] == pytest.approx([4.7**2, 4.7**2, 40.3**2], rel=2e-3)


def test_parts_nearer_than_the_kerf_are_named():
    moved = kerf.compensated(sheet(square(0, 0, 10), square(10.2, 0, 10)), 0.3)
    assert sum("is nearer to another than the kerf of 0.3 mm" in w for w in moved.warnings) == 2
    assert not kerf.compensated(sheet(square(0, 0, 10), square(10.4, 0, 10)), 0.3).warnings


# ------------------------------------------------------------------------------------------------------- programmes


def test_a_programme_is_cut_as_programmed(programme):
    made = programme()
    route = routed(made, Cutting(lead_in=3.0))
    assert made.closed == [True]
    (cut,) = route.cuts
    assert np.array_equal(cut.way, made.pieces[0][:1])
    assert np.array_equal(cut.path, made.pieces[0])
    job = jobs.plan(made, jobs.Settings(feed=50.0))
    assert not (job.phase == jobs.LEAD_IN).any()
    assert (job.x.min(), job.y.min(), job.x.max(), job.y.max()) == pytest.approx((10, 10, 30, 30), abs=1e-6)


def test_a_programmes_feed_is_driven_and_what_the_axes_cannot_do_is_told(programme):
    job = jobs.plan(programme(1200), jobs.Settings(feed=50.0))
    assert job.feed[job.phase == jobs.CUT].max() == pytest.approx(20.0, rel=1e-3)
    assert job.cut_feed == pytest.approx(20.0)
    job = jobs.plan(programme(60000), jobs.Settings(feed=50.0))
    assert job.cut_feed == pytest.approx(133.4)
    assert "feeds of up to 1000 mm/s are programmed; the axes go at 133.4 mm/s at most" in job.warnings
    job = jobs.plan(programme(1200), jobs.Settings(feed=50.0, as_programmed=False))
    assert job.cut_feed == 50.0


def test_nothing_is_added_to_a_programme(programme):
    with pytest.raises(InvalidInput, match="is a programme and is cut as programmed; allowed: no joints"):
        routed(programme(), Cutting(joints=2))
    with pytest.raises(
        InvalidInput, match="is a programme and is cut as programmed; allowed: 0, with the kerf compensated"
    ):
        kerf.compensated(programme(), 0.2)


def test_a_job_that_takes_hours_is_refused_before_it_is_planned():
    with pytest.raises(InvalidInput, match=r"at least \d+ s \(1 cuts, 0\.2 m\) is out of range; allowed: 5400"):
        jobs.plan(parts.part("square"), jobs.Settings(feed=0.03))
