"""Readings in, one time-ordered stream of samples and intervals out.

Speed sets the pace. Each new speed gives a newest `Sample` at once; each moment that lies
`smoothing_lag` back gives a smoothed one (at most one each `SAMPLE_PERIOD`), and a
`MeasuredSample` once battery readings on both sides of it are known, not before the smoothed
moments up to the later one, so that no prediction rests on a battery reading of its own moment or
after, and not before `allowed_lateness` has passed since the later one, so that the samples are
the same in whatever order battery readings come until then. Voltage and current may come apart.
Beside the samples, which predict and follow power, stand the intervals that the car is learned
from (`signals.interval`). What is late, doubled or impossible is dropped and counted by reason.
Time that jumps is not this module's: whoever feeds a stream puts a `signals.time_jump.StampGuard`
before it. Who knows which readings come next says so (`look_ahead`), and the arithmetic of all
their samples is done together.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.interval import Interval, IntervalBuilder
from evpinn_ros.core.signals.kinematics import (
    LAG_TOLERANCE_NS,
    LOOK_BACK_NS,
    MAX_ACCELERATION,
    CausalDifferentiator,
    Speeds,
    SpeedTrack,
    profile,
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


class _Smoothed(NamedTuple):
    """Speed, m/s, and acceleration, m/s^2, at a moment, and `Speeds.slopes` around it."""

    speed: float
    acceleration: float
    slopes: list[float]


class _Row(NamedTuple):
    """What rests on speed alone once a speed has come.

    Attributes:
        differences: of the speeds before it, shape (TAPS,).
        slopes: around it, as far as they are known.
        smoothed: the moments that lie `smoothing_lag` back from then on, by stamp.
    """

    differences: np.ndarray
    slopes: list[float]
    smoothed: dict[int, _Smoothed]


class SampleStream:
    """Readings of one car in, samples and intervals in order of time out.

    Attributes:
        dropped: readings not used, by reason.
        taken: whether the last reading was used, and all that it completed.
    """

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
        self.taken = True
        self.reset()

    def reset(self) -> None:
        """Forget every reading, after a jump of time; what was learned of speed is kept."""
        gap = self._settings.max_gap
        self._speed, self._battery = SpeedTrack(gap), BatteryTrack(gap)
        self._motor = MotorTrack(gap, self._motor_ratio)
        self._moments: deque[int] = deque()
        self._coming: deque[SpeedReading] = deque()
        self._rows: deque[_Row] = deque()
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

    def look_ahead(self, readings: Iterable[Reading]) -> None:
        """Say which readings come next, so that what rests on speed is computed together."""
        speeds = (reading for reading in readings if isinstance(reading, SpeedReading))
        self._coming = deque(speed for speed in speeds if why_impossible(speed) is None)
        self._rows.clear()

    def add_reading(self, reading: Reading) -> list[StreamEvent]:
        """Take one reading and give what it completes, in order."""
        events: list[StreamEvent] = []
        self.taken = True
        if (reason := why_impossible(reading)) is not None:
            self._drop(reason)
        elif isinstance(reading, SpeedReading):
            self._add_speed(reading, events)
        elif isinstance(reading, BatteryReading):
            self._add_battery(reading)
            self._match_power(self._last_moment_ns, events)
        elif isinstance(reading, MotorReading) and len(self._speed):
            self._motor.add(reading, self._speed.newest)
        else:
            self._road.add_reading(reading)
        return events

    def finish(self) -> Iterator[Interval]:
        """The intervals that wait for more of a drive that is over."""
        if len(self._speed):
            yield from self._intervals.finish()

    def _drop(self, reason: str) -> None:
        """Count a reading that is not used, or not whole."""
        self.dropped[reason] += 1
        self.taken = False

    def _add_speed(self, reading: SpeedReading, events: list[StreamEvent]) -> None:
        """Take a speed, with which samples and intervals may be complete."""
        if self._coming and self._coming[0] is reading:
            self._coming.popleft()
        self._move_on(reading, events)
        self._match_power(self._last_moment_ns, events)
        if len(self._speed):
            self._drop_hopeless()
            events.extend(self._intervals.intervals())

    def _move_on(self, reading: SpeedReading, events: list[StreamEvent]) -> None:
        newest = self.newest_ns
        if newest is not None and newest - reading.stamp_ns > self._late_ns:
            self._drop("speed_late")
            return
        if newest is not None and reading.stamp_ns <= newest:
            self._rows.clear()
            if not self._speed.add(reading.stamp_ns, reading.speed):
                self._drop("speed_doubled")
            return
        if newest is not None and reading.stamp_ns - newest > self._speed.cadence.gap_ns:
            events.extend(self._intervals.finish())
            self._speed.restart((reading.stamp_ns - newest) / NANOSECONDS)
            self._moments.clear()
            self._begin_stretch()
        elif newest is not None:
            self._road.travel(abs(reading.speed) * (reading.stamp_ns - newest) / NANOSECONDS)
        if not (self._intervals_alone or self._rows):
            self._compute_rows(reading)
        self._speed.add(reading.stamp_ns, reading.speed)
        if self._intervals_alone:
            return
        self._moments.append(reading.stamp_ns)
        row = self._rows.popleft()
        self._newest_sample(reading, row, events)
        self._smoothed_samples(row, events)

    def _compute_rows(self, reading: SpeedReading) -> None:
        """Compute what rests on speed alone for this one and those that follow it in order."""
        zero_ns = reading.stamp_ns
        run = [reading, *self._following(reading)]
        stamps = np.array([speed.stamp_ns - zero_ns for speed in run], np.int64)
        pending = np.array([moment_ns - zero_ns for moment_ns in self._moments], np.int64)
        oldest_ns = min([zero_ns, *self._moments]) - LOOK_BACK_NS
        before = self._speed.since(oldest_ns, zero_ns)
        values = np.concatenate((before.values, [speed.speed for speed in run]))
        speeds = Speeds(np.concatenate((before.stamps, stamps)), values)
        own = len(before.stamps) + 1 + np.arange(len(run))  # speeds up to each
        differences, slopes = speeds.differences(stamps), speeds.slopes(stamps, own)
        self._rows = deque(map(_Row, differences, slopes.tolist(), ({} for _ in run)))
        moments = np.concatenate((pending, stamps))
        passed = np.searchsorted(stamps, moments + self._lag_ns)
        passed[len(pending) :] = np.maximum(passed[len(pending) :], np.arange(len(run)))
        moments, passed = moments[passed < len(run)], passed[passed < len(run)]
        if not len(moments):
            return
        columns = (*speeds.smoothed(moments, own[passed]), speeds.slopes(moments, own[passed]))
        rows = zip(moments.tolist(), passed.tolist(), *(c.tolist() for c in columns), strict=True)
        for moment, row, *smoothed in rows:
            self._rows[row].smoothed[moment + zero_ns] = _Smoothed(*smoothed)

    def _following(self, reading: SpeedReading) -> Iterator[SpeedReading]:
        """Speeds that come next and are surely joined to those before them."""
        newest_ns, gap_ns = reading.stamp_ns, int(self._settings.max_gap * NANOSECONDS)
        for coming in self._coming:
            step_ns = coming.stamp_ns - newest_ns
            if not 0 < step_ns <= gap_ns:
                return
            yield coming
            newest_ns = coming.stamp_ns

    def _newest_sample(self, reading: SpeedReading, row: _Row, events: list[StreamEvent]) -> None:
        acceleration = self._differentiator.acceleration(reading.stamp_ns, row.differences)
        if abs(acceleration) > MAX_ACCELERATION:
            self._drop("acceleration_impossible")
            return
        moved = reading.speed, acceleration, row.slopes
        events.append(self._sample(reading.stamp_ns, _Smoothed(*moved), newest=True))

    def _smoothed_samples(self, row: _Row, events: list[StreamEvent]) -> None:
        newest = self._speed.newest_ns
        while self._moments and newest - self._moments[0] >= self._lag_ns:
            stamp_ns = self._moments.popleft()
            if not self._due(stamp_ns):
                continue
            moved = row.smoothed[stamp_ns]
            if math.isnan(moved.acceleration):
                continue
            if abs(moved.acceleration) > MAX_ACCELERATION or abs(moved.speed) > MAX_SPEED:
                self._drop("acceleration_impossible")
                continue
            self._match_power(stamp_ns - 1, events)
            self._last_moment_ns = stamp_ns
            self._differentiator.learn(stamp_ns, moved.acceleration)
            sample = self._sample(stamp_ns, moved)
            self._unmeasured.append(sample)
            events.append(sample)

    def _due(self, stamp_ns: int) -> bool:
        """True if a moment is far enough from the last one sampled."""
        if self._last_moment_ns is None:
            return True
        step = stamp_ns - self._last_moment_ns
        return step >= int(SAMPLE_PERIOD * NANOSECONDS) - LAG_TOLERANCE_NS

    def _sample(self, stamp_ns: int, moved: _Smoothed, *, newest: bool = False) -> Sample:
        around = self._road.conditions(stamp_ns)
        return Sample(
            stamp_ns=stamp_ns,
            speed=moved.speed,
            acceleration=moved.acceleration,
            grade=self._road.grade(stamp_ns),
            air_density=around.air_density,
            known_auxiliary=around.load,
            profile=profile(moved.slopes, moved.acceleration),
            head_wind=around.head_wind,
            celsius=around.celsius,
            doubted_load=around.doubted_load,
            motor_power=self._motor.at(stamp_ns),
            motor_scaled=self._motor.scaled,
            newest=newest,
        )

    def _add_battery(self, reading: BatteryReading) -> None:
        if math.isnan(reading.voltage) and math.isnan(reading.current):
            self._drop("battery_unmeasured")
            return
        newest = self._battery.newest_ns
        if newest is not None and newest - reading.stamp_ns > self._late_ns:
            self._drop("battery_late")
            return
        if not self._battery.add(
            reading.stamp_ns, reading.voltage, reading.current, reading.power_std
        ):
            self._drop("battery_doubled")

    def _match_power(self, until_ns: int | None, events: list[StreamEvent]) -> None:
        """Samples whose power battery readings up to a moment, and none to come, determine."""
        while self._unmeasured and until_ns is not None:
            after = self._battery.next_ns(self._unmeasured[0].stamp_ns)
            if after is None or after > min(until_ns, self._speed.newest_ns - self._late_ns):
                return
            sample = self._unmeasured.popleft()
            power = self._battery.at(sample.stamp_ns)
            if not math.isnan(power):
                events.append(MeasuredSample(sample, power))

    def _drop_hopeless(self) -> None:
        """Stop waiting for the battery at moments that no two readings to be joined settled."""
        while self._unmeasured:
            age_ns = self._speed.newest_ns - self._unmeasured[0].stamp_ns
            if age_ns <= self._battery.gap_ns + self._late_ns + self._lag_ns:
                return
            self._unmeasured.popleft()
