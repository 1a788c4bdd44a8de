"""A simulated car with effects beyond the estimator's model, so that learning it is a real test.

The estimator does not know its loss map, friction brakes, wind, changing load, rolling resistance
that grows with speed, and small errors of inertia and air density.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import (
    RegenForm,
    battery_power,
    drag_force,
    grade_force,
    inertia_force,
    rolling_force,
)
from evpinn_ros.replays.simulation.drive import SAMPLE_RATE, IntervalMotion
from evpinn_ros.replays.simulation.surroundings import Surroundings

CONSTANT_LOSS = 60.0  # W, gate drivers and control of the inverter, while the car moves
IRON_LOSS = 0.25  # W per rad/s, hysteresis and bearings
WINDAGE_LOSS = 3.0e-4  # W per (rad/s)^2, eddy currents, oil and air
COPPER_LOSS = 0.04  # W per (N m)^2, windings
MESH_LOSS = 0.08  # W per W turned over, gears and inverter switching
STANDSTILL = 0.2  # m/s, below which the losses fade out


@dataclass(frozen=True, slots=True)
class Drivetrain:
    """Inverter, motor and single-speed gear as a map of losses over torque and speed."""

    load_scale: float = 1.0  # factor of the losses due to torque, 1
    wheel_radius: float = 0.335  # m
    gear_ratio: float = 9.0  # motor turns per wheel turn

    def no_load_loss(self, speed: np.ndarray) -> np.ndarray:
        """Loss without torque, W, at `speed`, m/s; zero at standstill. Elementwise."""
        turning = self.turning(speed)
        moving = np.clip(speed / STANDSTILL, 0.0, 1.0)
        return np.asarray(
            moving * (CONSTANT_LOSS + IRON_LOSS * turning + WINDAGE_LOSS * turning**2)
        )

    def load_loss(self, force: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Loss due to torque, W, at `force`, N, of either sign, and `speed`, m/s. Elementwise."""
        torque = np.abs(self.torque(force))
        moving = np.clip(speed / STANDSTILL, 0.0, 1.0)
        loss = COPPER_LOSS * torque**2 + MESH_LOSS * torque * self.turning(speed)
        return np.asarray(self.load_scale * moving * loss)

    def torque(self, force: np.ndarray) -> np.ndarray:
        """Torque at the motor shaft, N m, for `force`, N, at the wheels. Elementwise."""
        return np.asarray(force * (self.wheel_radius / self.gear_ratio))

    def turning(self, speed: np.ndarray) -> np.ndarray:
        """Speed of the motor, rad/s, at `speed`, m/s. Elementwise."""
        return np.asarray(speed * (self.gear_ratio / self.wheel_radius))


@dataclass(frozen=True, slots=True)
class Brakes:
    """Split of the braking force between the motor and the friction brakes."""

    # share of the demanded force for the motor, 0..1, before its limits
    motor_share: float = 1.0
    max_power: float = 75e3  # W, largest power of the motor at the wheels
    max_deceleration: float = 1.8  # m/s^2, largest deceleration of the car by the motor
    fade_start: float = 3.0  # m/s, below which the friction brakes begin to take over
    fade_end: float = 1.2  # m/s, below which they do everything

    def motor_force(self, demand: np.ndarray, speed: np.ndarray, mass: float) -> np.ndarray:
        """Braking force of the motor, N, for a demanded force, N, both >= 0, shape (n,)."""
        limit = np.minimum(mass * self.max_deceleration, self.max_power / np.maximum(speed, 1.0))
        fade = np.clip((speed - self.fade_end) / (self.fade_start - self.fade_end), 0.0, 1.0)
        return np.asarray(fade * np.minimum(self.motor_share * demand, limit))


class Terminals(NamedTuple):
    """State of the battery, shape (n,) each: V, A (positive discharging), V, 0..1."""

    voltage: np.ndarray
    current: np.ndarray
    open_circuit: np.ndarray
    state_of_charge: np.ndarray


@dataclass(frozen=True, slots=True)
class Battery:
    """An open-circuit voltage that falls with the charge, and a series resistance."""

    nominal_voltage: float  # V, open-circuit at half charge
    resistance: float  # ohm
    capacity: float  # J between empty and full
    start: float  # state of charge at the start, 0..1

    def deliver(self, power: np.ndarray, step: float) -> Terminals:
        """Deliver `power`, W at the terminals, (n,), for `step` s each; InputError if too much.

        P = V I and V = V_oc - R I hold to rounding; V_oc follows the charge drawn so far.
        """
        most = (0.9 * self.nominal_voltage) ** 2 / (4 * self.resistance)
        if not np.max(power) < most:
            needed = f"{np.max(power) / 1e3:.0f} kW needed, {most / 1e3:.0f} kW available"
            raise InputError(f"the battery of the simulated car is too weak: {needed}")
        charge = np.full_like(power, self.start)
        for _ in range(4):
            open_circuit = self.nominal_voltage * (0.93 + 0.14 * charge)
            root = np.sqrt(open_circuit**2 - 4 * self.resistance * power)
            current = 2 * power / (open_circuit + root)
            drawn = np.cumsum(current) * step / (self.capacity / self.nominal_voltage)
            charge = self.start - drawn
        return Terminals(open_circuit - self.resistance * current, current, open_circuit, charge)


STEP = 1 / SAMPLE_RATE
ROLLING_SPEED = 150.0  # m/s: rolling resistance grows as 1 + (v / ROLLING_SPEED)^2
TORQUE_GAIN_STD = 0.02  # relative 1-sigma of the torque that inverters compute from currents
CELL_RESISTANCE = 0.09  # ohm of a 350 V pack; grows with the square of the voltage


@dataclass(frozen=True, slots=True)
class Car:
    """All properties of one simulated car."""

    mass: float  # with passengers and load, kg
    c_rr: float  # coefficient of rolling resistance near standstill
    c_d: float  # coefficient of drag
    frontal_area: float  # m^2
    air_density: float  # of the day, kg/m^3
    rotating_mass_factor: float  # effective over static mass when accelerating
    mean_auxiliary: float  # mean of the auxiliary load over a drive, W
    drivetrain: Drivetrain  # inverter, motor and gear
    brakes: Brakes  # motor and friction brakes
    battery: Battery  # the pack
    torque_gain: float  # reported over true torque: the inverter only estimates it


@dataclass(frozen=True, slots=True)
class Trace:
    """All true signals of a drive, shape (n,), at the middle of each STEP.

    `power = wheel_power + friction_power + no_load_loss + load_loss + auxiliary` and `wheel_power
    = drag_power + rolling_power + m v (g sin(grade) + factor a)` hold in every interval.
    """

    motion: IntervalMotion  # time, speed, acceleration, elevation and grade
    head_wind: np.ndarray  # m/s
    # W at the wheels, motor and friction brakes together; negative when braking
    wheel_power: np.ndarray
    drag_power: np.ndarray  # W lost to the air (negative when the wind pushes)
    rolling_power: np.ndarray  # W lost in the tyres
    friction_power: np.ndarray  # W turned to heat in the friction brakes, >= 0
    no_load_loss: np.ndarray  # W of loss in the drivetrain without torque, >= 0
    load_loss: np.ndarray  # W of loss in the drivetrain due to torque, >= 0
    auxiliary: np.ndarray  # W of auxiliary load
    power: np.ndarray  # W at the battery's terminals, voltage times current
    voltage: np.ndarray  # V at the terminals
    current: np.ndarray  # A, positive while discharging
    open_circuit: np.ndarray  # V
    state_of_charge: np.ndarray  # 0..1


def draw_car(vehicle: Vehicle, parameters: Parameters, rng: np.random.Generator) -> Car:
    """A random car with this mass, c_rr, c_d and p_aux; `truth.tuned` then fits it to a drive."""
    capacity = vehicle.battery_capacity if vehicle.battery_capacity > 0 else 2.0e8
    return Car(
        mass=parameters.mass,
        c_rr=parameters.c_rr,
        c_d=parameters.c_d,
        frontal_area=vehicle.frontal_area,
        air_density=vehicle.air_density * (1 + 0.01 * rng.standard_normal()),
        rotating_mass_factor=vehicle.rotating_mass_factor + 0.004 * rng.standard_normal(),
        mean_auxiliary=parameters.p_aux,
        drivetrain=Drivetrain(),
        brakes=Brakes(),
        battery=Battery(
            nominal_voltage=vehicle.nominal_voltage,
            resistance=CELL_RESISTANCE * (vehicle.nominal_voltage / 350) ** 2,
            capacity=capacity,
            start=rng.uniform(0.4, 0.9),
        ),
        torque_gain=1 + TORQUE_GAIN_STD * rng.standard_normal(),
    )


def drive_car(car: Car, motion: IntervalMotion, around: Surroundings) -> Trace:
    """All true signals of `car` with this motion."""
    speed = motion.speed
    drag = drag_force(speed + around.head_wind, car.frontal_area * car.c_d, car.air_density)
    rolling = rolling_force(car.mass, car.c_rr * rolling_growth(speed), motion.grade)
    climbing = grade_force(car.mass, motion.grade)
    inertia = inertia_force(car.mass * car.rotating_mass_factor, motion.acceleration)
    wheel = drag + rolling + climbing + inertia
    braking = car.brakes.motor_force(np.maximum(-wheel, 0.0), speed, car.mass)
    motor = np.where(wheel > 0, wheel, -braking)
    no_load_loss = car.drivetrain.no_load_loss(speed)
    load_loss = car.drivetrain.load_loss(motor, speed)
    auxiliary = car.mean_auxiliary * around.auxiliary
    power = motor * speed + no_load_loss + load_loss + auxiliary
    battery = car.battery.deliver(power, STEP)
    return Trace(
        motion=motion,
        head_wind=around.head_wind,
        wheel_power=wheel * speed,
        drag_power=drag * speed,
        rolling_power=rolling * speed,
        friction_power=(motor - wheel) * speed,
        no_load_loss=no_load_loss,
        load_loss=load_loss,
        auxiliary=auxiliary,
        power=power,
        **battery._asdict(),
    )


def rolling_growth(speed: np.ndarray) -> np.ndarray:
    """Factor of rolling resistance at a speed, m/s, relative to standstill. Elementwise."""
    return 1 + (speed / ROLLING_SPEED) ** 2


def equation_car(vehicle: Vehicle, parameters: Parameters, rng: np.random.Generator) -> Car:
    """A car that obeys eq. 21 exactly: the easiest test of a method."""
    car = draw_car(vehicle, parameters, rng)
    return replace(car, air_density=vehicle.air_density, rotating_mass_factor=1.0)


def drive_equation_car(
    car: Car, parameters: Parameters, motion: IntervalMotion, form: RegenForm, beta: float
) -> Trace:
    """All true signals of the car with this motion on a flat road."""
    speed, nothing = motion.speed, np.zeros_like(motion.speed)
    drag = drag_force(speed, car.frontal_area * car.c_d, car.air_density) * speed
    rolling = rolling_force(car.mass, car.c_rr) * speed
    power = battery_power(
        speed,
        motion.acceleration,
        parameters,
        area=car.frontal_area,
        air_density=car.air_density,
        form=form,
        beta=beta,
    )
    wheel = drag + rolling + inertia_force(car.mass, motion.acceleration) * speed
    battery = car.battery.deliver(power, STEP)
    return Trace(
        motion=motion,
        head_wind=nothing,
        wheel_power=wheel,
        drag_power=drag,
        rolling_power=rolling,
        friction_power=nothing,
        no_load_loss=nothing,
        load_loss=power - wheel - parameters.p_aux,
        auxiliary=np.full_like(speed, parameters.p_aux),
        power=power,
        **battery._asdict(),
    )
