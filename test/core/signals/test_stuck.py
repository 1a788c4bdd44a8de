"""A sensor that hangs at one value, told from a car that does."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.detector import BATTERY_STUCK, SPEED_REPEATS, SPEED_STUCK
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.signals.stuck import StuckDetector


def driven(seconds, speed, current, detector=None, begin=0.0) -> StuckDetector:
    """The detector after a drive at 10 Hz: functions of time give m/s and A at 350 V."""
    detector = detector or StuckDetector()
    for step in range(round(10 * seconds)):
        now = begin + step / 10
        stamp_ns = round(now * NANOSECONDS)
        detector.follow(Block.of([BatteryReading(stamp_ns, 350.0, current(now))]))
        detector.follow(Block.of([SpeedReading(stamp_ns, speed(now))]))
    return detector


def judge(seconds, speed, current):
    """The verdict after such a drive."""
    return driven(seconds, speed, current).verdict.detected


def waves(mean, size):
    return lambda t: mean + size * math.sin(t / 3)


def test_a_current_that_is_zero_all_the_time_whatever_the_voltage():
    detector = StuckDetector()
    for step in range(200):
        stamp_ns, now = step * NANOSECONDS // 10, step / 10
        detector.follow(Block.of([BatteryReading(stamp_ns, 350.0 - now % 3, 0.0)]))
        detector.follow(Block.of([SpeedReading(stamp_ns, waves(15, 8)(now))]))
    assert detector.verdict.detected == BATTERY_STUCK


def test_a_value_that_moves_again_clears_the_verdict():
    hung = driven(20, lambda _: 15.0, waves(-50, 120))
    assert hung.verdict.detected == SPEED_STUCK
    assert driven(1, waves(15, 8), waves(-50, 120), hung, begin=20.0).verdict.detected is None


def _coarse_until_it_hangs(t):
    return round(min(t, 15.0)) / 3.6


@pytest.mark.parametrize(
    ("seconds", "speed", "current", "verdict"),
    [
        (60, waves(15, 8), waves(-50, 120), None),
        (20, waves(15, 8), lambda _: -40.0, BATTERY_STUCK),
        (20, waves(15, 8), lambda _: -2.0, BATTERY_STUCK),  # also at next to nothing
        (20, lambda _: 15.0, waves(-50, 120), SPEED_STUCK),
        (30, _coarse_until_it_hangs, waves(-50, 120), SPEED_STUCK),
        (25, lambda _: 0.0, lambda _: -3.0, None),  # parked
        (25, lambda _: 0.0, waves(-50, 100), None),  # charging, heating
        (25, lambda _: 30.0, waves(-60, 20), None),  # cruise control in wind, speed in whole km/h
        (600, lambda _: 30.0, lambda t: -60 + 60 * math.sin(t / 60), None),  # and over hills
        (25, lambda t: 15.0 - t / 10, lambda _: -3.0, None),  # coasting, current in whole A
        (25, lambda t: max(0.0, 15.0 - 3 * t), lambda _: -2.0, None),  # a full battery brakes
    ],
)
def test_what_hangs_is_told_from_a_car_that_does_one_thing(seconds, speed, current, verdict):
    assert judge(seconds, speed, current) == verdict


def test_a_speed_in_whole_kilometres_per_hour_repeats_by_itself():
    """As OBD tells it, on a motorway; the same hang is told where speeds are finer."""

    def held(step):
        def speed(t):
            return 27.0 if 12 <= t < 15 else 28.0 + step * math.floor(t)

        return judge(14.9, speed, lambda t: -20 - 60 * math.cos(2 * t))

    assert held(1 / 3.6) is None
    assert held(0.05) == SPEED_STUCK


@pytest.mark.parametrize(
    ("unit", "period", "wave"), [(1 / 3.6, 1.0, 11.0), (0.44704, 1.0, 11.0), (0.44704, 5.2, 40.0)]
)
def test_a_cruise_in_whole_numbers_on_a_hilly_road_spoils_nothing(unit, period, wave):
    """The norm of OBD: a value repeats for some readings while power swings by 40 kW."""
    detector = StuckDetector()
    for step in range(round(900 / period)):
        now = step * period
        speed = 30.0 + 4.0 * math.sin(now / wave)
        stamp_ns = round(now * NANOSECONDS)
        current = -70.0 - 60.0 * math.sin(now / 2.5)
        detector.follow(Block.of([BatteryReading(stamp_ns, 350.0, current)]))
        detector.follow(Block.of([SpeedReading(stamp_ns, round(speed / unit) * unit)]))
        assert not detector.verdict.spoilt


def _held_after_braking(t):
    """Exactly 13 m/s after a strong deceleration, as a simulator's driver or a cruise control."""
    return max(13.0, 30.0 - 4.0 * max(0.0, t - 5.0)) if t < 40.0 else 13.0 - 2.0 * (t - 40.0)


def _rounded_peaks(t):
    """Speeding up and slowing down in steps of 0.02 m/s: each turn repeats some values."""
    return round((12.0 + 3.0 * math.sin(t / 2.0)) / 0.02) * 0.02


@pytest.mark.parametrize("speed", [_held_after_braking, _rounded_peaks])
def test_a_speed_that_goes_on_as_it_was_did_not_hang(speed):
    """Nine in ten intervals of the Changchun sedan were left out, and all braking of SUMO's."""
    detector = StuckDetector()

    def current(t):
        return -10.0 - 4.0 * speed(t) * (speed(t) - speed(t - 0.1)) / 0.1

    for second in range(44):
        detector = driven(1.0, speed, current, detector, begin=float(second))
        assert detector.verdict.why_not(0, second * NANOSECONDS) is None


def test_what_lies_behind_is_spoilt_from_before_the_value_hung_until_it_moved():
    """Half a second on both sides; long before it is suspected, and once it is no longer."""
    detector = driven(10, waves(15, 8), waves(-50, 20))
    detector = driven(1.5, lambda _: 15.0, waves(-50, 20), detector, begin=10.0)
    assert detector.verdict.detected is None
    detector = driven(5, waves(15, 8), waves(-50, 20), detector, begin=11.5)

    def why_not(*span):
        return detector.verdict.why_not(*(round(seconds * NANOSECONDS) for seconds in span))

    assert why_not(9.6, 9.6) == why_not(10.5, 10.5) == why_not(11.8, 11.8) == SPEED_REPEATS
    assert why_not(8.0, 9.6) == why_not(11.8, 13.0) == why_not(9.0, 12.0) == SPEED_REPEATS
    assert why_not(0.0, 9.4) is why_not(12.0, 14.0) is None


@given(st.lists(st.tuples(st.integers(0, 10**11), st.floats(), st.floats(), st.booleans())))
def test_any_readings_are_survived(items):
    detector = StuckDetector()
    for stamp_ns, first, second, battery in items:
        reading = BatteryReading(stamp_ns, first, second) if battery else None
        detector.follow(Block.of([reading or SpeedReading(stamp_ns, first)]))
    assert detector.verdict.detected in (None, SPEED_STUCK, BATTERY_STUCK)


@given(st.integers(0, 10_000), st.integers(1, 80), st.sampled_from([0.0, 0.2, 1.0]))
def test_a_block_is_judged_as_its_readings_one_by_one(seed, size, coarse):
    """Of random drives with values that hang, whatever the cuts."""
    rng, readings = np.random.default_rng(seed), []
    hung = rng.integers(0, 300, 2)
    for tick in range(300):
        stamp_ns = round(tick * 1e8 + rng.uniform(0.0, 3e7))
        speed = 12.0 + 8.0 * math.sin(tick / 20.0) + rng.normal(0.0, 0.02)
        current = -50.0 - 120.0 * math.cos(tick / 20.0)
        if coarse:
            speed = coarse * round(speed / coarse)
        if hung[0] < tick < hung[0] + 60:
            speed = 9.0
        if hung[1] < tick < hung[1] + 60:
            current = -30.0 if seed % 2 else 0.0
        readings.append(BatteryReading(stamp_ns, 350.0, current))
        readings.append(SpeedReading(stamp_ns + 1, speed))
    alone, detector, first = StuckDetector(), StuckDetector(), 0
    expected = [alone.verdict]
    for reading in readings:
        alone.follow(Block.of([reading]))
        expected.append(alone.verdict)
    while first < len(readings):
        part = readings[first : first + size]
        course = detector.follow(Block.of(part))
        for place, reading in enumerate(part, first + 1):
            assert course.at(reading.stamp_ns) == expected[place]
        first += len(part)
    assert detector.verdict == alone.verdict
