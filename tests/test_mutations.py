"""Mutants are one mistake each, in places where mistakes change what a machine does."""

import ast
from pathlib import Path

import pytest

from kerfgym.tests.mutations import tests_of
from kerfgym.tests.mutations.mutants import mutants, sample

ROOT = Path(__file__).parents[1]

SOURCE = '''
"""Text with 3 numbers."""
LIMIT = 4.0


class Params(NamedTuple):
    """Parameters."""

    gain: float = 2.0


def control(p, x):
    """Doubles 2."""
    s = load(State, block, a + 3)
    if x > LIMIT and not p.off:
        raise ValueError(f"{x + 1} is above {LIMIT}")
    return min((x + s) * p.gain, abs(x)) if p.on else clip(-x, 0.0, 1.0)
'''


@pytest.fixture
def found(tmp_path):
    path = tmp_path / "law.py"
    path.write_text(SOURCE, encoding="utf-8")
    return mutants(path, "baselines/law.py")


def test_every_kind_of_mistake_is_made_where_it_can_be(found):
    made = {(m.kind, m.old, m.new) for m in found}
    assert made >= {
        ("number", "4.0", "8.0"),
        ("number", "4.0", "2.0"),
        ("number", "4.0", "0.0"),
        ("number", "0.0", "1.0"),
        ("comparison", ">", "<="),
        ("boundary", ">", ">="),
        ("not dropped", "not p.off", "p.off"),
        ("junction", "x > LIMIT and not p.off", "(x > LIMIT or not p.off)"),
        ("function", "min", "max"),
        ("operator", "(x + s) * p.gain", "((x + s) / p.gain)"),
        ("term dropped", "x + s", "(x)"),
        ("term dropped", "x + s", "(s)"),
        ("sign kept", "abs(x)", "(x)"),
        ("choice", "p.on", "(not (p.on))"),
        ("limit dropped", "clip(-x, 0.0, 1.0)", "(-x)"),
        ("sign dropped", "-x", "x"),
    }


def test_declared_defaults_addresses_messages_and_docstrings_have_none(found):
    assert {m.line for m in found} == {3, 15, 17}


def test_each_mutant_is_a_program_and_another_one(found):
    trees = {ast.dump(ast.parse(m.applied(SOURCE.encode()))) for m in found}
    assert len(trees) == len(found)
    assert ast.dump(ast.parse(SOURCE)) not in trees


def test_a_sample_is_random_and_the_same_for_the_same_seed(found):
    assert sample(found, 5, 1) == sample(found, 5, 1)
    assert sample(found, 5, 1) != sample(found, 5, 2)
    assert sample(found, 10**6, 1) == found


def test_every_module_has_tests_that_see_it():
    for file in tests_of.modules(ROOT):
        tests = tests_of.of(file)
        assert tests
        assert all((ROOT / each).exists() for each in tests), file
