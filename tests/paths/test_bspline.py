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
        (-(t**3) + 3 * t**2 - 3 * t + 1) / 6,
        (3 * t**3 - 6 * t**2 + 4) / 6,
        (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6,
        t**3 / 6,
    ]
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


def test_bad_input_is_named():
    with pytest.raises(InvalidInput, match="3 control points; a cubic B-spline needs at least 4"):
        bspline.sampled(CONTROL[:3], 5)
