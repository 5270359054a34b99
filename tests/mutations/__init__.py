"""Mutants: the plant and the laws with one small mistake each, and which of them no test sees.

It stands with the tests, not with the experiments, because it asks about them: nothing of the package needs it.
"""
