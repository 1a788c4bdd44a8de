"""Frames of the full bus, counted as they are decoded."""

import pytest

from benchmarks.can_decoding import measure_throughput

pytestmark = pytest.mark.nightly


def test_throughput_counts_what_was_decoded():
    ticks = iter([0.0, 1.0, 10.0, 12.0, 20.0, 24.0])
    found = measure_throughput(clock=lambda: next(ticks))
    assert found.frames == 200_000
    assert found.decoding == 200_000 and found.whole_file == 50_000
    assert found.decoding_known == 160 * 50 / 2
