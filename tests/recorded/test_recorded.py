"""The figures of everything shipped are those that were recorded.

A change of structure leaves them; a change of the machine or of a law moves them, and then ``python -m
kerfgym.tests.recorded`` writes them anew. No independent source: whether they are *right* is what the other tests ask.
"""

import numpy as np
import pandas as pd
import pytest

from kerfgym.tests.recorded import figures

RECORDED = pd.read_csv(figures.FILE)

NEAR = 1e-6
"""Relative: another processor rounds otherwise, and a loop carries that on."""


@pytest.mark.parametrize("name", figures.NAMES)
def test_figures_are_those_that_were_recorded(name):
    was = RECORDED[RECORDED["name"] == name].reset_index(drop=True)
    now = pd.DataFrame(figures.of(name))
    pd.testing.assert_frame_equal(now.drop(columns="value"), was.drop(columns="value"))
    apart = ~np.isclose(now["value"], was["value"], rtol=NEAR, atol=0.0, equal_nan=True)
    assert not apart.any(), now.assign(was=was["value"])[apart].to_string()


def test_nothing_recorded_is_of_something_that_is_not_there():
    assert list(RECORDED["name"].unique()) == figures.NAMES
