"""A sensor that repeats one value while the other shows that the car does something else.

A speed that is not suspected yet is in doubt, or did hang if it leaps at last. One that goes on as
it was did not: a cruise control keeps a fine speed for seconds, a simulator's driver for minutes,
and between speeding up and slowing down any car does.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple

from evpinn_ros.core.signals.detector import (
    BATTERY_REPEATS,
    BATTERY_STUCK,
    COARSE_DOUBT,
    COARSE_SPEED,
    FINE_DOUBT,
    FINE_SPEED,
    SPEED_REPEATS,
    SPEED_STUCK,
    Hysteresis,
)
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

FINE = 0.1  # m/s, a step of finer speeds
OFTEN = 10  # readings of one value before it is suspected
WINDOW_NS = 15 * NANOSECONDS  # beyond, a hilly road under cruise control would look the same
LEAST_HANG = 0.35  # s; less is a gap between readings
LEAP, LEAP_STEPS, MOST_ACCELERATION = 0.5, 2.5, 3.0  # m/s, steps of the signal, m/s^2
SETTLES_NS = NANOSECONDS // 2  # before and after, which smoothing reaches and in which it leaps
SPOILT_KEPT = 20
IDLE_POWER = 5e3  # W; a full battery takes no more while friction stops the car, or none at all
MOVING = 2.0  # m/s


class Spoilt(NamedTuple):
    """A time of which nothing is learned, and why."""

    reason: str
    since_ns: int
    until_ns: int


class Repetition(NamedTuple):
    """One value that a signal repeats, and the range of another one meanwhile."""

    value: Any = None
    since_ns: int = 0
    newest_ns: int = 0
    times: int = 0
    window_ns: int = 0  # begin of the range
    low: float = math.inf
    high: float = -math.inf
    climb: float = 0.0  # of the other one, upwards
    stuck: bool | None = None
    doubted: bool | None = None

    @property
    def seconds(self) -> float:
        """Duration so far."""
        return (self.newest_ns - self.since_ns) / NANOSECONDS

    def repeated(self, stamp_ns: int, value: Hashable) -> Repetition:
        """After a value of the signal, this one or another."""
        if value != self.value or stamp_ns < self.since_ns:
            return Repetition(value, stamp_ns, stamp_ns, 1, stamp_ns)
        return self._replace(newest_ns=max(self.newest_ns, stamp_ns), times=self.times + 1)

    def beside(self, stamp_ns: int, other: float) -> Repetition:
        """After a value of the other signal."""
        low, high, climb, window_ns = self.low, self.high, self.climb, self.window_ns
        if abs(stamp_ns - window_ns) > WINDOW_NS:
            low, high, climb, window_ns = math.inf, -math.inf, 0.0, stamp_ns
        low = min(low, other)
        return self._replace(
            low=low, high=max(high, other), climb=max(climb, other - low), window_ns=window_ns
        )

    def judged(self, by: Hysteresis, swing: float) -> Repetition:
        """With a verdict on how far the other signal moved."""
        if self.times < OFTEN:
            return self
        return self._replace(stuck=by.judge(self.stuck, swing, self.seconds))


NO_VALUE = Repetition()


@dataclass(frozen=True, slots=True)
class StuckDetector:
    """Detector of a speed or battery that repeats one value while the other changes.

    Attributes:
        speed: its repetition, with the power meanwhile.
        battery: repetition of voltage and current, with the speed meanwhile.
        step: smallest change of speed seen, m/s.
        spoilt: when a signal repeated: what lies behind is learned from later.
    """

    speed: Repetition = NO_VALUE
    battery: Repetition = NO_VALUE
    step: float = math.inf
    spoilt: tuple[Spoilt, ...] = ()

    @property
    def detected(self) -> str | None:
        """`SPEED_STUCK`, `BATTERY_STUCK` or None."""
        if self.battery.stuck:
            return BATTERY_STUCK
        return SPEED_STUCK if self.speed.stuck else None

    def after(self, reading: Reading) -> StuckDetector:
        """The detector after a reading of any kind."""
        if isinstance(reading, SpeedReading):
            detector = self._moved(reading)._after_speed(reading)
        elif isinstance(reading, BatteryReading) and math.isfinite(reading.power):
            detector = self._after_battery(reading)
        else:
            return self
        if (reason := detector.detected) is None and detector.speed.doubted:
            reason = SPEED_REPEATS
        if reason is None:
            return detector
        return detector._spoil(
            reason, detector.battery if reason == BATTERY_STUCK else detector.speed
        )

    def why_not(self, begin_ns: int, end_ns: int) -> str | None:
        """Reason not to learn of a time that lies behind, or None."""
        for reason, first_ns, last_ns in self.spoilt:
            if begin_ns <= last_ns + SETTLES_NS and end_ns >= first_ns - SETTLES_NS:
                return reason
        return None

    def _moved(self, reading: SpeedReading) -> StuckDetector:
        """The detector after the step to another speed; a leap shows that the speed did hang."""
        before = self.speed.value
        if before is None or reading.speed == before:
            return self
        change = abs(reading.speed - before)
        moved = replace(self, step=min(self.step, change))
        gap = (reading.stamp_ns - self.speed.newest_ns) / NANOSECONDS
        limit = max(LEAP, LEAP_STEPS * moved.step) + MOST_ACCELERATION * gap
        leapt = self.speed.seconds >= LEAST_HANG and change > limit
        return moved._spoil(SPEED_REPEATS, self.speed) if leapt else moved

    def _after_speed(self, reading: SpeedReading) -> StuckDetector:
        repetition = self.speed.repeated(reading.stamp_ns, reading.speed)
        if abs(reading.speed) > MOVING:
            stuck, doubt = FINE_SPEED, FINE_DOUBT
            if self.step >= FINE:
                stuck, doubt = COARSE_SPEED, COARSE_DOUBT
            swing = repetition.high - repetition.low
            repetition = repetition.judged(stuck, swing)
            repetition = repetition._replace(
                doubted=doubt.judge(repetition.doubted, swing, repetition.seconds)
            )
        battery = self.battery.beside(reading.stamp_ns, reading.speed)
        return StuckDetector(repetition, battery, self.step, self.spoilt)

    def _after_battery(self, reading: BatteryReading) -> StuckDetector:
        # Robots send a current of 0 for want of a sensor, beside a voltage that is measured.
        values = (reading.voltage, reading.current) if reading.current else (reading.current,)
        repetition = self.battery.repeated(reading.stamp_ns, values)
        idle = abs(reading.power) < IDLE_POWER
        repetition = repetition.judged(
            BATTERY_REPEATS, repetition.climb if idle else repetition.high - repetition.low
        )
        speed = self.speed.beside(reading.stamp_ns, reading.power)
        return StuckDetector(speed, repetition, self.step, self.spoilt)

    def _spoil(self, reason: str, repetition: Repetition) -> StuckDetector:
        """Learn nothing of the time in which a value repeated so far."""
        before = self.spoilt
        if before and before[-1][:2] == (reason, repetition.since_ns):
            before = before[:-1]
        last = Spoilt(reason, repetition.since_ns, repetition.newest_ns)
        return replace(self, spoilt=(*before, last)[-SPOILT_KEPT:])
