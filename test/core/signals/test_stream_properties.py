"""Whatever is thrown at the stream: order of batteries, nonsense of every kind."""

import math
from typing import get_args

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.kinematics import MAX_ACCELERATION
from evpinn_ros.core.signals.readings import (
    MAX_SPEED,
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.signals.time_jump import Jump, StampGuard
from test.core.signals.conftest import (
    MeasuredSample,
    Newest,
    Smoothed,
    Stream,
    completed,
    in_order,
)

START = 1_700_000_000 * NANOSECONDS
COUNT = 150  # readings, 15 s


@given(
    st.lists(st.integers(0, 289_000_000), min_size=COUNT, max_size=COUNT),
    st.lists(st.floats(-200.0, 200.0), min_size=COUNT, max_size=COUNT),
    st.integers(0, 99),
)
@settings(max_examples=10, deadline=None)
@pytest.mark.slow
def test_batteries_that_come_up_to_the_allowed_lateness_late_change_nothing(
    delays, currents, phase
):
    """Each battery reading is held up on its way; the speeds come on time."""
    speeds = [SpeedReading(START + k * 100_000_000, 8 + math.sin(k / 5)) for k in range(COUNT)]
    first = START + phase * 1_000_000
    batteries = [
        BatteryReading(first + k * 100_000_000, 350.0, current)
        for k, current in enumerate(currents)
    ]

    def measured(held_up) -> list:
        arrivals = [(speed.stamp_ns, 0, speed) for speed in speeds]
        arrivals += [(b.stamp_ns + d, 1, b) for b, d in zip(batteries, held_up, strict=True)]
        stream = Stream()
        events = completed(stream, [r for *_, r in sorted(arrivals, key=lambda a: a[:2])])
        events += in_order(stream.flush())
        assert not stream.dropped
        kept = [event for event in events if isinstance(event, (MeasuredSample, Interval))]
        kept.sort(key=lambda event: (type(event).__name__, stamp_of(event)))
        return kept

    on_time = measured([0] * COUNT)
    assert len(on_time) > 50 and any(isinstance(event, Interval) for event in on_time)
    late = measured(delays)
    assert [*map(stamp_of, late)] == [*map(stamp_of, on_time)]
    for event, other in zip(late, on_time, strict=True):
        if isinstance(event, Interval):
            assert event.energy == pytest.approx(other.energy, rel=1e-9, nan_ok=True)
            assert event.returned == pytest.approx(other.returned, rel=1e-9, nan_ok=True)
            for column, same in zip(event.steps[:5], other.steps[:5], strict=True):
                np.testing.assert_allclose(column, same, rtol=1e-9, atol=1e-12)
        else:
            assert event.power == pytest.approx(other.power, rel=1e-9)


def stamp_of(event) -> int:
    """Begin of an interval, or moment of a sample."""
    return event.start_ns if isinstance(event, Interval) else event.sample.stamp_ns


numbers = st.one_of(
    st.floats(-120.0, 120.0),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, 1e-300, 1e300, 400.0, 2000.0]),
)
kinds = st.sampled_from(sorted({*get_args(Reading)} - {BatteryReading}, key=str))
# Mostly onwards by a step of any size, now and then anywhere at all.
onwards = st.one_of(
    st.integers(0, 300_000_000),
    st.sampled_from([0, 1, 2, 1000, 100_000_000, 100_000_000, 100_000_000]),
    st.integers(-3_000_000_000, 3_000_000_000),
)
anywhere = st.one_of(st.integers(-(2**63), 2**63), st.sampled_from([0, -1, 2**63 - 1, -(2**63)]))


@st.composite
def nonsense(draw):
    """Readings of all kinds with stamps that mostly move on."""
    stamp, readings = START, []
    for _ in range(draw(st.integers(1, 60))):
        stray = draw(st.integers(0, 30)) == 0
        moment = draw(anywhere) if stray else stamp + draw(onwards)
        stamp = stamp if stray else moment
        if draw(st.booleans()):
            readings.append(SpeedReading(moment, draw(numbers)))
        elif draw(st.booleans()):
            readings.append(BatteryReading(moment, draw(numbers), draw(numbers), draw(numbers)))
        else:
            readings.append(draw(kinds)(moment, draw(numbers)))
    return readings


@given(nonsense(), st.integers(0, 3))
@settings(max_examples=80, deadline=None)
@pytest.mark.slow
def test_nonsense_gives_finite_samples_in_order_and_no_exception(readings, lag):
    stream = Stream(smoothing_lag=0.1 * lag)
    last: dict[object, int] = {}
    for reading in readings:
        for event in completed(stream, [reading]):
            check(event)
            if (kind := type(event)) is not Interval:
                stamp_ns = (event if isinstance(event, Sample) else event.sample).stamp_ns
                assert stamp_ns > last.get(kind, -(2**64))
                last[kind] = stamp_ns


@given(nonsense())
@settings(max_examples=30, deadline=None)
@pytest.mark.slow
def test_after_any_nonsense_a_good_drive_is_taken(readings):
    """Four seconds of good speed and battery after anything, and samples of each kind come."""
    stream, guard = Stream(), StampGuard(SpeedReading)
    begin, kinds_seen = START + 500 * NANOSECONDS, set()
    good = [
        reading
        for stamp in range(begin, begin + 4 * NANOSECONDS, NANOSECONDS // 10)
        for reading in (SpeedReading(stamp, 5.0), BatteryReading(stamp, 350.0, -10.0))
    ]
    for k, reading in enumerate([*readings, *good]):
        for item in guard.follow(Block.of([reading])):
            if isinstance(item, Jump):
                stream.reset()
                continue
            for event in completed(stream, list(item.readings())):
                if k >= len(readings):
                    kinds_seen.add(type(event))
    assert {Newest, Smoothed, MeasuredSample} <= kinds_seen


def check(event) -> None:
    """Nothing that is not finite, nor beyond what can be."""
    if isinstance(event, Interval):
        assert all(np.isfinite(column).all() for column in event.steps[:5])
        assert (event.steps.duration > 0).all()  # a gap ends an interval early
        return
    if isinstance(event, MeasuredSample):
        assert math.isfinite(event.power)
    sample = event if isinstance(event, Sample) else event.sample
    assert abs(sample.speed) <= MAX_SPEED
    assert abs(sample.acceleration) <= MAX_ACCELERATION
    assert abs(sample.grade) <= 0.3 and 0.5 < sample.air_density < 2.0
    assert abs(sample.head_wind) <= 60.0
    assert 0.0 <= sample.known_auxiliary <= 50_000.0
