"""`evpinn bench speed` as a person meets it: real processes, real DDS."""

import pytest

pytestmark = pytest.mark.nightly


def test_a_replay_and_forecasts_in_the_library_and_over_dds(bench):
    printed, found = bench("speed", "--plans", "10", "--seconds", "60")
    assert min(found["replay"].values()) > 0 and "times real time" in printed
    assert "learned model, numpy" in printed and "p99" in printed
    assert min(found["library"].values()) > 0
    plans = found["plans"]
    assert plans["plans"] == 10 and plans["points"] == 600
    assert 0 < plans["p50_ms"] <= plans["p99_ms"] <= plans["largest_ms"]
