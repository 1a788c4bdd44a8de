"""Captures of real cars against formula, table and live bus; skipped where they are not."""

from pathlib import Path

import pytest

from benchmarks.can_decoding import CAPTURES, compare, equal_live, measure_throughput
from benchmarks.can_traffic import open_bus, own_port
from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.nightly

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "can"
needs_captures = pytest.mark.skipif(not DATA.is_dir(), reason="no captures beside the checkout")


@needs_captures
@pytest.mark.parametrize("capture", CAPTURES, ids=lambda each: Path(each.log).name)
def test_every_frame_and_every_row_of_a_capture_is_equal(capture):
    found = compare(capture, DATA)
    assert found.battery_equal == found.battery_frames > 1000
    assert found.rows_equal == found.rows > 300
    if capture.motor_speed:
        assert abs(found.wheel_speed - 1) < 0.02
        assert found.wheel_speed_within_2_percent > 0.97  # the rest is wheel slip at full throttle


@needs_captures
def test_a_capture_reads_the_same_over_a_bus():
    try:
        with open_bus(own_port()):
            pass
    except InputError as error:
        pytest.skip(str(error))
    shortest = min(CAPTURES, key=lambda each: (DATA / each.log).stat().st_size)
    assert equal_live(shortest, DATA)


def test_throughput_counts_what_was_decoded():
    ticks = iter([0.0, 1.0, 10.0, 12.0, 20.0, 24.0])
    found = measure_throughput(clock=lambda: next(ticks))
    assert found.frames == 200_000
    assert found.decoding == 200_000 and found.whole_file == 50_000
    assert found.decoding_known == 160 * 50 / 2
