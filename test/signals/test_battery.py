from hypothesis import given
from hypothesis import strategies as st
import pytest

from evpinn_ros.signals.battery import TRACK_LENGTH, PowerTrack
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading

START = 1_700_000_000 * NANOSECONDS
MILLI = NANOSECONDS // 1000


def test_power_is_positive_when_drawn_from_the_battery():
    """`sensor_msgs/BatteryState`: a discharging current is negative. P = -V I."""
    assert BatteryReading(0, 350.0, -20.0).power == 7000.0
    assert BatteryReading(0, 350.0, 20.0).power == -7000.0


@given(
    st.lists(st.integers(1, 200), min_size=2, max_size=60),
    st.floats(-1e5, 1e5),
    st.floats(-1e5, 1e5),
    st.integers(0, 5000),
)
def test_interpolation_is_exact_on_linear_power(steps, level, slope, pick):
    track, stamp, stamps = PowerTrack(2.5), START, []
    for step in steps:
        stamp += step * MILLI
        stamps.append(stamp)
        track.add(stamp, level + slope * (stamp - START) / NANOSECONDS)
    moment = min(stamps[0] + pick * MILLI, stamps[-1])
    if moment < track.newest_ns - TRACK_LENGTH * NANOSECONDS:
        return
    expected = level + slope * (moment - START) / NANOSECONDS
    assert track.at(moment) == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_nothing_is_joined_across_a_gap_nor_beyond_the_ends():
    track = PowerTrack(2.5)
    for second, power in ((0.0, 1.0), (2.5, 2.0), (5.1, 3.0)):
        track.add(START + int(second * NANOSECONDS), power)

    def at(second: float) -> float | None:
        return track.at(START + int(second * NANOSECONDS))

    assert at(1.25) == 1.5
    assert at(3.0) is None  # 2.6 s lie between
    assert (at(2.5), at(5.1)) == (2.0, 3.0)
    assert at(-0.1) is None and at(5.2) is None
    assert track.next_ns(START + 1) == START + int(2.5 * NANOSECONDS)
    assert track.next_ns(START + 6 * NANOSECONDS) is None


def test_order_does_not_matter_and_the_first_of_a_stamp_counts():
    track = PowerTrack(2.5)
    assert track.newest_ns is None
    assert all(track.add(START + k * MILLI, float(k)) for k in (3, 1, 2))
    assert not track.add(START + 2 * MILLI, 99.0)
    assert track.newest_ns == START + 3 * MILLI
    assert [track.at(START + k * MILLI) for k in (1, 2, 3)] == [1.0, 2.0, 3.0]


def test_old_power_is_forgotten():
    track = PowerTrack(2.5)
    for second in range(60):
        track.add(START + second * NANOSECONDS, 1.0)
    assert track.at(START + 49 * NANOSECONDS) == 1.0
    assert track.at(START + 48 * NANOSECONDS) is None
