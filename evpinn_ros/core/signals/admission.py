"""Decides which readings of a car count anywhere: a refused one is in no total and no score.

Four kinds are refused: what no sensor of a road vehicle reads (`readings.RANGES`), what this car
cannot do (`CarLimits`), values that a bus sends in place of a measurement (`SENTINELS`), and
speeds that leap. A second reading confirms a speed that leapt; a repeated sentinel does not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import Block, impossible
from evpinn_ros.core.signals.kinematics import LEAST_LEAP
from evpinn_ros.core.signals.readings import (
    MAX_CURRENT,
    MAX_VOLTAGE,
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    drawn_power,
    why_impossible,
)
from evpinn_ros.core.vehicle.files import Vehicle

# More than any charger gives or car draws: CharIN's Megawatt Charging System ends at 1250 V and
# 3000 A; the strongest cars drive with 1.6 MW.
MAX_POWER = 4e6  # W
SPECIFIC_POWER = 400.0  # W/kg; the strongest road cars have 390
VOLTAGES = 3.0  # times the nominal one, which files of certified cars only guess
CURRENTS = 1.2  # times the most power over the nominal voltage, because voltage sags
# Magnitudes of all bits set, or the sign bit alone, of the widths that buses use, at their decimal
# resolutions.
SENTINELS = frozenset(
    round(integer * resolution, 3)
    for bits in (8, 10, 11, 12, 13, 14, 15, 16)
    for integer in ((1 << bits) - 1, 1 << (bits - 1))
    for resolution in (1.0, 0.1, 0.01, 0.001)
)
HARDEST = 10.0  # m/s^2, of braking on a dry road; a faster change waits for a second reading
SPEED_UNITS = (1.0, 3.6, 3600.0 / 1609.344)  # of a bus: m/s, km/h, mph
LEAST_SENTINEL = 100.0  # A; smaller currents, and smaller changes of current, are no sentinels
VOLTAGE_LEAP = 0.25  # share of the last voltage by which a sentinel differs from it


class CarLimits(NamedTuple):
    """Largest power, W, voltage, V, and current, A, of a car's battery."""

    power: float = MAX_POWER
    voltage: float = MAX_VOLTAGE
    current: float = MAX_CURRENT

    @classmethod
    def of(cls, vehicle: Vehicle) -> CarLimits:
        """Limits of the car of a vehicle file, by its mass and nominal voltage."""
        power = min(SPECIFIC_POWER * vehicle.initial.mass, MAX_POWER)
        current = CURRENTS * power / vehicle.nominal_voltage
        voltage = VOLTAGES * vehicle.nominal_voltage
        return cls(power, min(voltage, MAX_VOLTAGE), min(current, MAX_CURRENT))

    def allow(self, voltage: Any, current: Any) -> Any:
        """True where voltage, V, current, A, and their power are within the limits, or NaN."""
        beyond = abs(drawn_power(voltage, current)) > self.power
        beyond |= (abs(voltage) > self.voltage) | (abs(current) > self.current)
        return np.logical_not(beyond)


ANY_CAR = CarLimits()


class Admission:
    """Admits the readings of one car, in the order in which they come.

    Attributes:
        refused: readings, by reason.
    """

    def __init__(self, limits: CarLimits = ANY_CAR) -> None:
        self.limits = limits
        self.refused: Counter[str] = Counter()
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget the last readings, after a jump of time."""
        self._speed: tuple[int, float] | None = None  # stamp, ns, and speed
        self._leapt: tuple[int, float] | None = None  # refused until a second one confirms it
        self._voltage = self._current = math.nan

    def admits(self, reading: Reading) -> bool:
        """True if a reading counts."""
        reason = why_impossible(reading)
        if reason is None and isinstance(reading, SpeedReading):
            reason = self._why_not_speed(reading.stamp_ns, reading.speed)
        elif reason is None and isinstance(reading, BatteryReading):
            reason = self._why_not_battery(reading.voltage, reading.current)
        if reason is not None:
            self.refused[reason] += 1
        return reason is None

    def admit(self, block: Block) -> Block:
        """The readings of a block that count, as `admits` decides."""
        chosen = {}
        for kind, rows in block.rows.items():
            counts = np.ones(len(rows.order), dtype=bool)
            for reason, wrong in impossible(kind, rows):
                self.refused[reason] += int(wrong.sum())
                counts[wrong] = False
            if kind is SpeedReading:
                self._refuse(counts, self._why_not_speed, rows.stamps, rows.values[0])
            elif kind is BatteryReading:
                self._refuse(counts, self._why_not_battery, *rows.values[:2])
            chosen[kind] = counts
        return block.only(chosen)

    def _refuse(
        self, counts: np.ndarray, why_not: Callable[..., str | None], *columns: np.ndarray
    ) -> None:
        """Clear `counts`, shape (n,), of rows with a reason by `why_not`; count the reasons."""
        rows = [*zip(*(column.tolist() for column in columns), strict=True)]
        for index in np.flatnonzero(counts).tolist():
            if (reason := why_not(*rows[index])) is not None:
                self.refused[reason] += 1
                counts[index] = False

    def _why_not_speed(self, stamp_ns: int, speed: float) -> str | None:
        leapt, self._leapt = self._leapt, None
        now = stamp_ns, speed
        again = leapt is not None and speed == leapt[1]
        if not again and (self._speed is None or not _leaps(*self._speed, *now)):
            self._speed = now
            return None
        names = (_sentinel(speed * unit) for unit in SPEED_UNITS)
        name = next((name for name in names if name is not None), None)
        if name is None and leapt is not None and not _leaps(*leapt, *now):
            self._speed = now
            return None
        self._leapt = now
        return "speed_leaps" if name is None else f"speed_sentinel_{name}"

    def _why_not_battery(self, voltage: float, current: float) -> str | None:
        if not self.limits.allow(voltage, current):
            return "battery_beyond_car"
        leap = abs(voltage - self._voltage) > VOLTAGE_LEAP * self._voltage
        if leap and (name := _sentinel(voltage)) is not None:
            return f"voltage_sentinel_{name}"
        leap = min(abs(current), abs(current - self._current)) > LEAST_SENTINEL
        if leap and (name := _sentinel(current)) is not None:
            return f"current_sentinel_{name}"
        self._voltage = self._voltage if math.isnan(voltage) else voltage
        self._current = self._current if math.isnan(current) else current
        return None


def _leaps(before_ns: int, before: float, after_ns: int, after: float) -> bool:
    """True if speed changed by more than tyres can between two readings, of stamps in ns."""
    seconds = abs(after_ns - before_ns) / NANOSECONDS
    return abs(after - before) > LEAST_LEAP + HARDEST * seconds


def _sentinel(value: float) -> str | None:
    """The value as text if it is one of `SENTINELS`, else None."""
    rounded = round(value, 3)
    return f"{rounded:g}" if abs(value - rounded) < 1e-6 and abs(rounded) in SENTINELS else None
