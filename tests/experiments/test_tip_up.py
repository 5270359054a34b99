"""Parts that stand proud: what a drive can clear."""

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.studies import tip_up

SEEDS = np.arange(24)
SCENARIO = scenarios.suite("following")["tip-up"]


def test_who_climbs_at_once_loses_all_runs_that_the_closed_form_says_are_lost():
    hopeless = tip_up.hopeless(SCENARIO, SEEDS).any(axis=1)
    lost = tip_up.lost(SCENARIO, SEEDS)
    assert hopeless.sum() > 0.1 * len(SEEDS)
    assert lost[hopeless].all()
    assert (tip_up.lost(SCENARIO, SEEDS, 1.0) >= lost).all()


def test_low_parts_are_cleared_and_the_closed_form_lies_above_them():
    low = SCENARIO.varied(sheet={"holes": {"rise": 3.0}})
    assert not tip_up.lost(low, SEEDS).any()
    assert not tip_up.hopeless(low, SEEDS).any()


def test_a_drive_whose_acceleration_is_nothing_clears_its_set_height():
    """It stands where it stood: what is higher than that is hit, what is not is cleared."""
    slow = SCENARIO.varied(axis={"acceleration": 500.0, "dead_time": 0.004}, feed=2000.0)
    fleet = rollout.fleet_for(slow, stack.resolve("idle"), SEEDS)
    assert tip_up.clearable(fleet) == pytest.approx(fleet.column("job.set_height"), abs=0.01)
