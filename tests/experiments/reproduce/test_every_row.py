"""Every row of every study, from a run with few seeds: what is called reproduced has a printed figure to show."""

import math

import pytest

from kerfgym.experiments.reproduce.claims import DOCUMENTS, Trial, studies

FEW = Trial(seeds=6)

MISSING = ("", "-", "–", "—", "?")
"""What a column says that says nothing."""

UNPRINTED = ("named", "not mentioned")

WANTED = {
    "cn102528288a/scheduled-against-fixed": ("faster", "overshoot"),
    "wu/low-speed": ("low-speed",),
    "huang2024/absorption": ("absorption", "cutting"),
    "huang2024/shapes": ("inclination",),
    "xi2023/table-1": ("Table 1",),
}
"""Claims of the documents that must have a row, by study: words of the column of the paper."""


@pytest.fixture(scope="module", params=[s.name for s in studies()])
def study(request):
    """A study's name, the document it is of, and its rows."""
    (found,) = studies([request.param])
    return found, found.run(FEW).rows


def test_what_is_called_reproduced_is_printed_somewhere_and_met_where_a_trivial_predictor_is_not(study):
    found, rows = study
    assert found.document in DOCUMENTS
    assert rows
    for row in rows:
        if row.verdict == "reproduced":
            assert row.where not in MISSING, row.claim
            assert row.paper not in MISSING, row.claim
            assert not row.paper.startswith(UNPRINTED), row.claim
            assert not row.instead, row.claim
            e = row.evidence
            assert abs(e.error) <= e.tolerance < abs(e.trivial_error), row.claim
            assert e.trivial, row.claim


def test_what_is_only_named_is_called_present_and_whatever_is_printed_is_not(study):
    _, rows = study
    for row in rows:
        unprinted = row.paper.startswith(UNPRINTED) or row.paper in MISSING
        assert unprinted or row.verdict != "present", row.claim
        assert not unprinted or row.verdict in ("present", "does not hold here"), row.claim
        assert row.evidence is None or not math.isnan(row.evidence.tolerance), row.claim


def test_the_claims_that_an_expert_would_look_for_have_rows(study):
    found, rows = study
    said = " ".join(row.paper for row in rows)
    assert all(word in said for word in WANTED.get(found.name, ()))
    assert set(WANTED) <= {s.name for s in studies()}
