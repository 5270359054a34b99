"""The cost of a decision: that it is of the law's own decisions is checked, how fast they are is not."""

import pytest

from kerfgym.envs.control.stack import python_stack, resolve
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import heads, machine
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.experiments.measure import cost as decisions


@pytest.mark.parametrize("spec", ["pid", "mpc"])
def test_what_is_timed_decides_as_the_machine_did(spec):
    """Over recorded signals the law comes to the wish that it came to in the roll-out."""
    stack = resolve(spec)
    signals = decisions.lived(stack, "rough", 201)
    fleet = decisions.rollout.fleet_for(decisions.scenarios.load("rough"), stack, [decisions.SEED])
    fleet.advance(200)
    alone = Fleet(1, stack.law, heads.POOL)
    stack.install(alone, [0])
    decisions._decide_kernel.bound(decisions.deck_for(alone, signals, len(signals)))()
    assert alone.slots(machine.WISH, 1)[0] == fleet.slots(machine.WISH, 1)[0] != 0.0


class Slow:
    """Sums up a thousand numbers for each decision."""

    def reset(self):
        self.calls = 0

    def control(self, signals):
        self.calls += 1
        return 0.0 * sum(range(1000)) * signals.height


def test_costs_are_told_in_one_unit_for_compiled_and_python_laws():
    quick, slow = decisions.measure("pid", 1000), decisions.measure(python_stack(Slow, "slow"), 1000)
    for cost in (quick, slow):
        assert 0.0 <= cost.median_us <= cost.p99_us
        assert cost.ratio == pytest.approx(cost.p99_us / 1000.0)  # of a period of 1 ms
    assert "pid" in decisions.table(["pid"], 1000)


def test_bad_input_is_told():
    with pytest.raises(InvalidInput, match=r"'wu' drives slot 'xy'"):
        decisions.measure("wu")
    with pytest.raises(InvalidInput, match=r"decisions = 10, chunk = 5; allowed: 100"):
        decisions.measure("pid", 10)
