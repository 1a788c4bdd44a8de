"""One moment of driving, as the learners see it."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import TypeAlias

from evpinn_ros.core.signals.interval import Interval


@dataclass(frozen=True, slots=True)
class Sample:
    """The state of the car at one moment, everything but the battery.

    Attributes:
        stamp_ns: the moment.
        speed: m/s.
        acceleration: m/s^2.
        grade: road incline angle, rad, positive uphill; 0 while unknown.
        air_density: kg/m^3.
        known_auxiliary: power of auxiliary loads the car reports, W; 0 while unknown.
        profile: its acceleration profile as far as it is known, shape (`kinematics.PROFILE`,),
            m/s^2; empty where nothing of it is.
        head_wind: wind against the car, m/s over ground; 0 while unknown.
        celsius: temperature of the air outside, None while unknown.
        doubted_load: heating that the car reports on a warm day, W, which is often not drawn.
        motor_power: mechanical power of the motor, W, NaN where no bus reports it.
        motor_scaled: whether that is in W; else up to a factor, for the gear is not known.
        newest: whether it is the newest moment, whose acceleration is causal (`power/predicted`);
            else it lies `smoothing_lag` back and is smoothed (`power/smoothed`).
    """

    stamp_ns: int
    speed: float
    acceleration: float
    grade: float
    air_density: float
    known_auxiliary: float
    profile: tuple[float, ...] = ()
    head_wind: float = 0.0
    celsius: float | None = None
    doubted_load: float = 0.0
    motor_power: float = math.nan
    motor_scaled: bool = True
    newest: bool = False


@dataclass(frozen=True, slots=True)
class MeasuredSample:
    """A smoothed sample and the battery power, W, measured at its moment: to learn from."""

    sample: Sample
    power: float


StreamEvent: TypeAlias = Sample | MeasuredSample | Interval
