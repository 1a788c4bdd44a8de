import math

import numpy as np
import pytest

from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.kinematics import LAG_TOLERANCE_NS
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AuxiliaryReading,
    BatteryReading,
    SpeedReading,
)
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.signals.stream import SAMPLE_PERIOD
from test.core.signals.conftest import MeasuredSample, Newest, Smoothed, completed

LAG = 0.3


def of(events, kind) -> list:
    return [event for event in events if isinstance(event, kind)]


def newest(events) -> list[Newest]:
    return of(events, Newest)


def smoothed(events) -> list[Smoothed]:
    return of(events, Smoothed)


def numbers(sample: Sample) -> list[float]:
    """All of a sample."""
    return [float(number) for column in sample for number in np.atleast_1d(column)]


def approx(expected: list[float]):
    """The same but for how sums are rounded."""
    return pytest.approx(expected, rel=1e-9, abs=1e-12, nan_ok=True)


def stamp_of(sample: Sample) -> int:
    return sample.stamp_ns


def stamps(samples) -> list[int]:
    return [sample.stamp_ns for sample in samples]


@pytest.fixture
def ramp(at):
    """Speeds of a constant acceleration at a rate, from and to these seconds."""

    def readings(rate, begin, end, start=5.0, acceleration=0.5):
        times = begin + np.arange(round((end - begin) * rate) + 1) / rate
        return [SpeedReading(at(t), start + acceleration * (t - begin)) for t in times.tolist()]

    return readings


@pytest.fixture
def battery(at):
    """Battery readings at these seconds whose power is linear in time: 100 W/s from 0."""

    def readings(*times):
        return [BatteryReading(at(t), 100.0, -t) for t in times]

    return readings


@pytest.mark.parametrize("rate", [1.0, 4.0, 10.0, 12.5, 50.0, 100.0])
def test_every_speed_gives_a_newest_sample_and_smoothed_ones_follow(
    new_stream, play, ramp, at, rate
):
    readings = ramp(rate, 0.0, 8.0)
    events = play(new_stream(), readings)
    assert sorted(stamps(newest(events))) == [reading.stamp_ns for reading in readings]
    samples = smoothed(events)
    assert len(samples) >= min(rate, 6.0) * (8.0 - 0.5) - 4
    for event in samples:
        seconds = (event.stamp_ns - at(0)) / NANOSECONDS
        assert event.speed == pytest.approx(5.0 + 0.5 * seconds, rel=1e-6)
        assert event.acceleration == pytest.approx(0.5, rel=1e-5)
    # Every so manyth moment, the fewest that are `SAMPLE_PERIOD` less the tolerance apart.
    every = math.ceil((SAMPLE_PERIOD - LAG_TOLERANCE_NS / NANOSECONDS) * rate - 1e-6)
    steps = np.diff(stamps(smoothed(events))) / NANOSECONDS
    np.testing.assert_allclose(steps, every / rate, atol=1e-8)


@pytest.mark.parametrize("rate", [1.0, 4.0, 10.0, 12.5, 50.0, 100.0])
def test_a_smoothed_sample_is_completed_by_the_first_speed_a_lag_later(new_stream, ramp, rate):
    readings = ramp(rate, 0.0, 8.0)
    speeds = np.array(stamps(readings))
    events = new_stream().add(readings)
    assert events.smoothed.size
    needed = events.smoothed.stamp_ns + int(LAG * NANOSECONDS) - LAG_TOLERANCE_NS
    assert events.smoothed_ns.tolist() == speeds[speeds.searchsorted(needed)].tolist()


def test_a_live_stream_hands_on_some_blocks_a_second(new_stream, ramp):
    """At 100 Hz each block holds a fifth of a second, and nothing is left behind."""
    stream, sizes = new_stream(), []
    for reading in ramp(100.0, 0.0, 8.0):
        sizes.append(stream.add([reading]).smoothed.size)
    assert sum(size > 0 for size in sizes) <= 5 * 8
    assert max(sizes) <= 3
    assert sum(sizes) >= 10 * (8.0 - 1.0)


@pytest.mark.parametrize("rate", [10.0, 20.0, 50.0, 100.0])
def test_a_smoothed_sample_uses_no_speed_beyond_its_lag(new_stream, play, ramp, rate):
    readings = ramp(rate, 0.0, 4.0)
    readings = [SpeedReading(r.stamp_ns, 8 + math.sin(k)) for k, r in enumerate(readings)]
    reference = smoothed(play(new_stream(), readings))
    for event in reference[10::13]:
        beyond = event.stamp_ns + int(LAG * NANOSECONDS) + LAG_TOLERANCE_NS
        changed = [SpeedReading(r.stamp_ns, 0.0) if r.stamp_ns > beyond else r for r in readings]
        again = {sample.stamp_ns: sample for sample in smoothed(play(new_stream(), changed))}
        assert numbers(again[event.stamp_ns]) == approx(numbers(event))


def test_the_newest_acceleration_rests_on_the_past(new_stream, play, ramp):
    events = newest(play(new_stream(), ramp(10.0, 0.0, 5.0)))
    assert events[0].acceleration == 0.0  # one speed tells none
    # Before it has learned: the mean slope of the last 0.4 s, of which 0.1, 0.2... are known.
    first = [e.acceleration for e in events[1:4]]
    assert first == pytest.approx([0.5 / 4, 2 * 0.5 / 4, 3 * 0.5 / 4])
    assert events[-1].acceleration == pytest.approx(0.5, rel=0.01)


def test_the_newest_power_rests_on_what_was_known_before_its_speed(new_stream, ramp, at):
    """Up to the watermark: half a second back at most at 10 Hz."""
    newest_speeds = new_stream().add(ramp(10.0, 0.0, 5.0)).newest
    age = (newest_speeds.samples.stamp_ns - newest_speeds.known_ns)[5:] / NANOSECONDS
    assert age.min() >= 0.3 and age.max() < 0.7


def test_measured_samples_interpolate_power(new_stream, play, ramp, battery, at):
    """Battery at 4 Hz and off the beat; the power is linear, so interpolation is exact."""
    times = 0.07 + np.arange(24) / 4
    readings = sorted(
        [*ramp(10.0, 0.0, 6.0), *battery(*times.tolist())], key=lambda reading: reading.stamp_ns
    )
    samples = of(play(new_stream(), readings), MeasuredSample)
    assert len(samples) > 45
    for event in samples:
        seconds = (event.sample.stamp_ns - at(0)) / NANOSECONDS
        assert seconds >= 0.07 and event.power == pytest.approx(100.0 * seconds, rel=1e-6)


def test_a_measured_sample_waits_for_the_predictions_up_to_its_readings(
    new_stream, ramp, battery, at
):
    """Battery once a second and early. No smoothed moment before a reading comes after its use."""
    readings = [r for k in range(8) for r in (*battery(float(k)), *ramp(10.0, k, k + 0.9))]
    stream, used_ns = new_stream(), 0
    seen = measured = 0
    for reading in readings:
        for event in completed(stream, [reading]):
            if isinstance(event, MeasuredSample):
                second = (event.sample.stamp_ns - at(0)) / NANOSECONDS
                used_ns = max(used_ns, at(math.ceil(second - 1e-9)))
                measured += 1
            elif isinstance(event, (Newest, Smoothed)):
                assert event.stamp_ns > used_ns
                seen += isinstance(event, Smoothed)
    assert seen > 70 and measured > 60


def test_a_battery_that_comes_too_late_is_counted(new_stream, ramp, battery):
    """Two seconds of speed first, then their battery readings."""
    stream = new_stream()
    assert not of(completed(stream, ramp(10.0, 0.0, 2.0)), MeasuredSample)
    completed(stream, battery(*(k / 10 for k in range(21))))
    assert stream.dropped == {"battery_late": 17}  # 1.6 s had passed


def test_moments_without_a_battery_are_given_up(new_stream, play, ramp, battery):
    stream = new_stream()
    readings = [*ramp(10.0, 0.0, 30.0, acceleration=0.01)]
    readings += battery(*(29.0 + k / 10 for k in range(10)))
    events = play(stream, sorted(readings, key=lambda r: r.stamp_ns))
    assert len(of(events, MeasuredSample)) == 8  # 29.0 to 29.7 s
    assert not stream.dropped


def test_a_gap_separates(new_stream, play, ramp, at):
    stream = new_stream()
    play(stream, [*ramp(10.0, 0.0, 3.0), AuxiliaryReading(at(3.0), 500.0)])
    events = play(stream, ramp(10.0, 5.6, 8.0, start=30.0))
    assert all(interval.end_ns <= at(3.0) for interval in of(events, Interval)[:1])
    # The quadratic never bends from one side to the other: all of it is the new ramp.
    for event in smoothed(events):
        assert event.stamp_ns >= at(5.6)
        assert event.acceleration == pytest.approx(0.5, rel=1e-5)
    first = min(newest(events), key=lambda sample: sample.stamp_ns)
    assert (first.stamp_ns, first.acceleration) == (at(5.6), 0.0)
    assert smoothed(events)[0].known_auxiliary == 0.0  # nor are loads


def test_speeds_that_all_come_after_a_gap_are_joined_once_their_rate_is_known(new_stream, at):
    """A phone that asks every 12 s: its first steps are gaps, by which it is known as slow."""
    stream, intervals = new_stream(), []
    for seconds in range(0, 480, 12):
        readings = [SpeedReading(at(seconds), 10.0), BatteryReading(at(seconds), 350.0, -20.0)]
        intervals += [interval for _, interval in stream.add(readings).intervals]
    assert len(intervals) >= 5
    assert all(
        interval.energy == pytest.approx(7e3 * interval.steps.duration.sum())
        for interval in intervals
    )


def test_late_and_doubled_speeds(new_stream, play, ramp, at):
    stream = new_stream()
    completed(stream, ramp(10.0, 0.0, 2.0))
    late = [SpeedReading(at(1.6), 5.7), SpeedReading(at(2.0), 99.0), SpeedReading(at(1.75), 5.8)]
    assert completed(stream, late) == []
    assert stream.dropped == {"speed_late": 1, "speed_doubled": 1}


def test_a_straggler_within_the_lateness_is_used(new_stream, play, ramp, at):
    readings = ramp(10.0, 0.0, 2.1)
    straggler = readings[17]
    late = [*readings[:17], *readings[18:20], straggler, *readings[20:]]
    in_order = smoothed(play(new_stream(), readings))
    with_straggler = smoothed(play(new_stream(), late))
    assert in_order[-1].stamp_ns == at(1.8)
    for sample, same in zip(with_straggler, in_order, strict=True):
        assert numbers(sample) == approx(numbers(same))


def test_voltage_and_current_may_come_apart(new_stream, play, ramp, at):
    """The current with the voltage of its own moment, 100 V/s: P = -V I."""
    rows = [BatteryReading(at(k / 10), 200.0 + 10 * k, math.nan) for k in range(60)]
    rows += [BatteryReading(at(k / 10 + 0.05), math.nan, -10.0) for k in range(60)]
    stream = new_stream()
    events = play(stream, sorted([*ramp(10.0, 0.0, 6.0), *rows], key=lambda r: r.stamp_ns))
    samples = of(events, MeasuredSample)
    assert len(samples) > 45 and not stream.dropped
    for event in samples:
        seconds = (event.sample.stamp_ns - at(0)) / NANOSECONDS
        assert event.power == pytest.approx(10.0 * (200.0 + 100.0 * seconds))


def test_late_and_doubled_batteries(new_stream, play, battery, at):
    stream = new_stream()
    completed(stream, [SpeedReading(at(1.35), 5.0)])  # up to 1.0 s all is known
    completed(stream, battery(1.1, 1.0, 1.05, 1.1))
    assert stream.dropped == {"battery_late": 1, "battery_doubled": 1}


def test_a_reset_forgets_readings_and_keeps_what_was_learned(new_stream, play, ramp, at):
    stream = new_stream()
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(200)
    readings = [SpeedReading(at(k / 10), 10 + noise[k]) for k in range(200)]
    play(stream, readings)
    stream.reset()
    # As the first time, but for what the differentiator has learned meanwhile.
    again, fresh = (play(used, readings[:20]) for used in (stream, new_stream()))
    for sample, same in zip(smoothed(again), smoothed(fresh), strict=True):
        assert numbers(sample) == approx(numbers(same))
    taught, first = (sorted(newest(events), key=stamp_of) for events in (again, fresh))
    assert [e.stamp_ns for e in taught] == [e.stamp_ns for e in first]
    assert taught[2].acceleration != first[2].acceleration


def test_readings_that_are_refused_are_counted_once_by_their_first_reason(new_stream, at):
    stream = new_stream()
    stream.add([
        BatteryReading(at(0.0), 350.0, 9e3), BatteryReading(at(0.1), 0.0, 0.0),
        BatteryReading(at(0.2), math.nan, math.nan), BatteryReading(2**62, 9e3, 9e3),
        SpeedReading(at(0.3), 400.0), BatteryReading(at(0.4), 350.0, -10.0),
    ])  # fmt: skip
    assert stream.dropped == {
        "battery_out_of_range": 2, "battery_unmeasured": 1, "stamp_out_of_range": 1,
        "speed_out_of_range": 1,
    }  # fmt: skip
