"""Machines of another make, which share no code with the model: how well their logs tell how they follow, and which of
them it says that it can't stand for. All of them: ``python -m kerfgym.tests.oracle.foreign_study``."""

import numpy as np
import pytest

from kerfgym.envs.plant import calibration
from kerfgym.experiments.identify import drive, head, posterior
from kerfgym.experiments.identify.identifying import UNEXPLAINED
from kerfgym.tests.oracle.foreign import FRESH, GOOD, WRONG
from kerfgym.tests.oracle.foreign_logs import recorded, scripted
from kerfgym.tests.oracle.foreign_study import CONTROLLERS, identified, measured, predicted, unseen


@pytest.fixture(autouse=True)
def _quickly(monkeypatch):
    """Without the search over the whole prior, which comes to nothing here and takes as long as all the rest; from one
    place, and with fewer draws, since no interval is asked."""
    monkeypatch.setattr(drive, "GENERATIONS", 1)
    monkeypatch.setattr(drive, "STARTS", 1)
    monkeypatch.setattr(posterior, "ROUNDS", 1)


def test_logs_of_another_make_tell_its_following_error_on_an_unseen_sheet_within_a_tenth(tmp_path):
    make = GOOD["screw"]
    found, sheet = identified(make, tmp_path), unseen(tmp_path)
    assert found.explained
    assert not any("does not explain" in note for note in found.notes)
    assert "does not explain its drive" not in found.machine.summary
    for controller in CONTROLLERS:
        here = measured(make, controller, tmp_path / "table.csv", sheet, seeds=(0,))
        there = float(np.mean(predicted(found.machine, controller, tmp_path, range(8))))
        assert there == pytest.approx(here, rel=0.1), controller


def test_a_table_of_a_sweep_that_begins_with_play_can_be_read(tmp_path):
    table = head.swept(recorded(FRESH["gear"], "sweep", tmp_path)).table
    assert table.frequency[0] > 1e5
    assert np.all(np.diff(table.frequency) > 0)
    calibration.write_csv(table, tmp_path / "table.csv")
    assert calibration.read_csv(tmp_path / "table.csv").frequency == pytest.approx(table.frequency, rel=1e-6)


@pytest.mark.parametrize("name", ["load at 40 Hz"])
def test_a_drive_that_the_model_cannot_stand_for_leaves_more_of_its_slow_moves_than_is_allowed(name):
    encoder, command, _ = scripted(WRONG[name], "motion", 0).T
    errors = drive.Errors(command, encoder)
    slow = errors.first(errors.slow)
    assert slow.beyond_rounding(*drive._slow(slow)) > 1.5 * UNEXPLAINED
