"""Readings of one quantity: order, rate, what is joined and what is not."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.track import GAP_STEPS, LATER, RATE_READINGS, TRACK_NS, SignalTrack
from test.core.signals.conftest import START, now
from test.core.signals.conftest import stamp_at as at

MILLI = NANOSECONDS // 1000


def value(signal: SignalTrack, moment: int) -> float:
    """The value at a moment, by all that came."""
    return float(signal.at(now(moment))[0])


def track(*readings, max_gap=2.5) -> SignalTrack:
    """A track of (s, value)."""
    signal = SignalTrack(max_gap)
    for second, level in readings:
        add(signal, second, level)
    return signal


def add(signal: SignalTrack, second: float, level: float) -> None:
    """Take one reading."""
    signal.extend(np.array([at(second)]), np.array([level]))


@given(
    st.lists(st.integers(1, 200), min_size=2, max_size=60),
    st.floats(-1e5, 1e5),
    st.floats(-1e5, 1e5),
    st.integers(0, 5000),
)
def test_interpolation_is_exact_on_what_is_linear(steps, level, slope, pick):
    signal, stamp, stamps = SignalTrack(2.5), START, []
    for step in steps:
        stamp += step * MILLI
        stamps.append(stamp)
        level_then = level + slope * (stamp - START) / NANOSECONDS
        signal.extend(np.array([stamp]), np.array([level_then]))
    moment = min(stamps[0] + pick * MILLI, stamps[-1])
    expected = level + slope * (moment - START) / NANOSECONDS
    assert value(signal, moment) == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_nothing_is_joined_across_a_gap_nor_beyond_the_ends():
    signal = track((0.0, 1.0), (0.1, 1.0), (0.2, 1.0), (0.3, 3.0), (2.8, 5.0), (5.4, 7.0))
    assert value(signal, at(1.55)) == 4.0
    assert math.isnan(value(signal, at(3.0)))  # 2.6 s lie between
    assert (value(signal, at(2.8)), value(signal, at(5.4))) == (5.0, 7.0)
    assert math.isnan(value(signal, at(-0.1))) and math.isnan(value(signal, at(5.5)))
    after = signal.first_after(np.array([at(0.3) + 1, at(6.0)]))
    assert after.tolist() == [at(2.8), LATER]
    assert (
        signal.covered(np.array([at(0.1), at(2.8)]))[0]
        and not signal.covered(np.array([at(0.1), at(3.0)]))[0]
    )
    assert (
        not signal.covered(np.array([at(-1.0), at(0.1)]))[0]
        and not signal.covered(np.array([at(5.0), at(6.0)]))[0]
    )
    assert signal.within(at(0.1), at(2.8)).tolist() == [at(0.2), at(0.3)]


def test_a_slow_signal_is_joined_across_some_of_its_own_steps():
    signal = track(*((5.0 * k, float(k)) for k in range(10)))
    assert value(signal, at(22.5)) == 4.5
    add(signal, 45.0 + 5.0 * GAP_STEPS, 0.0)
    assert not math.isnan(value(signal, at(50.0)))
    add(signal, 51.0 + 10.0 * GAP_STEPS, 1.0)
    assert math.isnan(value(signal, at(48.0 + 10.0 * GAP_STEPS)))


def test_what_no_moment_rests_on_is_forgotten():
    signal = SignalTrack(2.5)
    stamps = at(0.0) + NANOSECONDS // 10 * np.arange(5000)
    signal.extend(stamps, np.ones(5000))
    signal.forget_before(LATER)
    kept = (signal.stamps[-1] - signal.stamps[0]) / NANOSECONDS
    assert TRACK_NS / NANOSECONDS <= kept <= TRACK_NS / NANOSECONDS + RATE_READINGS
    assert len(signal.stamps) == len(signal.values)


@given(st.lists(st.integers(1, 9000), min_size=3, max_size=60), st.integers(0, 60))
def test_what_comes_later_changes_no_moment_before(steps, come):
    """Cut at any reading, a track says of moments up to it what the whole says."""
    stamps = at(0.0) + MILLI * np.cumsum(steps)
    values = np.sin(np.arange(len(steps)))
    come = min(max(come, 1), len(steps))
    whole, part = SignalTrack(2.5), SignalTrack(2.5)
    whole.extend(stamps, values)
    part.extend(stamps[:come], values[:come])
    moments = np.sort(np.concatenate((stamps[:come], stamps[:come] - 7 * MILLI)))
    for question in (SignalTrack.at, SignalTrack.last, SignalTrack.covered, SignalTrack.gap_ns):
        np.testing.assert_array_equal(question(whole, moments), question(part, moments))
    assert whole.step_around(int(stamps[come - 1])) == part.step_around(int(stamps[come - 1]))
    following = SignalTrack(2.5)
    for first, last in ((0, come), (come, len(steps))):
        following.extend(stamps[first:last], values[first:last])
    np.testing.assert_array_equal(following.gaps, whole.gaps)
