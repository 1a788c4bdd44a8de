"""Estimates against truth."""

import pytest

from benchmarks.unseen.truth import errors, truth_summary

TRUTH = {"mass_over_eta": 2000.0, "p_aux": 500.0}


def test_errors_have_their_sign_and_intervals_count_at_two_sigma():
    found = errors({"mass_over_eta": (2100.0, 50.0), "p_aux": (700.0, 101.0)}, TRUTH)
    assert found["mass_over_eta"].percent == pytest.approx(5.0)
    assert not found["mass_over_eta"].covered
    assert found["p_aux"].absolute == pytest.approx(200.0)
    assert not found["p_aux"].covered
    wider = errors({"mass_over_eta": (2100.0, 55.0), "p_aux": (700.0, 103.0)}, TRUTH)
    assert wider["mass_over_eta"].covered
    assert wider["p_aux"].covered


def test_a_summary_counts_drives_and_leaves_out_what_is_not_estimated():
    drives = [errors({"mass_over_eta": (value, 60.0)}, TRUTH) for value in (1900.0, 2100.0)]
    found = truth_summary(drives)
    assert list(found) == ["mass_over_eta"]
    assert found["mass_over_eta"]["drives"] == 2
    assert found["mass_over_eta"]["bias_percent"] == pytest.approx(0.0)
    assert found["mass_over_eta"]["median_percent"] == pytest.approx(5.0)
    assert found["mass_over_eta"]["covered_percent"] == 100.0
