"""Cubic B-splines against Huang2024's equations, scipy, and shapes that they must recover."""

import numpy as np
import pytest
import sympy
from scipy.interpolate import BSpline

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths import bspline

CONTROL = np.random.default_rng(0).uniform(-10.0, 10.0, (9, 2))


def test_the_basis_is_eq_5_corrected_and_sums_to_1():
    t = sympy.Symbol("t")
    printed = [
        (-(t**3) + 3 * t**2 - 3 * t + 1) / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6,
        t**3 / 6,
    ]  # fmt: skip
    assert sympy.simplify(sum(printed) - 1) == 0
    at = np.linspace(0.0, 1.0, 11)
    exact = np.array([[float(n.subs(t, x)) for n in printed] for x in at])
    assert np.allclose(bspline.basis(at), exact, atol=1e-15)
    assert np.allclose(bspline.basis(at).sum(axis=1), 1.0, atol=1e-15)


def test_ends_and_tangents_are_those_of_eqs_7_and_8():
    c = CONTROL[:4]
    curve = bspline.sampled(c, 1000)
    assert np.allclose(curve[0], (c[0] + 4 * c[1] + c[2]) / 6)
    assert np.allclose(curve[-1], (c[1] + 4 * c[2] + c[3]) / 6)
    h = 1e-6
    start, end = (np.diff(bspline.basis([x, x + h]) @ c, axis=0)[0] / h for x in (0.0, 1.0 - h))
    assert np.allclose(start, (c[2] - c[0]) / 2, atol=1e-4)
    assert np.allclose(end, (c[3] - c[1]) / 2, atol=1e-4)


def test_a_curve_is_that_of_scipys_uniform_b_spline():
    ours = bspline.sampled(CONTROL, 20)
    theirs = BSpline(np.arange(-3, len(CONTROL) + 1), CONTROL, 3)(np.linspace(0.0, len(CONTROL) - 3.0, len(ours)))
    assert np.allclose(ours, theirs, atol=1e-12)
    around = bspline.sampled(CONTROL, 20, closed=True)
    assert np.allclose(around[0], around[-1])
    assert len(around) == 20 * len(CONTROL) + 1


@pytest.mark.parametrize("closed", [False, True])
def test_an_interpolating_curve_passes_its_points(closed):
    control = bspline.through(CONTROL, closed)
    passed = bspline.sampled(control, 1, closed)
    assert np.allclose(passed[: len(CONTROL)], CONTROL, atol=1e-10)


def test_a_straight_and_a_circular_fit_recover_their_shape():
    line = np.stack([np.linspace(0.0, 50.0, 200), np.linspace(3.0, 8.0, 200)], axis=1)
    control = bspline.fit(line, 1e-6)
    assert len(control) == 4  # one segment
    curve = bspline.sampled(control, 100)
    slope = (curve[:, 1] - 3.0) - 0.1 * curve[:, 0]
    assert np.abs(slope).max() < 1e-9
    angle = np.linspace(0.0, 2 * np.pi, 721)[:-1]
    ring = 20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    control = bspline.fit(ring, 0.005, closed=True)
    radius = np.hypot(*bspline.sampled(control, 50, closed=True).T)
    assert np.abs(radius - 20.0).max() < 0.006
    assert len(control) <= 16


def test_bad_input_is_named():
    with pytest.raises(InvalidInput, match="3 control points; a cubic B-spline needs at least 4"):
        bspline.sampled(CONTROL[:3], 5)
    with pytest.raises(InvalidInput, match="points 2 and 3 are the same"):
        bspline.through(CONTROL[[0, 1, 1, 2]])
    with pytest.raises(InvalidInput, match="a fit needs at least 4"):
        bspline.fit(CONTROL[:3], 0.1)
