"""The studies of CN102528288A: what its scheduled gains are compared with, and that the verdicts follow the runs."""

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.reproduce import cn102528288a, cn102528288a_height, fixed_gains
from kerfgym.experiments.reproduce.claims import Trial

SIX = Trial(seeds=6)


def rows(study):
    return {row.claim: row for row in study(SIX).rows}


def test_gains_that_are_scheduled_make_the_documents_law():
    case = scenarios.load("rough").varied(duration=0.6, settle=0.1, start_above=4.0)
    theirs, ours = (
        rollout.roll(case, stack.varied(cn102528288a.OPEN), np.arange(4))
        for stack in (stacks.get("cn102528288a"), stacks.as_stack(fixed_gains, "fixed-gains"))
    )
    assert np.abs(theirs["wish"]).max() > 10.0
    assert np.array_equal(theirs["wish"], ours["wish"])


@pytest.mark.parametrize(("share", "wish"), [(0.35, -0.35), (0.75, -0.75), (0.0, -0.75)])
def test_a_fixed_share_holds_at_any_error(share, wish):
    class Signals:
        height, set_height, head_velocity, override, captured = 5.0, 1.0, 0.0, False, False

    p = fixed_gains.Params(gain=100.0, kpv=1.0, ki=0.0, kiv=0.0, share=share)
    control = getattr(fixed_gains.control, "py_func", fixed_gains.control)
    assert control(p, fixed_gains.State(), Signals(), None)[1] == pytest.approx(wish * 100.0 * 4.0)


def test_integrals_that_are_always_on_fill_on_the_way_down():
    gated, always = (cn102528288a.arrival(SIX, gain=100.0, gated=g) for g in (1.0, 0.0))
    assert np.median(always.over) > 2.0 * np.median(gated.over)


def test_verdicts_on_scheduled_gains_follow_from_the_runs(monkeypatch):
    def made(time, over, hits=0):
        return cn102528288a.Arrival(np.full(6, time), np.full(6, over), np.arange(6) < hits)

    def good(trial, gain, share=0.0, gated=1.0):
        return made(0.1, 0.01) if share == 0.0 and gated > 0.5 else made(0.2, 0.1)

    def bad(trial, gain, share=0.0, gated=1.0):
        return made(0.3, 0.2) if share == 0.0 and gated > 0.5 else made(0.2, 0.1)

    for arrivals, verdict in ((good, "trend only"), (bad, "does not hold here")):
        monkeypatch.setattr(cn102528288a, "arrival", arrivals)
        found = rows(cn102528288a.scheduled_against_fixed)
        ours = [row for claim, row in found.items() if claim.startswith(("position gain", "integral gains opened"))]
        assert len(ours) == 3
        assert {row.verdict for row in ours} == {verdict}


def test_constants_that_are_re_read_are_inputs():
    assert {row.verdict for row in cn102528288a.schedules(SIX).rows} == {"input"}


def test_a_protected_head_stays_and_one_that_stood_still_would_come_too_near():
    found = list(rows(cn102528288a.protection).values())
    assert found[0].evidence.trivial_error > 100.0  # µm, following dives over holes
    assert found[1].evidence.trivial_error == pytest.approx(1.2 - 0.8, abs=0.25)  # 2 mm less a rise of 1.2 mm


def test_verdicts_on_focus_and_height_follow_from_the_jobs(monkeypatch):
    def jobs(best):
        def made(name, scenario, seeds):
            key, value = name.split(":law.")[1].split("=")
            x = float(value) - (best if key == "focus" else 0.0)
            whole = key == "focus" or abs(x) < 0.7
            return {n: np.full(6, 1.0 + x * x) for n in ("roughness", "dross")} | {"through": np.full(6, float(whole))}

        return made

    for best, verdict in ((0.0, "calibrated"), (-2.0, "does not hold here")):
        monkeypatch.setattr(cn102528288a_height, "jobs_of", jobs(best))
        found = cn102528288a_height.focus_and_height(SIX).rows
        assert {row.verdict for row in found if "depth of the focus" in row.claim} == {verdict}
        assert {row.verdict for row in found if "depth of the focus" not in row.claim} == {"trend only"}
        assert "−0.9 mm, +0.9 mm" in [str(row.simulation) for row in found]
