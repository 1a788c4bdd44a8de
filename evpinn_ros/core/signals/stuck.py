"""Detects a speed or battery that repeats one value while the other signal changes.

A speed that repeats is in doubt until it changes. A leap then shows that the sensor hung, a smooth
change that it did not: a cruise control keeps a fine speed for seconds, a simulator's driver for
minutes, and every car between speeding up and slowing down.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import Block, Rows
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
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    SpeedReading,
    drawn_power,
)

FINE = 0.1  # m/s; a speed with smaller steps is fine, else coarse
OFTEN = 10  # readings of one value before it is suspected
WINDOW_NS = 15 * NANOSECONDS  # of the range; in more, hills under cruise control look the same
LEAST_HANG = 0.35  # s; less is a gap between readings
LEAP, LEAP_STEPS, MOST_ACCELERATION = 0.5, 2.5, 3.0  # m/s, steps of the signal, m/s^2
SETTLES_NS = NANOSECONDS // 2  # on both sides of a repetition, which smoothing mixes with it
SPOILT_KEPT = 20
IDLE_POWER = 5e3  # W; a full battery takes no more while friction stops the car, or none at all
MOVING = 2.0  # m/s


class Spoilt(NamedTuple):
    """A span from which nothing is learned, and why."""

    reason: str
    since_ns: int
    until_ns: int


class Verdict(NamedTuple):
    """Verdict on both signals after a reading.

    Attributes:
        detected: `SPEED_STUCK`, `BATTERY_STUCK` or None.
        spoilt: the latest spans in which a signal repeated.
    """

    detected: str | None = None
    spoilt: tuple[Spoilt, ...] = ()

    def why_not(self, begin_ns: int, end_ns: int) -> str | None:
        """Reason not to learn from a past span, or None."""
        for reason, first_ns, last_ns in self.spoilt:
            if begin_ns <= last_ns + SETTLES_NS and end_ns >= first_ns - SETTLES_NS:
                return reason
        return None

    def spoiling(self, reason: str, repetition: Repetition) -> Verdict:
        """The verdict with the span of a repetition added, or extended."""
        before, since_ns = self.spoilt, repetition.since_ns
        if before and before[-1][:2] == (reason, since_ns):
            before = before[:-1]
        last = Spoilt(reason, since_ns, repetition.newest_ns)
        return self._replace(spoilt=(*before, last)[-SPOILT_KEPT:])


class VerdictCourse(NamedTuple):
    """Verdicts along a block: the first at its begin, each further one from a stamp on."""

    begin_ns: int
    stamps: list[int]
    verdicts: list[Verdict]

    def at(self, stamp_ns: int) -> Verdict:
        """The verdict after the readings up to a stamp."""
        return self.verdicts[bisect_right(self.stamps, stamp_ns)]

    @property
    def is_quiet(self) -> bool:
        """True if nothing in the block is suspected, nor was lately."""
        return not any(verdict.spoilt for verdict in self.verdicts)


@dataclass(slots=True)
class Repetition:
    """A value that one signal repeats, and the range of the other signal meanwhile."""

    value: Any = None
    since_ns: int = 0
    newest_ns: int = 0
    times: int = 0
    window_ns: int = 0  # begin of the range
    low: float = math.inf
    high: float = -math.inf
    climb: float = 0.0  # largest rise of the other signal
    stuck: bool | None = None
    doubted: bool | None = None

    @property
    def seconds(self) -> float:
        """Duration so far."""
        return (self.newest_ns - self.since_ns) / NANOSECONDS

    def repeat(self, stamp_ns: int) -> None:
        """Count the same value once more."""
        self.newest_ns = max(self.newest_ns, stamp_ns)
        self.times += 1

    def beside(self, stamp_ns: int, other: float) -> None:
        """Add a value of the other signal to the range."""
        if abs(stamp_ns - self.window_ns) > WINDOW_NS:
            self.low, self.high, self.climb, self.window_ns = math.inf, -math.inf, 0.0, stamp_ns
        self.low, self.high = min(self.low, other), max(self.high, other)
        self.climb = max(self.climb, other - self.low)

    def judge(self, by: Hysteresis, swing: float) -> None:
        """Judge by how far the other signal moved."""
        if self.times >= OFTEN:
            self.stuck = by.judge(self.stuck, swing, self.seconds)


class StuckDetector:
    """Detector of a speed or battery that repeats one value while the other changes.

    Attributes:
        verdict: after the newest reading.
    """

    def __init__(self) -> None:
        self.verdict = Verdict()
        self._speed = Repetition()  # with the power meanwhile
        self._battery = Repetition()  # of voltage and current, with the speed meanwhile
        self._step = math.inf  # smallest change of speed seen, m/s

    def follow(self, block: Block) -> VerdictCourse:
        """Take a block in order of stamps; returns the verdicts along it."""
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        with np.errstate(over="ignore"):  # an infinite power is left out
            battery = battery.where(np.isfinite(drawn_power(*battery.values[:2])))
        volts, amperes = battery.values[:2]
        # Robots without a current sensor send 0 A beside a measured voltage.
        drawn = np.stack((drawn_power(volts, amperes), np.where(amperes, volts, 0.0), amperes))
        rows = sorted([*_listed(speeds, speeds.values[:1]), *_listed(battery, drawn)])
        stamps, verdicts = [], [self.verdict]
        for _, stamp_ns, number, *values in rows:
            if values:
                self._take_battery(stamp_ns, number, values)
            else:
                self._take_speed(stamp_ns, number)
            self._judge()
            if self.verdict is not verdicts[-1]:
                stamps.append(stamp_ns)
                verdicts.append(self.verdict)
        return VerdictCourse(rows[0][1] if rows else 0, stamps, verdicts)

    def _take_speed(self, stamp_ns: int, speed: float) -> None:
        self._battery.beside(stamp_ns, speed)
        if speed != self._speed.value or stamp_ns < self._speed.since_ns:
            self._moved(stamp_ns, speed)
            self._speed = Repetition(speed, stamp_ns, stamp_ns, 1, stamp_ns)
            return
        repetition = self._speed
        repetition.repeat(stamp_ns)
        if abs(speed) > MOVING:
            is_coarse = self._step >= FINE
            swing = repetition.high - repetition.low
            repetition.judge(COARSE_SPEED if is_coarse else FINE_SPEED, swing)
            if repetition.times >= OFTEN or not is_coarse:
                doubt = COARSE_DOUBT if is_coarse else FINE_DOUBT
                repetition.doubted = doubt.judge(repetition.doubted, swing, repetition.seconds)

    def _moved(self, stamp_ns: int, speed: float) -> None:
        """Take the step to another speed; a leap shows that the sensor hung before."""
        before = self._speed
        if before.value is None or speed == before.value:
            return
        change = abs(speed - before.value)
        self._step = min(self._step, change)
        gap = (stamp_ns - before.newest_ns) / NANOSECONDS
        limit = max(LEAP, LEAP_STEPS * self._step) + MOST_ACCELERATION * gap
        if before.seconds >= LEAST_HANG and change > limit:
            self.verdict = self.verdict.spoiling(SPEED_REPEATS, before)

    def _take_battery(self, stamp_ns: int, power: float, values: list[float]) -> None:
        self._speed.beside(stamp_ns, power)
        if values != self._battery.value or stamp_ns < self._battery.since_ns:
            self._battery = Repetition(values, stamp_ns, stamp_ns, 1, stamp_ns)
            return
        repetition = self._battery
        repetition.repeat(stamp_ns)
        idle = abs(power) < IDLE_POWER
        swing = repetition.climb if idle else repetition.high - repetition.low
        repetition.judge(BATTERY_REPEATS, swing)

    def _judge(self) -> None:
        """Update the verdict."""
        detected, repetition = None, self._speed
        if self._battery.stuck:
            detected, repetition = BATTERY_STUCK, self._battery
        elif repetition.stuck:
            detected = SPEED_STUCK
        if detected is not self.verdict.detected:
            self.verdict = self.verdict._replace(detected=detected)
        if reason := detected or (SPEED_REPEATS if repetition.doubted else None):
            self.verdict = self.verdict.spoiling(reason, repetition)


def _listed(rows: Rows, values: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """Place, stamp and values of each row."""
    return zip(rows.order.tolist(), rows.stamps.tolist(), *values.tolist(), strict=True)
