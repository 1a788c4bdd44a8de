"""Scores side by side, and their totals worked out by hand."""

import math
import time

import pytest

from benchmarks.online import OnlineBenchmark
from benchmarks.scores import log_scores, total_scores


def score(samples, rmse, measured, predicted, coverage=None):
    part = {"samples": samples, "rmse_w": rmse, "mae_w": rmse, "coverage_90": coverage}
    return {
        **part,
        "energy_error_percent": 100 * (predicted - measured) / abs(measured),
        "worst_5min_percent": None if measured == 1e3 else 3.0,
        "measured_j": measured,
        "predicted_j": predicted,
        "now": dict(part),
        "us_per_sample": 10.0,
    }


def test_totals_are_weighted_by_samples():
    logs = [{"ekf5": score(100, 10.0, 1e3, 1.1e3, 0.8)}, {"ekf5": score(300, 30.0, 2e3, 1.9e3)}]
    total = total_scores(logs)["ekf5"]
    assert total["samples"] == 400
    assert total["rmse_w"] == pytest.approx(math.sqrt((100 * 10**2 + 300 * 30**2) / 400))
    assert total["mae_w"] == pytest.approx(25.0)
    assert total["now"]["rmse_w"] == total["rmse_w"]
    assert total["coverage_90"] == pytest.approx(0.8)  # of the log that has one
    assert total["worst_5min_percent"] == 3.0  # of the log that is long enough
    # +100 J and -100 J of 3000 J do not cancel.
    assert total["energy_error_percent"] == pytest.approx(100 * 200 / 3000)


def test_a_method_of_one_log_is_totalled_over_it_alone():
    logs = [{"prior": score(100, 10.0, 1.0, 1.0)}, {"table5_printed": score(50, 5.0, 1.0, 1.0)}]
    total = total_scores(logs)
    assert (total["prior"]["samples"], total["table5_printed"]["rmse_w"]) == (100, 5.0)


def test_what_no_log_could_score_stays_unknown():
    unknown = score(0, None, 1.0, 1.0)
    unknown["measured_j"] = unknown["energy_error_percent"] = None
    total = total_scores([{"prior": unknown}])["prior"]
    assert total["rmse_w"] is total["energy_error_percent"] is total["coverage_90"] is None
    assert total_scores([]) == {}


def test_only_a_method_with_a_sigma_has_a_coverage(vehicle, readings):
    names = ["null", "split", "rls5", "ekf5"]
    benchmark = OnlineBenchmark(vehicle, names, time.thread_time)
    for reading in readings:
        benchmark.add_reading(reading)
    found = log_scores(benchmark.finish(), names, 5.0)
    assert list(found) == names
    assert [found[name]["coverage_90"] is None for name in names] == [True, True, True, False]
    assert found["split"]["rmse_w"] > 0 and found["split"]["mae_w"] is None
    # 15 s after the warm-up, less the lag of the smoother.
    assert 140 <= found["ekf5"]["samples"] <= 150 <= found["ekf5"]["now"]["samples"] + 1
