"""A controller on readings from outside commands what it commands within the simulated machine."""

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import calibration, heads
from kerfgym.envs.scenarios import machines
from kerfgym.experiments.identify.outside import Outside
from kerfgym.experiments.measure import rollout

MACHINE = {"name": "one", "head": {"nominal": True}}


def lived(controller, periods=1500, scenario="wavy"):
    """Readings of an episode, first those that it begins with, and its commands."""
    scenario = machines.put_on(scenarios.load(scenario).varied(set_height=1.0), machines.load(MACHINE))
    stack = resolve(controller) if isinstance(controller, str) else controller
    fleet = rollout.fleet_for(scenario, stack, [3])
    seen = [fleet.row(f"signals.{name}") for name in ("frequency", "head_position", "command")]
    rows = [[float(each[0]) for each in seen]]
    ahead = rollout.periods(fleet, stack, periods)
    for _ in range(periods):
        next(ahead)
        rows.append([float(each[0]) for each in seen])
    return np.array(rows)


@pytest.mark.parametrize("controller", ["xi2023-improved", "pid", "observer", "forecast"])
def test_on_the_readings_of_an_episode_it_says_that_episodes_commands_to_the_last_bit(controller):
    rows = lived(controller)
    outside = Outside(controller, MACHINE, set_height=1.0, seed=3)
    said = [outside.begin(*rows[0, :2])]
    said += [outside.step(*row) for row in rows[1:-1, :2]]
    assert np.abs(rows[1:, 2]).max() > 5.0
    np.testing.assert_array_equal(said, rows[1:, 2])


class Own:
    """A controller in plain Python."""

    def reset(self):
        """Nothing to forget."""

    def control(self, signals):
        """Goes to the set height."""
        return -40.0 * (signals.height - signals.set_height)


def test_a_controller_in_plain_python_is_asked_as_well():
    from kerfgym.envs.control.stack import as_stack

    stack = as_stack(Own, "own")
    rows = lived(stack, 300)
    outside = Outside(stack, MACHINE, set_height=1.0, seed=3)
    said = [outside.begin(*rows[0, :2]), *(outside.step(*row) for row in rows[1:-1, :2])]
    np.testing.assert_array_equal(said, rows[1:, 2])


def test_heights_are_read_from_the_table_that_is_given(tmp_path):
    table = heads.POOL[0]
    calibration.write_csv(table._replace(frequency=1.01 * table.frequency), tmp_path / "mine.csv")
    plain, mine = Outside("pid", MACHINE), Outside("pid", MACHINE, table=tmp_path / "mine.csv")
    middle = float(np.interp(2.0, table.height, table.frequency))
    plain.begin(middle, 2.0)
    mine.begin(1.01 * middle, 2.0)
    assert plain.signal("height") == pytest.approx(2.0, abs=0.05)
    assert mine.signal("height") == pytest.approx(plain.signal("height"), abs=1e-3)


def test_a_lost_reading_is_contact_and_no_number_is_refused():
    outside = Outside("pid", MACHINE)
    with pytest.raises(InvalidInput, match="before step"):
        outside.step(3.7e6, 1.0)
    outside.begin(3.7e6, 1.0)
    for _ in range(3):
        command = outside.step(0.0, 1.0)
    assert command > 0.0  # up
    with pytest.raises(InvalidInput, match="frequency = nan"):
        outside.step(np.nan, 1.0)
