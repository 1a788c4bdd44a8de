"""What a sensor said at one moment: the values that enter every core of this package.

Stamps are integer nanoseconds of the moment the car measured the value, never of arrival. Units
are SI (REP-103). A reading holds no policy: range checks belong to whoever made it, ordering and
pairing to `evpinn_ros.signals.stream`.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import TypeAlias

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class SpeedReading:
    """Forward speed, m/s (negative in reverse), and its variance, (m/s)^2, NaN if unknown."""

    stamp_ns: int
    speed: float
    variance: float = math.nan


@dataclass(frozen=True, slots=True)
class BatteryReading:
    """Pack voltage, V, and current, A, of one moment, and state of charge, 0..1.

    The current has the sign of `sensor_msgs/BatteryState`: negative while the pack discharges.
    What was not measured is NaN.
    """

    stamp_ns: int
    voltage: float
    current: float
    state_of_charge: float = math.nan

    @property
    def power(self) -> float:
        """Power drawn from the battery, W, positive while it discharges (eq. 11)."""
        return -self.voltage * self.current


@dataclass(frozen=True, slots=True)
class GradeReading:
    """Road incline angle, rad, positive uphill."""

    stamp_ns: int
    grade: float


@dataclass(frozen=True, slots=True)
class AltitudeReading:
    """Altitude, m."""

    stamp_ns: int
    altitude: float


@dataclass(frozen=True, slots=True)
class TemperatureReading:
    """Ambient air temperature, degrees Celsius."""

    stamp_ns: int
    celsius: float


@dataclass(frozen=True, slots=True)
class PressureReading:
    """Pressure of the ambient air, Pa."""

    stamp_ns: int
    pascal: float


@dataclass(frozen=True, slots=True)
class WindReading:
    """Wind against the car, m/s over ground; negative from behind."""

    stamp_ns: int
    head: float


@dataclass(frozen=True, slots=True)
class AuxiliaryReading:
    """Electric power of known auxiliary loads, W: of the heating, and of all others together."""

    stamp_ns: int
    heating: float
    others: float = 0.0


Reading: TypeAlias = (
    SpeedReading
    | BatteryReading
    | GradeReading
    | AltitudeReading
    | TemperatureReading
    | PressureReading
    | WindReading
    | AuxiliaryReading
)
