"""Readings of one quantity: order, rate, what is joined and what is not."""

import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.track import GAP_STEPS, TRACK_LENGTH, SignalTrack
from test.core.signals.conftest import START
from test.core.signals.conftest import stamp_at as at

MILLI = NANOSECONDS // 1000


def track(*readings, max_gap=2.5) -> SignalTrack:
    """A track of (s, value)."""
    found = SignalTrack(max_gap)
    for second, value in readings:
        found.add(at(second), value)
    return found


@given(
    st.lists(st.integers(1, 200), min_size=2, max_size=60),
    st.floats(-1e5, 1e5),
    st.floats(-1e5, 1e5),
    st.integers(0, 5000),
)
def test_interpolation_is_exact_on_what_is_linear(steps, level, slope, pick):
    found, stamp, stamps = SignalTrack(2.5), START, []
    for step in steps:
        stamp += step * MILLI
        stamps.append(stamp)
        found.add(stamp, level + slope * (stamp - START) / NANOSECONDS)
    moment = min(stamps[0] + pick * MILLI, stamps[-1])
    expected = level + slope * (moment - START) / NANOSECONDS
    assert found.at(moment) == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_nothing_is_joined_across_a_gap_nor_beyond_the_ends():
    found = track((0.0, 1.0), (0.1, 1.0), (0.2, 1.0), (0.3, 3.0), (2.8, 5.0), (5.4, 7.0))
    assert found.at(at(1.55)) == 4.0
    assert math.isnan(found.at(at(3.0)))  # 2.6 s lie between
    assert (found.at(at(2.8)), found.at(at(5.4))) == (5.0, 7.0)
    assert math.isnan(found.at(at(-0.1))) and math.isnan(found.at(at(5.5)))
    assert (found.next_ns(at(0.3) + 1), found.next_ns(at(6.0))) == (at(2.8), None)
    assert found.covers(at(0.1), at(2.8)) and not found.covers(at(0.1), at(3.0))
    assert not found.covers(at(-1.0), at(0.1)) and not found.covers(at(5.0), at(6.0))
    assert found.within(at(0.1), at(2.8)) == [at(0.2), at(0.3)]


def test_a_slow_signal_is_joined_across_some_of_its_own_steps():
    found = track(*((5.0 * k, float(k)) for k in range(10)))
    assert found.at(at(22.5)) == 4.5
    found.add(at(45.0 + 5.0 * GAP_STEPS), 0.0)
    assert not math.isnan(found.at(at(50.0)))
    found.add(at(51.0 + 10.0 * GAP_STEPS), 1.0)
    assert math.isnan(found.at(at(48.0 + 10.0 * GAP_STEPS)))


@given(st.permutations(range(12)))
def test_order_does_not_matter_and_the_first_of_a_stamp_counts(order):
    found = track(*((0.1 * k, float(k)) for k in order))
    assert found.values == [float(k) for k in range(12)]
    assert not found.add(at(0.2), 99.0) and found.at(at(0.2)) == 2.0


def test_what_is_old_is_forgotten_sooner_or_later():
    found = track(*((0.1 * k, 1.0) for k in range(5000)))
    kept = (found.stamps[-1] - found.stamps[0]) / NANOSECONDS
    assert TRACK_LENGTH <= kept <= 2 * TRACK_LENGTH + 1
    assert len(found.stamps) == len(found.values)
