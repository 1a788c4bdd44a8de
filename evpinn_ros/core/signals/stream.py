"""Readings in, one time-ordered stream of samples and intervals out.

Speed sets the pace. Each new speed gives a newest `Sample` at once; each moment that lies
`smoothing_lag` back gives a smoothed one (at most one each `SAMPLE_PERIOD`), and a
`MeasuredSample` once battery readings on both sides of it are known, not before the smoothed
moments up to the later one, so that no prediction rests on a battery reading of its own moment or
after, and not before `allowed_lateness` has passed since the later one, so that the samples are
the same in whatever order battery readings come until then. Voltage and current may come apart.
Beside the samples, which predict and follow power, stand the intervals that the car is learned
from (`signals.interval`). What is late, doubled or impossible is
dropped and counted by reason. Time that jumps is not this module's: whoever feeds a stream puts a
`signals.time_jump.StampGuard` before it.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
import math

from evpinn_ros.core.signals.interval import IntervalBuilder
from evpinn_ros.core.signals.kinematics import (
    LAG_TOLERANCE_NS,
    MAX_ACCELERATION,
    CausalDifferentiator,
    SpeedTrack,
)
from evpinn_ros.core.signals.power import BatteryTrack, MotorTrack
from evpinn_ros.core.signals.readings import (
    MAX_SPEED,
    NANOSECONDS,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
    drawn_power,
    why_impossible,
)
from evpinn_ros.core.signals.road import GradeSource, Road
from evpinn_ros.core.signals.sample import MeasuredSample, Sample, StreamEvent

SAMPLE_PERIOD = 0.1  # s, shortest step between smoothed samples


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Settings by which readings become samples.

    Attributes:
        smoothing_lag: s of future speed the smoothed samples may use.
        allowed_lateness: s by which a reading may be older than the newest of its kind. Power is
            learned this much later; beyond `smoothing_lag` that costs accuracy.
        max_gap: s without speed (or battery) across which nothing is joined; signals that come
            slowly are joined across some of their own steps (`track.Cadence`).
        grade_source: where grade comes from.
    """

    smoothing_lag: float = 0.3
    allowed_lateness: float = 0.3
    max_gap: float = 2.5
    grade_source: GradeSource = GradeSource.AUTO


class SampleStream:
    """Readings of one car in, samples and intervals in order of time out."""

    def __init__(
        self,
        settings: StreamSettings,
        air_density: float,
        motor_ratio: float = math.nan,
        *,
        intervals_alone: bool = False,
    ) -> None:
        """Start empty.

        Args:
            settings: how to align.
            air_density: kg/m^3, used while no temperature is known.
            motor_ratio: rad that the motor turns per m of road, NaN where unknown.
            intervals_alone: give no samples, which take half of the time.
        """
        self._intervals_alone = intervals_alone
        self._settings = settings
        self._lag_ns = int(settings.smoothing_lag * NANOSECONDS) - LAG_TOLERANCE_NS
        lateness_ns = int(settings.allowed_lateness * NANOSECONDS)
        self._late_ns = max(0, lateness_ns - LAG_TOLERANCE_NS)
        self._motor_ratio = motor_ratio
        self._differentiator = CausalDifferentiator()
        self._road = Road(settings.grade_source, air_density)
        self.dropped: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget every reading, after a jump of time; what was learned of speed is kept."""
        gap = self._settings.max_gap
        self._speed, self._battery = SpeedTrack(gap), BatteryTrack(gap)
        self._motor = MotorTrack(gap, self._motor_ratio)
        self._moments: deque[int] = deque()
        self._unmeasured: deque[Sample] = deque()
        self._last_moment_ns: int | None = None
        self._begin_stretch()

    def _begin_stretch(self) -> None:
        """Join nothing across what was: a jump of time, or a gap."""
        self._differentiator.forget_pending()
        self._road.forget()
        self._intervals = IntervalBuilder(
            self._speed, self._battery, self._motor, self._road, self._late_ns
        )

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest speed, None before the first."""
        return self._speed.newest_ns if len(self._speed) else None

    @property
    def unknown(self) -> tuple[str, ...]:
        """Optional inputs without data (see `Road.unknown`)."""
        return self._road.unknown(self.newest_ns or 0)

    @property
    def battery_ns(self) -> int | None:
        """Stamp of the newest battery reading, None before the first."""
        return self._battery.newest_ns

    @property
    def battery_gap_ns(self) -> int:
        """Nanoseconds without the battery after which a dropout begins, by its own rate."""
        return self._battery.gap_ns

    def measured_power(self, reading: BatteryReading) -> float:
        """Power that a reading measures, W, or NaN; of a current alone, with the last voltage."""
        voltage = reading.voltage
        if math.isnan(voltage):
            voltage = self._battery.latest_voltage(reading.stamp_ns)
        return drawn_power(voltage, reading.current)

    def add_reading(self, reading: Reading) -> Iterator[StreamEvent]:
        """Take one reading and give what it completes, in order."""
        if (reason := why_impossible(reading)) is not None:
            self.dropped[reason] += 1
        elif isinstance(reading, SpeedReading):
            yield from self._add_speed(reading)
        elif isinstance(reading, BatteryReading):
            self._add_battery(reading)
        elif isinstance(reading, MotorReading) and len(self._speed):
            self._motor.add(reading, self._speed.newest)
        else:
            self._road.add_reading(reading)
        if self._last_moment_ns is not None:
            yield from self._match_power(self._last_moment_ns)
        if len(self._speed):
            self._drop_hopeless()
            yield from self._intervals.intervals()

    def _add_speed(self, reading: SpeedReading) -> Iterator[StreamEvent]:
        newest = self.newest_ns
        if newest is not None and newest - reading.stamp_ns > self._late_ns:
            self.dropped["speed_late"] += 1
            return
        if newest is not None and reading.stamp_ns <= newest:
            if not self._speed.add(reading.stamp_ns, reading.speed):
                self.dropped["speed_doubled"] += 1
            return
        if newest is not None and reading.stamp_ns - newest > self._speed.cadence.gap_ns:
            yield from self._intervals.finish()
            self._speed.restart((reading.stamp_ns - newest) / NANOSECONDS)
            self._moments.clear()
            self._begin_stretch()
        elif newest is not None:
            self._road.travel(abs(reading.speed) * (reading.stamp_ns - newest) / NANOSECONDS)
        self._speed.add(reading.stamp_ns, reading.speed)
        if self._intervals_alone:
            return
        self._moments.append(reading.stamp_ns)
        yield from self._newest_sample(reading)
        yield from self._smoothed_samples()

    def _newest_sample(self, reading: SpeedReading) -> Iterator[Sample]:
        differences = self._speed.differences()
        acceleration = self._differentiator.acceleration(reading.stamp_ns, differences)
        if abs(acceleration) > MAX_ACCELERATION:
            self.dropped["acceleration_impossible"] += 1
            return
        yield self._sample(reading.stamp_ns, reading.speed, acceleration, newest=True)

    def _smoothed_samples(self) -> Iterator[Sample | MeasuredSample]:
        newest = self._speed.newest_ns
        while self._moments and newest - self._moments[0] >= self._lag_ns:
            stamp_ns = self._moments.popleft()
            if not self._due(stamp_ns):
                continue
            speed, acceleration = self._speed.smoothed(stamp_ns, newest)
            if math.isnan(acceleration):
                continue
            if abs(acceleration) > MAX_ACCELERATION or abs(speed) > MAX_SPEED:
                self.dropped["acceleration_impossible"] += 1
                continue
            yield from self._match_power(stamp_ns - 1)
            self._last_moment_ns = stamp_ns
            self._differentiator.learn(stamp_ns, acceleration)
            sample = self._sample(stamp_ns, speed, acceleration)
            self._unmeasured.append(sample)
            yield sample

    def _due(self, stamp_ns: int) -> bool:
        """True if a moment is far enough from the last one sampled."""
        if self._last_moment_ns is None:
            return True
        step = stamp_ns - self._last_moment_ns
        return step >= int(SAMPLE_PERIOD * NANOSECONDS) - LAG_TOLERANCE_NS

    def _sample(
        self, stamp_ns: int, speed: float, acceleration: float, *, newest: bool = False
    ) -> Sample:
        around = self._road.conditions(stamp_ns)
        return Sample(
            stamp_ns=stamp_ns,
            speed=speed,
            acceleration=acceleration,
            grade=self._road.grade(stamp_ns),
            air_density=around.air_density,
            known_auxiliary=around.load,
            profile=self._speed.profile(stamp_ns, self._speed.newest_ns, acceleration),
            head_wind=around.head_wind,
            celsius=around.celsius,
            doubted_load=around.doubted_load,
            motor_power=self._motor.at(stamp_ns),
            motor_scaled=self._motor.scaled,
            newest=newest,
        )

    def _add_battery(self, reading: BatteryReading) -> None:
        if math.isnan(reading.voltage) and math.isnan(reading.current):
            self.dropped["battery_unmeasured"] += 1
            return
        newest = self._battery.newest_ns
        if newest is not None and newest - reading.stamp_ns > self._late_ns:
            self.dropped["battery_late"] += 1
            return
        if not self._battery.add(
            reading.stamp_ns, reading.voltage, reading.current, reading.power_std
        ):
            self.dropped["battery_doubled"] += 1

    def _match_power(self, until_ns: int) -> Iterator[MeasuredSample]:
        """Samples whose power battery readings up to a moment, and none to come, determine."""
        until_ns = min(until_ns, self._speed.newest_ns - self._late_ns)
        while self._unmeasured:
            after = self._battery.next_ns(self._unmeasured[0].stamp_ns)
            if after is None or after > until_ns:
                return
            sample = self._unmeasured.popleft()
            power = self._battery.at(sample.stamp_ns)
            if not math.isnan(power):
                yield MeasuredSample(sample, power)

    def _drop_hopeless(self) -> None:
        """Stop waiting for the battery at moments that no two readings to be joined settled."""
        while self._unmeasured:
            age_ns = self._speed.newest_ns - self._unmeasured[0].stamp_ns
            if age_ns <= self._battery.gap_ns + self._late_ns + self._lag_ns:
                return
            self._unmeasured.popleft()
