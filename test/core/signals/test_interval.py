"""Intervals of driving, from readings: what telescopes, what is waited for and what is not."""

from dataclasses import replace
from itertools import pairwise
import math

import numpy as np
import pytest

from evpinn_ros.core.signals.height import REACH
from evpinn_ros.core.signals.interval import DURATION, WAIT_NS, Interval
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    GradeReading,
    MotorReading,
    SpeedReading,
)
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import SAMPLE_RATE, DriveKind
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, simulate

SLOPE = 0.03


def wave(t):
    return 12.0 + 6.0 * math.sin(t / 8.0)


@pytest.fixture
def journey(at):
    """Readings of speed at 10 Hz, battery and altitude, all at stamps of their own."""

    def readings(seconds, *, start=0.0, speed=wave, silent_from=math.inf, altitude_step=1.0):
        readings, way = [], 0.0
        for tick in range(round(start * 10), round((start + seconds) * 10)):
            t = tick / 10
            readings.append(SpeedReading(at(t), speed(t)))
            way += speed(t) / 10
            if t < silent_from:
                readings.append(BatteryReading(at(t + 0.03), 350.0, -10.0 - speed(t)))
            if altitude_step and tick % round(10 * altitude_step) == 0:
                readings.append(AltitudeReading(at(t + 0.06), 100.0 + SLOPE * way))
        return readings

    return readings


@pytest.fixture
def play():
    """The intervals that a drive gives while it goes on."""
    return lambda stream, readings: [interval for _, interval in stream.add(readings).intervals]


def settled(events) -> list[Interval]:
    """Intervals from where heights are averaged to both sides: `REACH` after the start."""
    intervals, way = [], 0.0
    for interval in events:
        if way > REACH:
            intervals.append(interval)
        way += interval.distance
    return intervals


def test_ups_and_downs_of_speed_are_as_large_as_they_are(new_stream, play, journey, at):
    """In traffic speed swings within seconds; a mean over half a second takes 1.6 % of that."""

    def traffic(t):
        return 12.0 + 2.0 * math.sin(2 * math.pi * t / 5.0)

    intervals = play(new_stream(), journey(100.0, speed=traffic))[3:-3]
    edges = np.array([(interval.start_ns, interval.end_ns) for interval in intervals])
    true = np.diff(np.vectorize(traffic)((edges - at(0)) / NANOSECONDS) ** 2 / 2)[:, 0]
    kinetic = np.array([interval.steps.kinetic.sum() for interval in intervals])
    assert kinetic @ true == pytest.approx(true @ true, rel=2e-3)


def test_a_drive_telescopes(new_stream, play, journey, at):
    """Distances, kinetic energy and climb of all intervals are those of the whole way."""
    intervals = settled(play(new_stream(), journey(120.0)))
    assert len(intervals) > 8
    assert all(a.end_ns == b.start_ns for a, b in pairwise(intervals))
    assert all(interval.duration == pytest.approx(DURATION) for interval in intervals)
    ends = intervals[0].start_ns, intervals[-1].end_ns
    begin, end = ((stamp_ns - at(0)) / NANOSECONDS for stamp_ns in ends)
    fine = np.linspace(begin, end, 100_001)
    speed = np.array([wave(t) for t in fine])
    way = float(np.trapezoid(speed, fine))
    assert sum(interval.distance for interval in intervals) == pytest.approx(way, rel=1e-3)
    total = {
        name: sum(float(getattr(interval.steps, name).sum()) for interval in intervals)
        for name in ("kinetic", "air", "climb", "duration")
    }
    assert total["duration"] == pytest.approx(end - begin)
    assert total["kinetic"] == pytest.approx((speed[-1] ** 2 - speed[0] ** 2) / 2, abs=0.2)
    assert total["air"] == pytest.approx(float(np.trapezoid(speed**3, fine)), rel=1e-3)
    assert all(interval.height_known for interval in intervals)
    assert total["climb"] == pytest.approx(SLOPE * way, rel=1e-2)
    energy = sum(interval.energy for interval in intervals)
    assert energy == pytest.approx(350.0 * (10.0 * (end - begin) + way), rel=1e-3)


@pytest.mark.parametrize(("altitude_step", "late"), [(0.1, 0.5), (1.0, 0.0), (2.0, 0.5)])
def test_a_slow_or_late_barometer_gives_heights_all_the_same(
    new_stream, play, journey, altitude_step, late
):
    readings = journey(120.0, altitude_step=altitude_step)
    delay = {AltitudeReading: round(late * NANOSECONDS)}
    arrivals = sorted(readings, key=lambda r: r.stamp_ns + delay.get(type(r), 0))
    intervals = settled(play(new_stream(), arrivals))
    assert intervals and all(interval.height_known for interval in intervals)
    # Over 6 s each: a barometer of 2 s puts some of a climb into the neighbour.
    groups = [intervals[k : k + 4] for k in range(0, len(intervals) - 3, 4)]
    slopes = [
        sum(interval.steps.climb.sum() for interval in group)
        / sum(interval.distance for interval in group)
        for group in groups
    ]
    assert slopes == pytest.approx([SLOPE] * len(groups), rel=0.05)


def test_an_altitude_that_never_moves_is_no_height(new_stream, play, journey):
    """A phone without a fix logs one altitude, 0 as a rule; the road is not flat for that."""
    drive = [
        replace(reading, altitude=0.0) if isinstance(reading, AltitudeReading) else reading
        for reading in journey(90.0)
    ]
    intervals = play(new_stream(), drive)
    assert intervals and not any(interval.height_known for interval in intervals)


def test_the_leap_to_a_first_fix_is_no_hill(new_stream, play, journey, at):
    """The last of `0, 0, 0, 103` adds nothing, and what follows is measured."""
    drive = [
        replace(reading, altitude=-1000.0)
        if isinstance(reading, AltitudeReading) and reading.stamp_ns < at(40)
        else reading
        for reading in journey(120.0)
    ]
    intervals = play(new_stream(), drive)
    steepest = max(abs(interval.steps.climb.sum()) / interval.distance for interval in intervals)
    assert steepest < 1.2 * SLOPE
    assert all(interval.height_known for interval in intervals if interval.start_ns > at(70))


def test_pitch_and_altitude_go_on_from_each_other_without_a_step(new_stream, play, journey, at):
    """The IMU falls silent in the middle; 100 m of altitude are no hill."""
    readings = journey(150.0)
    readings += [GradeReading(at(t / 10), math.atan(SLOPE)) for t in range(600)]
    intervals = play(new_stream(), sorted(readings, key=lambda r: r.stamp_ns))
    climbs = sum(interval.steps.climb.sum() for interval in intervals[1:])
    assert all(interval.height_known for interval in intervals[1:])
    # Ten seconds pass until the IMU counts as silent.
    way = sum(interval.distance for interval in intervals[1:])
    assert climbs == pytest.approx(SLOPE * way, rel=0.1)


def test_a_silent_battery_is_not_waited_for(new_stream, journey, at):
    """An interval without energy is given within seconds of its end, not after `WAIT_NS`."""
    stream, waits = new_stream(), []
    for reading in journey(100.0, silent_from=30.0, altitude_step=None):
        for known_ns, interval in stream.add([reading]).intervals:
            if math.isnan(interval.energy):
                waits.append((known_ns - interval.end_ns) / NANOSECONDS)
    assert len(waits) >= 8 and sorted(waits)[-2] < 5.0 < WAIT_NS / NANOSECONDS


def test_a_standing_car_waits_for_no_road(new_stream, journey):
    """Heights around it never come: after a minute it is given as it is."""
    stream, waits = new_stream(), []
    for reading in journey(150.0, speed=lambda t: 10.0 if t < 20.0 else 0.0):
        for known_ns, interval in stream.add([reading]).intervals:
            waits.append((known_ns - interval.end_ns) / NANOSECONDS)
    assert len(waits) >= 9 and max(waits) <= WAIT_NS / NANOSECONDS + 1.0


def test_a_gap_finishes_what_waits(new_stream, play, journey, at):
    stream = new_stream()
    before = play(stream, journey(58.0))
    events = play(stream, journey(60.0, start=75.0))
    finished = [interval for interval in events if interval.start_ns < at(75)]
    ended = before + finished
    assert finished and (ended[-1].end_ns - ended[0].start_ns) / NANOSECONDS == pytest.approx(
        57.5, abs=0.6
    )
    later = events[len(finished) :]
    assert min(interval.start_ns for interval in later) >= ended[-1].end_ns + 15 * NANOSECONDS


def test_a_drive_that_ended_has_its_intervals_once(new_stream, play, journey):
    stream = new_stream()
    play(stream, journey(58.0))
    assert [*stream.stream.finish()] and not [*stream.stream.finish()]


def test_a_motor_that_tells_is_counted_by_step(new_stream, play, journey, at):
    readings = journey(60.0, altitude_step=None)
    readings += [MotorReading(at(t / 10 + 0.02), 50.0, 300.0) for t in range(600)]
    intervals = play(new_stream(), sorted(readings, key=lambda r: r.stamp_ns))
    for interval in intervals[1:]:
        assert interval.steps.motor_drive.sum() == pytest.approx(15e3 * interval.duration)
        assert not interval.steps.motor_brake.any()
    without = play(new_stream(), journey(60.0, altitude_step=None))
    assert all(np.isnan(interval.steps.motor_drive).all() for interval in without)


def test_loads_are_means_and_wheels_that_slip_are_told(new_stream, play, journey, at):
    """Heating goes on at 25 s; at 35 s one speed is 10 m/s too high."""
    readings = journey(60.0, altitude_step=None)
    readings = [replace(r, speed=r.speed + 10.0) if r == readings[700] else r for r in readings]
    readings += [AuxiliaryReading(at(t - 0.01), 3e3 * (t > 25)) for t in range(60)]
    intervals = play(new_stream(), sorted(readings, key=lambda r: r.stamp_ns))
    heated = sum(interval.conditions.load * interval.duration for interval in intervals)
    assert heated == pytest.approx(3e3 * ((intervals[-1].end_ns - at(0)) / 1e9 - 25.0), rel=0.05)
    (leapt,) = (interval for interval in intervals if interval.leaps)
    assert leapt.start_ns < at(35) < leapt.end_ns


def test_slow_signals_make_longer_intervals(new_stream, play):
    """Speed, voltage and current polled every 1.2 s, each at a time of its own."""
    drive = simulate(DriveKind.URBAN, load_vehicle("tesla_model_3_lr"), 150.0, 2)
    stream = new_stream()
    intervals = play(stream, polled(drive.readings))
    assert all(interval.duration >= 6 * 1.1 for interval in intervals[3:])
    assert not any(math.isnan(interval.energy) for interval in intervals[3:])
    time = EPOCH_NS + drive.trace.motion.time * NANOSECONDS
    drawn = np.concatenate(([0.0], np.cumsum(drive.trace.power) / SAMPLE_RATE))[:-1]
    measured = [interval for interval in intervals if not math.isnan(interval.energy)]
    deviates = []
    for interval in measured:
        (true,) = np.diff(np.interp((interval.start_ns, interval.end_ns), time, drawn))
        deviates.append((interval.energy - true) / math.sqrt(interval.sampling_variance))
    assert 0.3 < np.sqrt(np.mean(np.square(deviates))) < 1.5
    assert not stream.dropped


def polled(readings):
    """One signal in turn, each 0.4 s, the others dropped."""
    last, turn = 0, 0
    for reading in readings:
        battery = isinstance(reading, BatteryReading)
        if reading.stamp_ns - last < 0.4 * NANOSECONDS or battery != (turn % 3 > 0):
            continue
        last, turn = reading.stamp_ns, turn + 1
        part = {1: "current", 2: "voltage"}.get((turn - 1) % 3)
        yield replace(reading, **{part: math.nan}) if part else reading
