"""Ranges of what can be: a reading beyond is a fault of its sensor, and dropped."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

from evpinn_ros.signals.readings import (
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    GradeReading,
    MotorReading,
    PressureReading,
    Reading,
    SpeedReading,
    TemperatureReading,
    WindReading,
)

MAX_SPEED = 100.0  # m/s, no production car
MIN_VOLTAGE = 10.0  # V, below it no traction battery is connected, and there is no power
MAX_VOLTAGE = 2000.0  # V
MAX_CURRENT = 5000.0  # A
MAX_TORQUE = 20_000.0  # N m, more than the axle of any production car
MAX_MOTOR_SPEED = 4_000.0  # rad/s, 38,000 rpm, faster than any traction motor turns
MAX_AUXILIARY = 50_000.0  # W
MAX_WIND = 60.0  # m/s, a hurricane
GRADE_LIMIT = 0.3  # rad; steeper than any public road, so a fault of the source
ALTITUDES = (-500.0, 9000.0)  # m, where roads are
PRESSURES = (30e3, 110e3)  # Pa, from the highest road to a fair day below the sea
TEMPERATURES = (-70.0, 70.0)  # degrees Celsius


class Bounds(NamedTuple):
    """Least and most of a quantity, and whether NaN, unknown, is as good."""

    least: float
    most: float
    unknown: bool = False


RANGES: Mapping[type[Reading], tuple[str, Mapping[str, Bounds]]] = {
    SpeedReading: ("speed", {"speed": Bounds(-MAX_SPEED, MAX_SPEED)}),
    BatteryReading: (
        "battery",
        {
            "voltage": Bounds(MIN_VOLTAGE, MAX_VOLTAGE, unknown=True),
            "current": Bounds(-MAX_CURRENT, MAX_CURRENT, unknown=True),
        },
    ),
    GradeReading: ("grade", {"grade": Bounds(-GRADE_LIMIT, GRADE_LIMIT)}),
    AltitudeReading: ("altitude", {"altitude": Bounds(*ALTITUDES)}),
    TemperatureReading: ("temperature", {"celsius": Bounds(*TEMPERATURES)}),
    PressureReading: ("pressure", {"pascal": Bounds(*PRESSURES)}),
    WindReading: ("wind", {"head": Bounds(-MAX_WIND, MAX_WIND)}),
    AuxiliaryReading: (
        "auxiliary",
        {"heating": Bounds(0.0, math.inf), "load": Bounds(0.0, MAX_AUXILIARY)},
    ),
    MotorReading: (
        "motor_torque",
        {
            "torque": Bounds(-MAX_TORQUE, MAX_TORQUE),
            "speed": Bounds(-MAX_MOTOR_SPEED, MAX_MOTOR_SPEED, unknown=True),
        },
    ),
}


def why_impossible(reading: Reading) -> str | None:
    """Reason why a reading is impossible, or None."""
    what, limits = RANGES[type(reading)]
    for name, (least, most, unknown) in limits.items():
        value = getattr(reading, name)
        if not (least <= value <= most or (unknown and math.isnan(value))):
            return f"{what}_out_of_range"
    return None
