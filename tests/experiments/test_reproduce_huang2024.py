"""Huang2024's studies: bases, radar and dither against independent sources, and what they conclude."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from kerfgym.envs.plant import spot
from kerfgym.envs.scenarios import material as materials
from kerfgym.experiments.reproduce import fit_cut, huang2024
from kerfgym.experiments.reproduce.claims import Trial

TRIAL = Trial(seeds=6)
T = np.linspace(0.0, 1.0, 21)


def verdicts(findings):
    return {(row.where, row.claim): row.verdict for row in findings.rows}


def test_eq_4_is_scipys_uniform_basis_of_any_degree():
    for k in (2, 3, 4):
        theirs = np.stack([BSpline(np.arange(-k, k + 2), np.eye(k + 1)[i], k)(T) for i in range(k + 1)], axis=1)
        assert np.allclose(huang2024.general_basis(T, k), theirs, atol=1e-12)


def test_the_printed_eq_5_sums_to_1_at_the_start_and_to_0_at_the_end():
    # Two misprints: 3t² for 3t³ in N1, −3t² for +3t² in N2.
    total = huang2024.printed_basis(T).sum(axis=1)
    assert np.allclose(total, 1.0 + (3 * T**2 - 3 * T**3 - 6 * T**2) / 6)
    assert total[-1] == pytest.approx(0.0, abs=1e-12)


def test_only_eq_5_of_the_b_spline_is_not_reproducible():
    findings = huang2024.b_spline(TRIAL)
    rest = {key: verdict for key, verdict in verdicts(findings).items() if verdict != "reproduced"}
    assert rest == {
        ("eq. 5", "the printed basis sums to 1"): "not reproducible as printed",
        ("eq. 5", "our correction of that basis sums to 1"): "present",
    }
    local = next(row for row in findings.rows if "control point" in row.claim)
    assert str(local.simulation).startswith("4 of 9")


def test_the_lens_accelerations_are_those_of_a_sine():
    found = {row.claim: float(str(row.simulation).split()[0]) for row in huang2024.table_1(TRIAL).rows}
    assert found["a lens that moves ±1 mm at 2 kHz"] == pytest.approx(1.6e4, rel=0.02)
    assert found["a lens that moves ±5 mm at 4 kHz"] == pytest.approx(3.2e5, rel=0.02)


def test_printed_dither_is_a_matrix_of_t_sine_and_cosine():
    t = np.linspace(0.0, 4 * np.pi, 50)
    matrix = np.array([[0, 0, 0.3], [0, 0.2, 0], [2, 0, 0]])
    expected = matrix @ np.array([t, np.sin(t), np.cos(t)])
    assert np.allclose(huang2024.printed_dither("elliptical", t, (0.3, 0.2, 0.0, 0.0)), expected)
    x, y, _ = huang2024.printed_dither("hat", t, (0.1, 0.02, 0.1, 0.02))
    assert np.allclose(x**2 + y**2, 0.1**2 + (0.02 * t) ** 2)  # a = c and b = d: a spiral


def test_the_radar_shows_shares_of_the_best_and_its_area():
    shares = huang2024.radar({"a": (1.0, 2.0, 4.0), "b": (2.0, 1.0, 8.0)})
    assert np.allclose(shares["a"], [0.5, 0.5, 1.0])
    assert np.allclose(shares["b"], [1.0, 1.0, 0.5])
    # Shoelace formula on the triangle's corners.
    angles = 2 * np.pi * np.arange(3) / 3
    x, y = shares["b"] * np.cos(angles), shares["b"] * np.sin(angles)
    shoelace = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert huang2024.area(shares)["b"] == pytest.approx(shoelace)


def test_eqs_10_and_11_and_the_factor_of_a_gaussian_are_not_reproducible():
    found = {key: verdict for key, verdict in verdicts(huang2024.equations(TRIAL)).items() if key[0] != "§2.1"}
    for (where, claim), verdict in found.items():
        holds = where == "eq. 9" or "even intensity" in claim
        assert verdict == ("reproduced" if holds else "not reproducible as printed"), claim


def test_the_unit_follows_the_contour_better_for_little_time():
    rows = {row.claim.split(" with")[0]: row for row in huang2024.adjusting_unit(TRIAL).rows}
    assert rows["RMS contour error"].simulation.high < 0.9
    assert rows["time of the job"].simulation.value < 1.03
    assert rows["time of the job"].verdict == "does not hold here"


def test_the_largest_feed_is_the_one_that_the_margin_allows():
    steel = materials.material("c45-10")
    feed = huang2024.fastest(steel.params, steel.power, spot.Command())
    below, above = (
        fit_cut.streamed(steel.params, steel.power, {"feed": s * feed, "dither": spot.Command()}).margin
        for s in (0.999, 1.001)
    )
    assert above < 1.0 < below


def test_what_is_said_of_dither_follows_from_the_jobs(monkeypatch):
    def verdicts_of(study):
        return {(row.claim, row.verdict) for row in study(TRIAL).rows}

    assert {verdict for _, verdict in verdicts_of(huang2024.absorption)} <= {"trend only", "does not hold here"}
    names = ("dross", "roughness", "taper")
    monkeypatch.setattr(huang2024, "jobs_of", lambda *a: {name: np.full(6, 1.0) for name in names})
    assert {verdict for _, verdict in verdicts_of(huang2024.shapes)} == {"does not hold here"}
    better = {name: np.full(6, 0.5) for name in names}
    worse = {name: np.full(6, 1.0) for name in names}
    monkeypatch.setattr(
        huang2024, "jobs_of", lambda stack, scenario, seeds, shape: better if shape == "elliptical" else worse
    )
    assert {v for claim, v in verdicts_of(huang2024.shapes) if "elliptical" in claim} == {"trend only"}
    assert {v for claim, v in verdicts_of(huang2024.shapes) if "elliptical" not in claim} == {"does not hold here"}
