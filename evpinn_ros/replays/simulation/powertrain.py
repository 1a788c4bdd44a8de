"""Powertrain of a simulated car, between the wheels and the battery.

None of it is in the estimator's model, which knows one constant efficiency each way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.errors import InputError

CONSTANT_LOSS = 60.0  # W, gate drivers and control of the inverter, while the car moves
IRON_LOSS = 0.25  # W per rad/s, hysteresis and bearings
WINDAGE_LOSS = 3.0e-4  # W per (rad/s)^2, eddy currents, oil and air
COPPER_LOSS = 0.04  # W per (N m)^2, windings
MESH_LOSS = 0.08  # W per W turned over, gears and inverter switching
STANDSTILL = 0.2  # m/s, below this the drivetrain fades out


@dataclass(frozen=True, slots=True)
class Drivetrain:
    """Inverter, motor and single-speed gear as a map of loss over torque and speed."""

    load_scale: float = 1.0  # multiplies the losses that come with torque, 1
    wheel_radius: float = 0.335  # m
    gear_ratio: float = 9.0  # motor turns per wheel turn

    def no_load_loss(self, speed: np.ndarray) -> np.ndarray:
        """Heat of merely turning, W, at `speed`, m/s; zero at standstill. Elementwise."""
        turning = self.turning(speed)
        moving = np.clip(speed / STANDSTILL, 0.0, 1.0)
        return np.asarray(
            moving * (CONSTANT_LOSS + IRON_LOSS * turning + WINDAGE_LOSS * turning**2)
        )

    def load_loss(self, force: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Heat, W, of driving (or braking) the wheels with `force`, N, at `speed`, m/s.

        Elementwise, the same for either sign of the force, zero at standstill.
        """
        torque = np.abs(self.torque(force))
        moving = np.clip(speed / STANDSTILL, 0.0, 1.0)
        loss = COPPER_LOSS * torque**2 + MESH_LOSS * torque * self.turning(speed)
        return np.asarray(self.load_scale * moving * loss)

    def torque(self, force: np.ndarray) -> np.ndarray:
        """Torque at the motor shaft, N m, that drives the wheels with `force`, N. Elementwise."""
        return np.asarray(force * (self.wheel_radius / self.gear_ratio))

    def turning(self, speed: np.ndarray) -> np.ndarray:
        """Speed of the motor, rad/s, at `speed`, m/s. Elementwise."""
        return np.asarray(speed * (self.gear_ratio / self.wheel_radius))


@dataclass(frozen=True, slots=True)
class Brakes:
    """Sharing of a demand to brake between the motor and the friction brakes."""

    # share of the demand offered to the motor, 0..1; the limits come after
    motor_share: float = 1.0
    max_power: float = 75e3  # W at the wheels that the motor may recover
    max_deceleration: float = 1.8  # m/s^2 that the motor may make of the car's mass
    fade_start: float = 3.0  # m/s, below this the friction brakes begin to take over
    fade_end: float = 1.2  # m/s, below this they do all

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
    """Open-circuit voltage that falls with the charge, behind a resistance."""

    nominal_voltage: float  # V, open-circuit at half charge
    resistance: float  # ohm
    capacity: float  # J between empty and full
    start: float  # state of charge at the start, 0..1

    def deliver(self, power: np.ndarray, step: float) -> Terminals:
        """Deliver `power`, W at the terminals, shape (n,), for `step` s each.

        P = V I and V = V_oc - R I hold to rounding; V_oc follows the charge drawn so far, found
        by substitution, as it hardly moves while one interval passes.

        Raises:
            InputError: the battery cannot deliver as much.
        """
        most = (0.9 * self.nominal_voltage) ** 2 / (4 * self.resistance)
        if not np.max(power) < most:
            asked = f"{np.max(power) / 1e3:.0f} kW asked, {most / 1e3:.0f} kW is the most"
            raise InputError(f"the battery of the simulated car is too weak: {asked}")
        charge = np.full_like(power, self.start)
        for _ in range(4):
            open_circuit = self.nominal_voltage * (0.93 + 0.14 * charge)
            root = np.sqrt(open_circuit**2 - 4 * self.resistance * power)
            current = 2 * power / (open_circuit + root)
            drawn = np.cumsum(current) * step / (self.capacity / self.nominal_voltage)
            charge = self.start - drawn
        return Terminals(open_circuit - self.resistance * current, current, open_circuit, charge)
