"""The true energy of a simulated drive, part by part, as `estimation.energy_parts` names them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from evpinn_ros.simulation.car import STEP, Car, Trace
from evpinn_ros.vehicle.physics import GRAVITY


def part_powers(car: Car, trace: Trace) -> Mapping[str, np.ndarray]:
    """Power of each part, W, shape (n,): they add up to `trace.power`.

    No load of a simulated car is known as heating or cooling: all of it is standing load.
    Beside the sum stands `regained`, what braking brought back to the battery.
    """
    motion = trace.motion
    driving = trace.wheel_power > 0.0
    inertia = car.mass * car.rotating_mass_factor * motion.acceleration
    brakes = trace.friction_power + np.where(driving, 0.0, trace.load_loss)
    return {
        "air": trace.drag_power,
        "tyres": trace.rolling_power,
        "slope": car.mass * GRAVITY * np.sin(motion.grade) * motion.speed,
        "speed": inertia * motion.speed,
        "brakes": brakes,
        "drivetrain": trace.no_load_loss + np.where(driving, trace.load_loss, 0.0),
        "climate": np.zeros_like(motion.speed),
        "standing": trace.auxiliary,
        "regained": np.where(driving, 0.0, -trace.wheel_power - brakes),
    }


def true_parts(
    car: Car, trace: Trace, spans: Iterable[tuple[float, float]]
) -> Mapping[str, float]:
    """Energy of each part, J, over spans of the drive, each from and to s since its start."""
    begins, ends = np.array(list(spans)).reshape(-1, 2).T / STEP

    def energy(power: np.ndarray) -> float:
        total = np.concatenate(([0.0], np.cumsum(power))) * STEP
        steps = np.arange(len(total))
        return float(np.sum(np.interp(ends, steps, total) - np.interp(begins, steps, total)))

    return {name: energy(power) for name, power in part_powers(car, trace).items()}
