"""Decides which readings of a car count anywhere: a refused one is in no total and no score.

Three kinds are refused: what no sensor of a road vehicle reads (`readings.RANGES`), what this car
cannot do (`CarLimits`), and values that a bus sends in place of a measurement (`SENTINELS`) or
that leap as no car does. A speed that leaps counts again once a second reading confirms it.
"""

from __future__ import annotations

from collections import Counter
import math
from typing import NamedTuple

from evpinn_ros.core.signals.kinematics import LEAST_LEAP
from evpinn_ros.core.signals.readings import (
    MAX_CURRENT,
    MAX_VOLTAGE,
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    why_impossible,
)
from evpinn_ros.core.vehicle.files import Vehicle

# More than any road vehicle is charged with, and so than any draws: CharIN's Megawatt Charging
# System ends at 1250 V and 3000 A; the strongest cars drive with 1.6 MW.
MAX_POWER = 4e6  # W
SPECIFIC_POWER = 400.0  # W/kg; the strongest road cars have 390
VOLTAGES = 3.0  # times the nominal one, which files of certified cars only guess
CURRENTS = 1.2  # times that of the most power at the nominal voltage: a battery sags
# Magnitudes of all bits set, or the sign bit alone, of the widths that buses use, at their decimal
# resolutions.
SENTINELS = frozenset(
    round(integer * resolution, 3)
    for bits in (8, 10, 11, 12, 13, 14, 15, 16)
    for integer in ((1 << bits) - 1, 1 << (bits - 1))
    for resolution in (1.0, 0.1, 0.01, 0.001)
)
HARDEST = 10.0  # m/s^2, of braking on a dry road; what is beyond waits for a second reading
SPEED_UNITS = (1.0, 3.6, 3600.0 / 1609.344)  # of a bus: m/s, km/h, mph
LEAST_SENTINEL = 100.0  # A, and by which the current leaps: a car also has smaller ones in earnest
VOLTAGE_LEAP = 0.25  # of the last voltage, by which a sentinel differs from it


class CarLimits(NamedTuple):
    """Most that battery and motor of a car can give or take: W, V and A."""

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

    def allow(self, reading: BatteryReading) -> bool:
        """True if the car can do what a battery reading says; NaN is unknown, and allowed."""
        values = reading.power, reading.voltage, reading.current
        return not any(abs(value) > most for value, most in zip(values, self, strict=True))


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
        """Compare the next readings with none before: time jumped."""
        self._speed: SpeedReading | None = None
        self._leapt: SpeedReading | None = None  # refused until a second one confirms it
        self._voltage = self._current = math.nan

    def admits(self, reading: Reading) -> bool:
        """True if a reading counts."""
        reason = self._why_refused(reading)
        if reason is not None:
            self.refused[reason] += 1
        return reason is None

    def _why_refused(self, reading: Reading) -> str | None:
        reason = why_impossible(reading)
        if isinstance(reading, SpeedReading):
            return reason or self._why_not_speed(reading)
        if isinstance(reading, BatteryReading):
            return reason or self._why_not_battery(reading)
        return reason

    def _why_not_speed(self, reading: SpeedReading) -> str | None:
        near = [self._speed, self._leapt]
        self._leapt = None
        if any(other is not None and not _leaps(other, reading) for other in near):
            self._speed = reading
            return None
        if self._speed is None:
            self._speed = reading
            return None
        self._leapt = reading
        for unit in SPEED_UNITS:
            if (name := _sentinel(reading.speed * unit)) is not None:
                return f"speed_sentinel_{name}"
        return "speed_leaps"

    def _why_not_battery(self, reading: BatteryReading) -> str | None:
        if not self.limits.allow(reading):
            return "battery_beyond_car"
        voltage, current = reading.voltage, reading.current
        leap = abs(voltage - self._voltage) > VOLTAGE_LEAP * self._voltage
        if leap and (name := _sentinel(voltage)) is not None:
            return f"voltage_sentinel_{name}"
        leap = min(abs(current), abs(current - self._current)) > LEAST_SENTINEL
        if leap and (name := _sentinel(current)) is not None:
            return f"current_sentinel_{name}"
        self._voltage = self._voltage if math.isnan(voltage) else voltage
        self._current = self._current if math.isnan(current) else current
        return None


def _leaps(before: SpeedReading, after: SpeedReading) -> bool:
    """True if speed changed by more than tyres can between two readings."""
    seconds = abs(after.stamp_ns - before.stamp_ns) / NANOSECONDS
    return abs(after.speed - before.speed) > LEAST_LEAP + HARDEST * seconds


def _sentinel(value: float) -> str | None:
    """The value as it is written, if a bus sends it in place of a measurement."""
    rounded = round(value, 3)
    return f"{rounded:g}" if abs(value - rounded) < 1e-6 and abs(rounded) in SENTINELS else None
