"""Makes steps of driving from readings, for all baselines.

A step lies between two neighbouring speeds. Kinetic energy is an exact difference, so no
derivative is taken; only fast speed is averaged, over seven samples. A step gets its power once
voltage and current are known on both sides of it, each from its own stamps.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
import math

import numpy as np

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    drawn_power,
    why_impossible,
)
from evpinn_ros.core.signals.road import GradeSource, Road
from evpinn_ros.core.vehicle.files import Vehicle

SMOOTHED = 7  # speeds whose mean is taken: 0.3 s to either side at 10 Hz; best of 3 to 15
HALF = SMOOTHED // 2
SMOOTHED_BELOW = 0.25  # s between speeds
LEAST_STEP = 0.095  # s; faster speeds are left out
MAX_STEP, MAX_SPEED = 30.0, 100.0  # s, m/s
KEPT = 4000  # battery samples
NO_PLACES = np.empty(0)


@dataclass(frozen=True, slots=True)
class DrivingStep:
    """Driving between two moments; means over it."""

    begin_ns: int  # where it begins
    end_ns: int  # where it ends
    speed: float  # m/s
    cube: float  # of speed, m^3/s^3
    kinetic: float  # growth of v^2 / 2 per second, W/kg
    climb: float  # growth of height, m/s
    grade: float  # rad
    density: float  # of the air, kg/m^3
    known: float  # auxiliary power that the car reports, W
    celsius: float | None  # outside, None while unknown
    power: float = math.nan  # of the battery, W, NaN while unknown

    @property
    def dt(self) -> float:
        """Length, s."""
        return (self.end_ns - self.begin_ns) / NANOSECONDS

    @property
    def middle_ns(self) -> int:
        """Stamp of its middle."""
        return (self.begin_ns + self.end_ns) // 2


class StepStream:
    """Makes steps from readings, first without power and, once it is known, again with it."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._road = Road(GradeSource.AUTO, vehicle.air_density)
        self.begin_next_drive()

    def begin_next_drive(self) -> None:
        """Join nothing to what was before."""
        self._road.forget()
        self._speeds: deque[tuple[int, float]] = deque(maxlen=SMOOTHED)
        self._last: tuple[int, float] | None = None
        self._volts, self._amperes = _Signal(), _Signal()
        self._waiting: deque[DrivingStep] = deque(maxlen=KEPT)

    def add_reading(self, reading: Reading) -> Iterator[DrivingStep]:
        """Take a reading; yields steps to predict, and steps to learn from."""
        if isinstance(reading, SpeedReading):
            yield from self._add_speed(reading)
        elif isinstance(reading, BatteryReading):
            self._volts.add(reading.stamp_ns, reading.voltage)
            self._amperes.add(reading.stamp_ns, reading.current)
            yield from self._measured()
        elif why_impossible(reading) is None:
            self._road.extend(Block.of([reading]), NO_PLACES, NO_PLACES)
            self._road.forget_before(reading.stamp_ns)

    def _add_speed(self, reading: SpeedReading) -> Iterator[DrivingStep]:
        newest = self._speeds[-1][0] if self._speeds else -math.inf
        since = (reading.stamp_ns - newest) / NANOSECONDS
        if not abs(reading.speed) <= MAX_SPEED or since < LEAST_STEP:
            return
        if since > MAX_STEP:
            self._speeds.clear()
            self._last = None
        else:
            moved = np.array([reading.stamp_ns]), np.array([abs(reading.speed) * since])
            self._road.extend(Block.of([]), *moved)
        self._speeds.append((reading.stamp_ns, reading.speed))
        if (now := self._smoothed()) is None:
            return
        before = self._last
        if before is not None and now[0] <= before[0]:
            return  # the signal became faster: the smoothed moment is not newer
        self._last = now
        if before is not None:
            step = self._step(before, now)
            self._waiting.append(step)
            yield step
            yield from self._measured()

    def _smoothed(self) -> tuple[int, float] | None:
        """Newest moment with a known speed; half a window back for fast signals."""
        speeds = self._speeds
        span = (speeds[-1][0] - speeds[0][0]) / NANOSECONDS
        if len(speeds) > 1 and span / (len(speeds) - 1) > SMOOTHED_BELOW:
            return speeds[-1]
        if len(speeds) < SMOOTHED:
            return None
        return speeds[HALF][0], sum(speed for _, speed in speeds) / SMOOTHED

    def _step(self, before: tuple[int, float], now: tuple[int, float]) -> DrivingStep:
        (begin, u), (end, v) = before, now
        at = np.array([end])
        (grade,), around = self._road.grades(at).tolist(), self._road.conditions(at)
        mean = (u + v) / 2
        return DrivingStep(
            begin,
            end,
            speed=mean,
            cube=(u + v) * (u * u + v * v) / 4,
            kinetic=(v * v - u * u) / 2 * NANOSECONDS / (end - begin),
            climb=mean * math.sin(grade),
            grade=grade,
            density=float(around.air_density[0]),
            known=float(around.load[0]),
            celsius=None if np.isnan(around.celsius[0]) else float(around.celsius[0]),
        )

    def _measured(self) -> Iterator[DrivingStep]:
        """Steps that voltage and current have passed."""
        passed = min(self._volts.newest, self._amperes.newest)
        while self._waiting and self._waiting[0].end_ns <= passed:
            step = self._waiting.popleft()
            middle, ends = step.middle_ns, (step.begin_ns, step.end_ns)
            mean = (4 * self._power(middle) + sum(map(self._power, ends))) / 6  # Simpson
            if not math.isnan(mean):
                yield replace(step, power=mean)

    def _power(self, stamp_ns: int) -> float:
        return drawn_power(self._volts.at(stamp_ns), self._amperes.at(stamp_ns))


class _Signal:
    """Samples of one signal, straight between them."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._values: list[float] = []

    @property
    def newest(self) -> float:
        """Newest stamp, -inf before the first."""
        return self._stamps[-1] if self._stamps else -math.inf

    def add(self, stamp_ns: int, value: float) -> None:
        """Take a sample; what is not finite or not newer is left out."""
        if not math.isfinite(value) or stamp_ns <= self.newest:
            return
        self._stamps.append(stamp_ns)
        self._values.append(value)
        if len(self._stamps) > 2 * KEPT:
            del self._stamps[:KEPT], self._values[:KEPT]

    def at(self, stamp_ns: int) -> float:
        """Value at a stamp, NaN where unknown."""
        after = bisect_left(self._stamps, stamp_ns)
        if after < len(self._stamps) and self._stamps[after] == stamp_ns:
            return self._values[after]
        if not 0 < after < len(self._stamps):
            return math.nan
        begin, end = self._stamps[after - 1], self._stamps[after]
        if end - begin > MAX_STEP * NANOSECONDS:
            return math.nan
        share = (stamp_ns - begin) / (end - begin)
        return (1 - share) * self._values[after - 1] + share * self._values[after]
