"""Readings of a sensor at one moment: the values that enter every core of this package.

Stamps are integer nanoseconds of the moment the car measured the value, never of arrival. Units
are SI (REP-103). `why_impossible` checks ranges; `signals.reorder` sorts readings, and
`signals.power` joins voltage and current.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

NANOSECONDS = 1_000_000_000
DAY_NS = 86_400 * NANOSECONDS
# A drive without a date is placed on this day, 2020-01-01: header stamps must not be zero, and the
# same file must give the same bag.
DRIVE_START_NS = 1_577_836_800 * NANOSECONDS

MOST_STAMP = 2**61  # ns either way: ROS has seconds of 32 bits, and differences must not overflow

# Possible ranges: a reading outside is a fault of its sensor, and dropped.
MAX_SPEED = 100.0  # m/s, no production car
MIN_VOLTAGE = 10.0  # V, below it no traction battery is connected, and there is no power
MAX_VOLTAGE = 2000.0  # V
MAX_CURRENT = 5000.0  # A
MAX_WIND = 60.0  # m/s, a hurricane
GRADE_LIMIT = 0.3  # rad; steeper than any public road, so a fault of the source
TEMPERATURES = (-70.0, 70.0)  # degrees Celsius
SENSOR_STD = 30.0  # W, 1-sigma of measured power near zero: pack sensors of traction batteries
SENSOR_SHARE = 0.01  # 1-sigma as a share of the reading; typical, as no car reports it on its bus

Numbers = TypeVar("Numbers", float, np.ndarray)


def drawn_power(volts: Numbers, amperes: Numbers) -> Numbers:
    """Power drawn from the battery, W (eq. 11), of floats or arrays of one shape.

    The current, A, is negative while the battery discharges.
    """
    drawn: Numbers = -volts * amperes
    return drawn


def sensor_sigma(power: Any, coarse: Any) -> Any:
    """1-sigma of measured power, W; coarse: 1-sigma that a coarse resolution adds, W, or NaN."""
    square = SENSOR_STD**2 + (SENSOR_SHARE * power) ** 2
    return np.sqrt(square + np.where(np.isnan(coarse), 0.0, coarse) ** 2)


def has_position(latitude: Any, longitude: Any) -> Any:
    """Whether latitude and longitude, degrees, are a fix; a receiver without one sends 0, 0."""
    possible = (abs(latitude) <= 90.0) & (abs(longitude) <= 180.0)
    return possible & ((latitude != 0.0) | (longitude != 0.0))


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
    Values that were not measured are NaN. `power_std` is the 1-sigma of power, W, where the source
    has a coarse resolution (whole kW), else NaN.
    """

    stamp_ns: int
    voltage: float
    current: float
    state_of_charge: float = math.nan
    power_std: float = math.nan

    @property
    def power(self) -> float:
        """Power drawn from the battery, W, positive while it discharges."""
        return drawn_power(self.voltage, self.current)


@dataclass(frozen=True, slots=True)
class GradeReading:
    """Road incline angle, rad, positive uphill."""

    stamp_ns: int
    grade: float


@dataclass(frozen=True, slots=True)
class AltitudeReading:
    """Altitude, m, with latitude and longitude of the same fix, degrees, NaN where unknown."""

    stamp_ns: int
    altitude: float
    latitude: float = math.nan
    longitude: float = math.nan

    @property
    def has_position(self) -> bool:
        """Whether latitude and longitude are those of a fix."""
        return bool(has_position(self.latitude, self.longitude))


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
    """Electric power of the auxiliary loads that the car reports, W: heating, and all others."""

    stamp_ns: int
    heating: float
    others: float = 0.0

    @property
    def load(self) -> float:
        """Their total power, W."""
        return self.heating + self.others


@dataclass(frozen=True, slots=True)
class MotorReading:
    """Torque of the car's motors together and their speed, at the motor shaft.

    Inverters compute torque from currents: it is an estimate, commonly a few percent off.

    Attributes:
        stamp_ns: of the measurement.
        torque: N m, positive when it drives the car forward, negative when it brakes.
        speed: rad/s, negative in reverse, NaN where not known.
    """

    stamp_ns: int
    torque: float
    speed: float = math.nan


Reading: TypeAlias = (
    SpeedReading
    | BatteryReading
    | GradeReading
    | AltitudeReading
    | TemperatureReading
    | PressureReading
    | WindReading
    | AuxiliaryReading
    | MotorReading
)


class Bounds(NamedTuple):
    """Range of a field of a reading; `unknown` allows NaN."""

    what: str  # in the reason for which a reading is dropped
    field: str
    least: float
    most: float
    unknown: bool = False


RANGES: Mapping[type[Reading], tuple[Bounds, ...]] = {
    SpeedReading: (Bounds("speed", "speed", -MAX_SPEED, MAX_SPEED),),
    BatteryReading: (
        Bounds("battery", "voltage", MIN_VOLTAGE, MAX_VOLTAGE, unknown=True),
        Bounds("battery", "current", -MAX_CURRENT, MAX_CURRENT, unknown=True),
    ),
    GradeReading: (Bounds("grade", "grade", -GRADE_LIMIT, GRADE_LIMIT),),
    AltitudeReading: (Bounds("altitude", "altitude", -500.0, 9000.0),),  # where roads are
    TemperatureReading: (Bounds("temperature", "celsius", *TEMPERATURES),),
    # From the highest road to fair weather below sea level.
    PressureReading: (Bounds("pressure", "pascal", 30e3, 110e3),),
    WindReading: (Bounds("wind", "head", -MAX_WIND, MAX_WIND),),
    AuxiliaryReading: (
        Bounds("auxiliary", "heating", 0.0, math.inf),
        Bounds("auxiliary", "load", 0.0, 50e3),
    ),
    MotorReading: (
        # More than the axle of any production car; 38,000 rpm, more than any traction motor.
        Bounds("motor_torque", "torque", -20e3, 20e3),
        Bounds("motor_torque", "speed", -4e3, 4e3, unknown=True),
    ),
}


def why_impossible(reading: Reading) -> str | None:
    """Reason why a reading is impossible, or None."""
    if abs(reading.stamp_ns) > MOST_STAMP:
        return "stamp_out_of_range"
    for what, field, least, most, unknown in RANGES[type(reading)]:
        value = getattr(reading, field)
        if not (least <= value <= most or (unknown and math.isnan(value))):
            return f"{what}_out_of_range"
    return None
