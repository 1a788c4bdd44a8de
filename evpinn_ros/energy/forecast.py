"""The energy that a plan will take, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from evpinn_ros.energy.plan import Plan
from evpinn_ros.energy.uncertainty import CORRELATION_TIME, energy_sigma
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import IDENTIFIABLE_NAMES, Identifiable, combined_power

SIMPSON = np.array([1.0, 4.0, 1.0]) / 6


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Energy along a plan; all arrays have the plan's shape, (n,) or (batch, n).

    Attributes:
        time: s.
        energy: J since the first point; less than before where the car regenerates.
        power: W at each point, with the acceleration and grade of the leg that follows (at the
            last point: of the leg that ends there).
        sigma: 1-sigma of energy, J.
    """

    time: np.ndarray
    energy: np.ndarray
    power: np.ndarray
    sigma: np.ndarray


def forecast(
    plan: Plan,
    combined: Identifiable,
    sigmas: Identifiable,
    vehicle: Vehicle,
    residual_sigma: float,
    *,
    air_density: float | None = None,
    correlation_time: float = CORRELATION_TIME,
) -> Forecast:
    """Energy, power and uncertainty along a plan.

    The variance of energy adds up one part for each combination, off by the same amount for the
    whole trip and independent of the others, and one for what physics leaves unexplained, an
    error of power that forgets itself within `correlation_time` (`energy.uncertainty`). A part
    is half the difference of the energies with the combination one sigma up and down, which
    needs no step size and sees the kink between drawing and regenerating.

    Args:
        plan: what will be driven.
        combined: the car's identifiable combinations, floats.
        sigmas: their 1-sigma.
        vehicle: for the inertia of rotating parts and the density of air.
        residual_sigma: 1-sigma of power around the physics, W.
        air_density: kg/m^3, None for the vehicle's.
        correlation_time: s.
    """
    density = vehicle.air_density if air_density is None else air_density
    legs = _Legs.of(plan, density, vehicle.rotating_mass_factor)
    power = legs.power(combined)
    elapsed = plan.time - plan.time[..., :1]
    variance = energy_sigma(elapsed, residual_sigma, correlation_time) ** 2
    for name, sigma in zip(IDENTIFIABLE_NAMES, sigmas, strict=True):
        value = getattr(combined, name)
        up = legs.energy(combined._replace(**{name: value + sigma}))
        down = legs.energy(combined._replace(**{name: value - sigma}))
        variance = variance + ((up - down) / 2) ** 2
    return Forecast(
        time=plan.time,
        energy=legs.energy(combined),
        power=np.concatenate((power[..., 0], power[..., -1:, 2]), axis=-1),
        sigma=np.sqrt(variance),
    )


def battery_after(
    result: Forecast, state_of_charge: float | None, capacity_j: float | None
) -> float | None:
    """State of charge at the end of one plan, 0..1, or None while it cannot be known.

    Args:
        result: forecast of a single plan, shape (n,).
        state_of_charge: now, 0..1, None or NaN if unknown.
        capacity_j: usable energy of the full battery, J, None or NaN if unknown.

    Returns:
        0 means that the plan ends, or would have ended, with an empty battery.
    """
    if state_of_charge is None or capacity_j is None:
        return None
    after = state_of_charge - float(result.energy[-1]) / capacity_j
    return min(max(after, 0.0), 1.0) if math.isfinite(after) else None


@dataclass(frozen=True, slots=True)
class _Legs:
    """Start, middle and end of every leg: shape (..., n - 1, 3); duration (..., n - 1), s.

    Distance is cubic in time, so speed is the parabola with the given ends and the leg's length
    as its integral. Power then is smooth but for the kink, and Simpson's rule gives kinetic and
    potential energy exactly.
    """

    duration: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    grade: np.ndarray
    air_density: float
    rotating_mass_factor: float

    @classmethod
    def of(cls, plan: Plan, air_density: float, rotating_mass_factor: float) -> _Legs:
        dt, length = np.diff(plan.time), np.diff(plan.distance)
        start, end = plan.speed[..., :-1], plan.speed[..., 1:]
        # A profile whose speeds contradict its distances could call for reversing in the middle.
        middle = np.maximum(1.5 * length / dt - (start + end) / 4, 0.0)
        bend = 4 * middle
        slope = [-3 * start + bend - end, end - start, start - bend + 3 * end]
        moving = np.where(length > 0, length, np.inf)
        grade = np.arcsin(np.clip(np.diff(plan.elevation) / moving, -1.0, 1.0))
        return cls(
            duration=dt,
            speed=np.stack([start, middle, end], axis=-1),
            acceleration=np.stack(slope, axis=-1) / dt[..., None],
            grade=grade[..., None],
            air_density=air_density,
            rotating_mass_factor=rotating_mass_factor,
        )

    def power(self, combined: Identifiable) -> np.ndarray:
        """W, shape (..., n - 1, 3)."""
        power: np.ndarray = combined_power(
            self.speed,
            self.acceleration,
            combined,
            air_density=self.air_density,
            grade=self.grade,
            rotating_mass_factor=self.rotating_mass_factor,
        )
        return power

    def energy(self, combined: Identifiable) -> np.ndarray:
        """J since the first point, shape (..., n)."""
        steps = self.power(combined) @ SIMPSON * self.duration
        start = np.zeros((*steps.shape[:-1], 1))
        return np.concatenate((start, np.cumsum(steps, axis=-1)), axis=-1)
