"""Whatever is thrown at the stream: order of batteries, nonsense of every kind."""

import math
from typing import get_args

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.signals.interval import DURATION, Interval
from evpinn_ros.signals.kinematics import MAX_ACCELERATION
from evpinn_ros.signals.ranges import MAX_SPEED
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.signals.sample import Gap, MeasuredSample, NewestSample, SmoothedSample
from evpinn_ros.signals.stream import SampleStream, StreamSettings
from evpinn_ros.signals.time_jump import Jump, StampGuard

START = 1_700_000_000 * NANOSECONDS
COUNT = 250  # readings, 25 s


@given(
    st.lists(st.integers(0, 289_000_000), min_size=COUNT, max_size=COUNT),
    st.lists(st.floats(-200.0, 200.0), min_size=COUNT, max_size=COUNT),
    st.integers(0, 99),
)
@settings(max_examples=30, deadline=None)
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
        stream = SampleStream(StreamSettings(), 1.2)
        events = [
            e
            for *_, reading in sorted(arrivals, key=lambda a: a[:2])
            for e in stream.add_reading(reading)
        ]
        assert not stream.dropped
        kept = [event for event in events if isinstance(event, (MeasuredSample, Interval))]
        return [repr(event) for event in kept]

    in_order = measured([0] * COUNT)
    assert len(in_order) > 85 and any("Interval(" in event for event in in_order)
    assert sorted(measured(delays)) == sorted(in_order)


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
@settings(max_examples=120, deadline=None)
@pytest.mark.slow
def test_nonsense_makes_no_exception_and_nothing_that_is_not_finite(readings, smoothed_after):
    stream = SampleStream(StreamSettings(smoothing_lag=0.1 * smoothed_after), 1.2)
    for reading in readings:
        for event in stream.add_reading(reading):
            if isinstance(event, Gap):
                continue
            if isinstance(event, Interval):
                assert all(np.isfinite(column).all() for column in event.steps[:5])
                assert event.duration >= 0.9 * DURATION and (event.steps.duration > 0).all()
                continue
            sample = event.sample
            assert abs(sample.speed) <= MAX_SPEED
            assert abs(sample.acceleration) <= MAX_ACCELERATION
            assert abs(sample.grade) <= 0.3 and 0.5 < sample.air_density < 2.0
            assert abs(sample.head_wind) <= 60.0
            assert 0.0 <= sample.known_auxiliary <= 50_000.0
            if isinstance(event, MeasuredSample):
                assert math.isfinite(event.power)


@given(nonsense())
@settings(max_examples=50, deadline=None)
def test_samples_of_a_kind_are_in_order(readings):
    stream = SampleStream(StreamSettings(), 1.2)
    last: dict[type, int] = {}
    for reading in readings:
        for event in stream.add_reading(reading):
            if isinstance(event, (NewestSample, SmoothedSample, MeasuredSample)):
                kind = type(event)
                assert event.sample.stamp_ns > last.get(kind, -(2**64))
                last[kind] = event.sample.stamp_ns


@given(nonsense())
@settings(max_examples=50, deadline=None)
@pytest.mark.slow
def test_after_any_nonsense_a_good_drive_is_heard(readings):
    """Four seconds of good speed and battery after anything, and samples come."""
    stream, guard = SampleStream(StreamSettings(), 1.2), StampGuard(SpeedReading)

    def feed(reading):
        for item in guard.follow(reading):
            if isinstance(item, Jump):
                stream.reset()
            else:
                yield from stream.add_reading(item)

    for reading in readings:
        for _ in feed(reading):
            pass
    begin = START + 500 * NANOSECONDS
    kinds_seen = set()
    for tick in range(40):
        stamp = begin + tick * 100_000_000
        for reading in (SpeedReading(stamp, 5.0), BatteryReading(stamp, 350.0, -10.0)):
            kinds_seen |= {type(event) for event in feed(reading)}
    assert {NewestSample, SmoothedSample, MeasuredSample} <= kinds_seen
