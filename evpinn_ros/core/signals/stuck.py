"""A sensor that repeats one value while the other shows that the car does something else.

A speed that is not suspected yet is in doubt, or did hang if it leaps at last. One that goes on as
it was did not: a cruise control keeps a fine speed for seconds, a simulator's driver for minutes,
and between speeding up and slowing down any car does.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
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
    Reading,
    SpeedReading,
    drawn_power,
)

FINE = 0.1  # m/s, a step of finer speeds
OFTEN = 10  # readings of one value before it is suspected
FEW = 8  # readings that are followed one by one: arrays take longer
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

    def course(self, block: Block) -> StuckCourse:
        """The detectors along the readings of a block, in order of stamps.

        They are followed one by one where a value repeats so long, while the other signal moves
        so far, that it may be suspected; else only how the block ends matters.
        """
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        battery = battery.where(np.isfinite(battery.values[0] * battery.values[1]))
        if len(speeds.order) + len(battery.order) <= FEW:
            return self._followed(speeds, battery)
        power = drawn_power(*battery.values[:2])
        # Robots send a current of 0 for want of a sensor, beside a voltage that is measured.
        volts = np.where(battery.values[1] == 0.0, 0.0, battery.values[0])
        moved = _Runs.of(speeds, speeds.values[:1], self.speed, battery.order, power)
        drew = _Runs.of(
            battery, np.stack((volts, battery.values[1])), self.battery, speeds.order,
            speeds.values[0],
        )  # fmt: skip
        if self._may_suspect(moved, drew):
            return self._followed(speeds, battery)
        speed = [v for (v,) in speeds.values[:1, -1:].T.tolist()]
        drawn = [(v, a) if a else (a,) for v, a in battery.values[:2, -1:].T.tolist()]
        detector = replace(
            self,
            speed=_ended(self.speed, moved, speed, battery, power),
            battery=_ended(self.battery, drew, drawn, speeds, speeds.values[0]),
            step=min([self.step, *moved.changes.tolist()]),
        )
        return StuckCourse((), (detector,))

    def _may_suspect(self, moved: _Runs, drew: _Runs) -> bool:
        """True if a repetition in a block could be suspected, or was before it."""
        doubted = (moved.seconds >= FINE_DOUBT.least) & (moved.swing > FINE_DOUBT.on)
        doubted &= np.abs(moved.values[0]) > MOVING
        hung = moved.seconds[:-1] >= LEAST_HANG
        hung &= moved.changes > LEAP + MOST_ACCELERATION * moved.gaps
        stuck = (drew.times >= OFTEN) & (drew.seconds >= BATTERY_REPEATS.least)
        stuck &= drew.swing > BATTERY_REPEATS.on
        if self.detected or self.speed.doubted or doubted.any() or hung.any() or stuck.any():
            return True
        return not (moved.in_order and drew.in_order)

    def _followed(self, speeds: Rows, battery: Rows) -> StuckCourse:
        """The detectors after each of the readings."""
        ends = [int(rows.order[-1]) for rows in (speeds, battery) if len(rows.order)]
        if not ends:
            return StuckCourse((), (self,))
        length = 1 + max(ends)
        block = Block(length, {SpeedReading: speeds, BatteryReading: battery})
        stamps = np.sort(np.concatenate((speeds.stamps, battery.stamps)))
        detectors = accumulate(block.readings(), StuckDetector.after, initial=self)
        return StuckCourse(tuple(stamps.tolist()), tuple(detectors))

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
            is_coarse = self.step >= FINE
            swing = repetition.high - repetition.low
            repetition = repetition.judged(COARSE_SPEED if is_coarse else FINE_SPEED, swing)
            if repetition.times >= OFTEN or not is_coarse:
                doubt = COARSE_DOUBT if is_coarse else FINE_DOUBT
                doubted = doubt.judge(repetition.doubted, swing, repetition.seconds)
                repetition = repetition._replace(doubted=doubted)
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


class StuckCourse(NamedTuple):
    """Detectors along a block: the first from its begin, each further one from a stamp on.

    Where nothing was suspected there is one, of the end.
    """

    stamps: tuple[int, ...]
    detectors: tuple[StuckDetector, ...]

    @property
    def last(self) -> StuckDetector:
        """The detector after the block."""
        return self.detectors[-1]

    def at(self, stamp_ns: int) -> StuckDetector:
        """The detector after the readings up to a stamp."""
        return self.detectors[bisect_right(self.stamps, stamp_ns)]

    def begins_before(self, stamp_ns: int) -> bool:
        """Whether a stamp is not before its readings."""
        return not self.stamps or self.stamps[0] <= stamp_ns

    @property
    def is_quiet(self) -> bool:
        """True if nothing in the block is suspected, nor was lately."""
        return not any(detector.spoilt for detector in self.detectors)


class _Runs(NamedTuple):
    """The m runs of equal values of a signal, the first of which may go on from before.

    Attributes:
        values: of each, shape (k, m).
        order: place of the first reading of each, shape (m,).
        times: readings, shape (m,).
        since: stamp of the first, ns, shape (m,).
        until: stamp of the last, ns, shape (m,).
        swing: of the other signal meanwhile, shape (m,).
        in_order: whether no stamp goes back.
    """

    values: np.ndarray
    order: np.ndarray
    times: np.ndarray
    since: np.ndarray
    until: np.ndarray
    swing: np.ndarray
    in_order: bool

    @classmethod
    def of(
        cls,
        rows: Rows,
        values: np.ndarray,
        before: Repetition,
        other_order: np.ndarray,
        other: np.ndarray,
    ) -> _Runs:
        """Runs of readings, after what repeated before, beside another signal."""
        order, stamps = rows.order, rows.stamps
        if before.times:
            value = np.atleast_1d(before.value)
            value = np.concatenate((np.zeros(len(values) - len(value)), value))
            values = np.column_stack((value, values))
            order, stamps = np.append(-1, order), np.append(before.newest_ns, stamps)
        changed = (np.diff(values) != 0.0).any(axis=0)
        first = np.flatnonzero(np.append(True, changed)) if len(order) else np.empty(0, int)
        last = np.append(first[1:], len(order))[: len(first)] - 1
        begins = np.searchsorted(other_order, order[first])
        ends = np.append(begins[1:], len(other_order))[: len(first)]
        high, low = np.full(len(first), -np.inf), np.full(len(first), np.inf)
        some = np.flatnonzero(ends > begins)
        if len(some):
            high[some] = np.maximum.reduceat(other, begins[some])
            low[some] = np.minimum.reduceat(other, begins[some])
        since, times = stamps[first], last - first + 1
        if before.times:
            since[0], times[0] = before.since_ns, times[0] + before.times - 1
            high[0], low[0] = max(high[0], before.high), min(low[0], before.low)
        in_order = not (np.diff(stamps) < 0).any()
        runs = values[:, first], order[first], times, since, stamps[last], high - low
        return cls(*runs, in_order)

    @property
    def seconds(self) -> np.ndarray:
        """Durations, s."""
        return np.asarray((self.until - self.since) / NANOSECONDS)

    @property
    def changes(self) -> np.ndarray:
        """Size of the steps of the value from one to the next, shape (m - 1,)."""
        return np.asarray(np.abs(np.diff(self.values[0])))

    @property
    def gaps(self) -> np.ndarray:
        """Seconds from the last reading of one to the first of the next, shape (m - 1,)."""
        return np.asarray((self.since[1:] - self.until[:-1]) / NANOSECONDS)


def _ended(
    before: Repetition, runs: _Runs, last: Sequence[Hashable], others: Rows, other: np.ndarray
) -> Repetition:
    """The repetition at the end of a block, whose last value is in a list; none if it has none."""
    repetition, begin = before, -1
    if last and len(runs.order) > bool(before.times) and runs.order[-1] >= 0:
        since_ns, begin = int(runs.since[-1]), int(runs.order[-1])
        times = int(runs.times[-1])
        repetition = Repetition(last[0], since_ns, int(runs.until[-1]), times, since_ns)
    elif last:
        repetition = before._replace(newest_ns=int(runs.until[-1]), times=int(runs.times[-1]))
    after = slice(np.searchsorted(others.order, begin), None)
    for stamp_ns, value in zip(others.stamps[after].tolist(), other[after].tolist(), strict=True):
        repetition = repetition.beside(stamp_ns, value)
    return repetition
