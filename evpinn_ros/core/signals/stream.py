"""Turns readings in order of stamps into samples and intervals.

Each speed reading gives a smoothed sample once `smoothing_lag` has passed (at most one each
`SAMPLE_PERIOD`). A sample is measured once battery readings on both sides of it are known. It is
learned from after all smoothed samples up to the later of these are predicted, so that no
prediction rests on a battery reading of its own moment or after. Voltage and current may come
apart. Samples predict and track power; the car is learned from intervals (`signals.interval`).

`signals.time_jump` and `signals.reorder` come before: here all readings up to the newest speed are
known and in order. How a drive is cut into blocks changes nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from evpinn_ros.core.signals.block import Block, Rows
from evpinn_ros.core.signals.interval import Interval, IntervalBuilder
from evpinn_ros.core.signals.kinematics import (
    LAG_TOLERANCE_NS,
    LOOK_BACK_NS,
    MAX_ACCELERATION,
    PROFILE,
    TAPS,
    CausalDifferentiator,
    SpeedTrack,
    Taps,
    profile,
)
from evpinn_ros.core.signals.newest import NO_SPEEDS, NewestSpeeds
from evpinn_ros.core.signals.power import BatteryTrack, MotorTrack
from evpinn_ros.core.signals.readings import (
    MAX_SPEED,
    NANOSECONDS,
    BatteryReading,
    MotorReading,
    SpeedReading,
)
from evpinn_ros.core.signals.road import GradeSource, Road
from evpinn_ros.core.signals.sample import (
    NO_EVENTS,
    NO_MEASURED,
    NO_NEWEST,
    NO_NS,
    NO_SAMPLES,
    Events,
    Measured,
    Newest,
    Sample,
    Samples,
    joined_events,
)
from evpinn_ros.core.signals.track import NEVER

SAMPLE_PERIOD = 0.1  # s, shortest step between smoothed samples
PERIOD_NS = int(SAMPLE_PERIOD * NANOSECONDS) - LAG_TOLERANCE_NS
NO_LESSONS = np.empty((0, TAPS)), np.empty(0)
FORGOTTEN_NS = 120 * NANOSECONDS  # without the battery, then a sample stays unmeasured


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Settings by which readings become samples.

    Attributes:
        smoothing_lag: s of future speed the smoothed samples may use.
        allowed_lateness: s by which a reading may come later than speeds of its stamp; every
            output but the immediate prediction waits so long.
        max_gap: s without speed (or battery) across which nothing is joined; signals that come
            slowly are joined across some of their own steps (`track.SignalTrack`).
        grade_source: where grade comes from.
    """

    smoothing_lag: float = 0.3
    allowed_lateness: float = 0.3
    max_gap: float = 2.5
    grade_source: GradeSource = GradeSource.AUTO


class SampleStream:
    """Readings of one car in order of stamps in, samples and intervals out.

    Attributes:
        dropped: samples not used, by reason.
        speed: the latest speeds.
        battery: voltage and current of the latest seconds.
        motor: power of the motor in the latest seconds.
    """

    def __init__(
        self, settings: StreamSettings, air_density: float, motor_ratio: float = math.nan
    ) -> None:
        """Start empty.

        Args:
            settings: of smoothing, gaps and grade.
            air_density: kg/m^3, used while no temperature is known.
            motor_ratio: rad that the motor turns per m of road, NaN where unknown.
        """
        self._settings = settings
        self._lag_ns = int(settings.smoothing_lag * NANOSECONDS) - LAG_TOLERANCE_NS
        self._motor_ratio = motor_ratio
        self._differentiator = CausalDifferentiator()
        self._road = Road(settings.grade_source, air_density)
        self.dropped: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget every reading, after a jump of time; what was learned of speed is kept."""
        gap = self._settings.max_gap
        self.speed, self.battery = SpeedTrack(gap), BatteryTrack(gap)
        self.motor = MotorTrack(gap, self._motor_ratio)
        self._unmeasured = NO_SAMPLES
        self._last_moment_ns = NEVER  # of the last smoothed sample
        self._begin_stretch()

    def _begin_stretch(self) -> None:
        """Join nothing across a jump of time or a gap."""
        self._moments = NO_NS  # without a smoothed sample so far
        self._road.forget()
        self._intervals = IntervalBuilder(self.speed, self.battery, self.motor, self._road)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Optional inputs without data (see `Road.unknown`)."""
        return self._road.unknown(max(self.speed.newest_ns, 0))

    def around(self, known_ns: int) -> tuple[list[float], Sample]:
        """Weights of the differentiator, `TAPS` of them, and a standing sample at a stamp."""
        information, products = self._differentiator.information, self._differentiator.products
        stamps, nothing = np.array([known_ns]), np.zeros(1)
        slopes, motor = np.full((1, PROFILE), np.nan), np.full(1, np.nan)
        standing = next(self._samples(stamps, stamps, nothing, nothing, slopes, motor).rows())
        return np.linalg.solve(information, products).tolist(), standing

    def finish(self) -> Iterator[Interval]:
        """Yields the intervals that still wait at the end of a drive."""
        if len(self.speed):
            yield from (interval for _, interval in self._intervals.intervals())
        yield from self._intervals.finish()

    def add(
        self, block: Block, newest: NewestSpeeds = NO_SPEEDS, *, intervals: bool = True
    ) -> Events:
        """Take readings in order of stamps; returns what they complete.

        Args:
            block: of the readings.
            newest: speeds to be predicted at once.
            intervals: whether to return intervals; those that a gap ends come anyway.
        """
        if intervals:
            self._forget()
        parts: list[Events] = []
        while True:
            stamps = block.of_kind(SpeedReading).stamps
            count = self.speed.until_gap(stamps)
            if count == len(stamps):
                return joined_events([*parts, self._add(block, newest, intervals)])
            gap_ns = int(stamps[count])
            part, block = block.until(gap_ns)
            predicted, newest = newest.until(gap_ns)
            parts.append(self._add(part, predicted, True))
            ended = [(gap_ns, interval) for interval in self._intervals.finish()]
            parts.append(NO_EVENTS._replace(intervals=ended))
            self.speed.restart((gap_ns - self.speed.newest_ns) / NANOSECONDS)
            self._begin_stretch()

    def _add(self, block: Block, newest: NewestSpeeds, asked: bool) -> Events:
        """Take the readings of a stretch, and the newest speeds that come before its end."""
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        travelled = np.diff(speeds.stamps, prepend=self.speed.stamps[-1:]) / NANOSECONDS
        count = len(travelled)  # the first speed of a drive ends no step
        ends = speeds.where(slice(len(speeds.stamps) - count, None))
        self._road.extend(block, ends.stamps, np.abs(ends.values[0]) * travelled)
        self.battery.extend(battery)
        self.speed.extend(speeds.stamps, speeds.values[0])
        self.motor.extend(block.of_kind(MotorReading), self.speed)
        smoothed, smoothed_ns, taps = self._smoothed(speeds)
        measured = self._measured(smoothed, smoothed_ns)
        intervals = [*self._intervals.intervals()] if asked and len(self.speed) else []
        predicted = self._newest(newest, smoothed_ns, taps)
        return Events(predicted, smoothed, smoothed_ns, measured, intervals)

    def _forget(self) -> None:
        """Drop readings that no later sample needs."""
        needed_ns = min(self._intervals.needed_ns, self.speed.newest_ns - FORGOTTEN_NS)
        if self._unmeasured.size:
            needed_ns = min(needed_ns, int(self._unmeasured.stamp_ns[0]))
        for track in (self.speed, self.battery, self.motor.power, self._road):
            track.forget_before(needed_ns)

    def _smoothed(self, speeds: Rows) -> tuple[Samples, np.ndarray, Taps]:
        """The moments that now lie `smoothing_lag` back.

        Returns:
            The samples, the stamps of the speeds that complete them, and the weights of the
            differentiator once each is learned.
        """
        moments = np.concatenate((self._moments, speeds.stamps))
        stamps = self.speed.stamps
        last = stamps.searchsorted(moments + self._lag_ns)
        now = last < len(stamps)
        self._moments, moments, last = moments[~now], moments[now], last[now]
        if not len(moments):
            return NO_SAMPLES, NO_NS, self._differentiator.learn(*NO_LESSONS)
        zero_ns = int(moments[0])
        track = self.speed.since(zero_ns - LOOK_BACK_NS, zero_ns)
        until = last + 1 - (len(stamps) - len(track.stamps))
        speed, acceleration = track.smoothed(moments - zero_ns, until)
        chosen = self._due(moments, speed, acceleration)
        moments, until = moments[chosen], until[chosen]
        speed, acceleration = speed[chosen], acceleration[chosen]
        slopes = track.slopes(moments - zero_ns, until)
        taps = self._differentiator.learn(track.differences(moments - zero_ns), acceleration)
        completed_ns = stamps[last[chosen]]
        motor = self.motor.at(moments, completed_ns)
        samples = self._samples(moments, moments, speed, acceleration, slopes, motor)
        return samples, completed_ns, taps

    def _due(self, moments: np.ndarray, speed: np.ndarray, acceleration: np.ndarray) -> list[int]:
        """Indices of the moments that are possible and `SAMPLE_PERIOD` from the last one."""
        possible = (np.abs(acceleration) <= MAX_ACCELERATION) & (np.abs(speed) <= MAX_SPEED)
        chosen: list[int] = []
        last_ns = self._last_moment_ns
        rows = moments.tolist(), np.isnan(acceleration).tolist(), possible.tolist()
        for place, (stamp_ns, is_unknown, is_possible) in enumerate(zip(*rows, strict=True)):
            if stamp_ns - last_ns < PERIOD_NS or is_unknown:
                continue
            if not is_possible:
                self.dropped["acceleration_impossible"] += 1
                continue
            chosen.append(place)
            last_ns = stamp_ns
        self._last_moment_ns = last_ns
        return chosen

    def _newest(self, newest: NewestSpeeds, smoothed_ns: np.ndarray, taps: Taps) -> Newest:
        """Samples of the newest speeds, from what was learned before each."""
        if not len(newest.stamps):
            return NO_NEWEST
        weights = taps.weights(smoothed_ns.searchsorted(newest.known_ns, side="right"))
        acceleration = (newest.differences * weights).sum(axis=1)
        possible = np.abs(acceleration) <= MAX_ACCELERATION
        if not possible.all():
            newest, acceleration = newest.where(possible), acceleration[possible]
        samples = self._samples(
            newest.stamps, newest.known_ns, newest.speed, acceleration, newest.slopes,
            newest.motor_power,
        )  # fmt: skip
        return Newest(samples, newest.known_ns, newest.battery_ns, newest.battery_power)

    def _samples(
        self,
        stamps: np.ndarray,
        known_ns: np.ndarray,
        speed: np.ndarray,
        acceleration: np.ndarray,
        slopes: np.ndarray,
        motor_power: np.ndarray,
    ) -> Samples:
        """Samples whose surroundings are those known at stamps, ns, shape (n,)."""
        around = self._road.conditions(known_ns)
        return Samples(
            stamp_ns=stamps,
            speed=speed,
            acceleration=acceleration,
            grade=self._road.grades(known_ns),
            air_density=around.air_density,
            known_auxiliary=around.load,
            profile=profile(slopes, acceleration),
            head_wind=around.head_wind,
            celsius=around.celsius,
            motor_power=motor_power,
            motor_scaled=self.motor.scaled(known_ns),
        )

    def _measured(self, smoothed: Samples, smoothed_ns: np.ndarray) -> Measured:
        """The samples that can be learned from once those up to their reading are predicted."""
        waiting = self._unmeasured.and_then(smoothed)
        if not waiting.size:
            return NO_MEASURED
        stamps = smoothed.stamp_ns
        after = self.battery.first_after(waiting.stamp_ns)
        # A sample is known once a smoothed moment at or after that reading is complete.
        place = stamps.searchsorted(after)
        passed = place < len(stamps)
        patience_ns = max(FORGOTTEN_NS, int(self.battery.gap_ns()))
        waits = ~passed & (waiting.stamp_ns >= self.speed.newest_ns - patience_ns)
        self._unmeasured = waiting.where(waits)
        samples, after, place = waiting.where(passed), after[passed], place[passed]
        power = self.battery.at(samples.stamp_ns)
        place_after = place + (stamps[place] == after)
        measured = Measured(samples, power, smoothed_ns[place], place_after)
        is_known = ~np.isnan(power)
        return measured if is_known.all() else measured.where(is_known)
