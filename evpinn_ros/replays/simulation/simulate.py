"""A drive with known truth, from one seed: sensor readings and true signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError, known_names
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import identifiable
from evpinn_ros.core.vehicle.parameters import LIMITS, Parameters
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.replays.simulation.car import (
    Car,
    Trace,
    draw_car,
    drive_car,
    drive_equation_car,
    equation_car,
)
from evpinn_ros.replays.simulation.drive import (
    SAMPLE_RATE,
    DriveKind,
    drive_speed,
    hilly_road,
    motion_on,
)
from evpinn_ros.replays.simulation.sensors import altitudes, motor_readings, sense, temperatures
from evpinn_ros.replays.simulation.surroundings import ambient_celsius, draw_surroundings
from evpinn_ros.replays.simulation.truth import Truth, plausible_parameters, true_values, tuned

EPOCH_NS = 1_735_689_600 * NANOSECONDS
"""Every simulated drive starts on 2025-01-01 at 00:00:00 UTC unless given otherwise."""

RMS_GRADE = 0.005
"""Gentle hills, up to about 1.5 percent."""


@dataclass(frozen=True, slots=True)
class SimulatedDrive:
    """A simulated drive: its readings, and the truth behind them."""

    vehicle: Vehicle  # the model in the vehicle file, all that an estimator may know
    kind: DriveKind  # kind of road
    seed: int  # of all random values
    frames: tuple[CanFrame, ...]  # in the CAN log, in order of time
    # decoded from the frames, and of the optional sensors, in order of time
    readings: tuple[Reading, ...]
    car: Car  # the simulated car; `simulate` can drive it again
    trace: Trace  # every true signal at 100 Hz
    truth: Truth  # the true parameters, as `truth` defines them
    # the form of eq. 21 that the car obeys, None for a car with a map of losses
    equation: RegenForm | None = None

    @property
    def duration_s(self) -> float:
        """Length of the drive, s."""
        return len(self.trace.power) / SAMPLE_RATE


def simulate(
    kind: DriveKind,
    vehicle: Vehicle,
    duration_s: float,
    seed: int,
    *,
    car: Car | Mapping[str, float] | None = None,
    rms_grade: float = RMS_GRADE,
    can_profile: str | None = None,
    altitude: bool = False,
    temperature: bool = False,
    motor_torque: bool = False,
    start_ns: int = EPOCH_NS,
    equation: RegenForm | None = None,
) -> SimulatedDrive:
    """Drive a car; the same arguments give the same drive.

    `car`: the car of an earlier drive, or true parameters by name; others are random by the seed.
    `rms_grade`: root mean square slope. `altitude`, `temperature`, `motor_torque`: whether the car
    has these sensors. `equation`: the car obeys this form of eq. 21 exactly, on a flat road.

    Raises:
        InputError: an argument is out of range, or the vehicle or profile does not support it.
    """
    if vehicle.relative_size != 1.0:
        raise InputError(
            f"vehicle '{vehicle.key}' is not a passenger car; only those are simulated"
        )
    profile_name = can_profile or vehicle.can_profile
    if profile_name is None:
        raise InputError(f"vehicle '{vehicle.key}' has no CAN profile: name one (--can-profile)")
    profile = load_profile(profile_name)
    streams = np.random.SeedSequence(seed).spawn(6)
    route, hills, weather, factory, sensors, inverter = (np.random.default_rng(s) for s in streams)
    steepness = rms_grade if equation is None else 0.0
    motion = motion_on(hilly_road(steepness, hills), drive_speed(kind, duration_s, route))
    around = draw_surroundings(motion.time, weather)
    if equation is not None:
        if isinstance(car, Car):
            raise InputError("the car of an earlier drive has a loss map and does not obey eq. 21")
        parameters = _wish(vehicle, car or {}, factory)
        car = equation_car(vehicle, parameters, factory)
        trace = drive_equation_car(car, parameters, motion, equation, vehicle.beta)
        truth = Truth(parameters, identifiable(parameters, car.frontal_area))
    else:
        definition = equation_of(vehicle)
        if not isinstance(car, Car):
            wish = _wish(vehicle, car or {}, factory)
            car = tuned(draw_car(vehicle, wish, factory), motion, around, wish, definition)
        trace = drive_car(car, motion, around)
        truth = true_values(car, trace, definition)
    motors = motor_readings(trace, car, start_ns, inverter) if motor_torque else []
    sensed = sense(trace, profile, start_ns, sensors, motors)
    extra = altitudes(trace, start_ns, sensors) if altitude else []
    if temperature:
        extra += temperatures(trace, ambient_celsius(car.air_density), start_ns, sensors)
    readings = sorted((*sensed.readings, *extra), key=attrgetter("stamp_ns"))
    return SimulatedDrive(
        vehicle, kind, seed, sensed.frames, tuple(readings), car, trace, truth, equation
    )


def _wish(vehicle: Vehicle, named: Mapping[str, float], rng: np.random.Generator) -> Parameters:
    """Random plausible parameters, with the named ones at their given values."""
    for name, value in named.items():
        if name not in LIMITS:
            raise InputError(f"no parameter '{name}'{known_names(name, LIMITS)}")
        if not LIMITS[name].lower <= value <= LIMITS[name].upper:
            lower, upper = LIMITS[name]
            raise InputError(f"{name} = {value:g} is outside [{lower:g}, {upper:g}]")
    return plausible_parameters(vehicle, rng)._replace(**named)
