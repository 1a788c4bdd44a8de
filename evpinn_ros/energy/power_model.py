"""Energy of a plan by a linear model of the car (`vehicle.linear_power`), with its variance.

The variance of the energy of a trip adds up

- the coefficients, off by the same amount for the whole trip;
- what the model leaves of power, an error that forgets itself within seconds;
- auxiliary power, which drifts around its mean within minutes;
- slopes and winds that no plan holds, which change within some hundred metres.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import like, namespace
from evpinn_ros.energy.uncertainty import CORRELATION_TIME, relaxed, walked
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable, identifiable
from evpinn_ros.vehicle.linear_power import (
    CREEPING,
    FADE_END,
    FADE_SPEED,
    MOST_FORCE,
    LinearPower,
    turning,
)
from evpinn_ros.vehicle.physics import GRAVITY

TINY = 1e-6  # m/s
SAME_LENGTH = 1.0  # m by which plans along one road may differ in length
LEAST_SPEED = 0.5  # m/s, below it no force follows from power


class Motion(NamedTuple):
    """Moments of driving, numpy arrays or torch tensors of one shape.

    Attributes:
        speed: m/s, not negative.
        acceleration: m/s^2.
        climb: m/s, rate of ascent.
        air_density: kg/m^3, a number or of the same shape.
        head_wind: wind against the car, m/s over ground, likewise.
    """

    speed: Any
    acceleration: Any
    climb: Any
    air_density: Any
    head_wind: Any = 0.0


class PlanEnd(NamedTuple):
    """A plan at its end.

    Attributes:
        energies: of the mean and of each direction of the coefficients, J, shape (..., 1 + k).
        elapsed: s, shape (...), likewise below.
        distance: m.
        square_speed: mean square of speed, m^2/s^2.
    """

    energies: np.ndarray
    elapsed: np.ndarray
    distance: np.ndarray
    square_speed: np.ndarray


class PowerModel:
    """A car, ready for forecasts.

    Attributes:
        linear: what it was made from.
    """

    def __init__(self, linear: LinearPower) -> None:
        """Take a car."""
        self.linear = linear
        self._coefficients = np.concatenate((linear.mean[None], linear.directions))

    def powers(self, motion: Motion) -> np.ndarray:
        """Power of the mean and each direction, W, shape (..., 1 + k), without present drift."""
        columns = np.stack(self._features(motion, np), axis=-1)
        return np.asarray(columns @ self._coefficients[:, :-1].T)

    def energies(self, motion: Motion, duration: Any) -> Any:
        """Energy of the mean and of each direction, J, shape (batch, 1 + k), of whole trips.

        Args:
            motion: shape (batch, n), in the middle of each leg.
            duration: of each leg, s, shape (batch, n).
        """
        xp = namespace(motion.speed)
        columns = [xp.sum(column * duration, -1) for column in self._features(motion, xp)]
        return xp.stack(columns, -1) @ like(self._coefficients[:, :-1].T, columns[0])

    def with_present_drift(self, energies: Any, elapsed: Any) -> Any:
        """`energies` with what is left of the present drift after `elapsed` s."""
        integral = relaxed(elapsed, self.linear.drift_time)
        return energies + integral[..., None] * like(self._coefficients[:, -1], elapsed)

    def variance_beside(self, elapsed: Any, distance: Any, square_speed: Any) -> Any:
        """Variance of energy, J^2, from all but the coefficients.

        Args:
            elapsed: s since the start, any shape.
            distance: m since the start, of the same shape.
            square_speed: mean square of speed since the start, m^2/s^2, of the same shape.
        """
        car = self.linear
        noise = car.standing_noise**2 + car.moving_noise**2 * square_speed
        # What the drift is at the start, the directions hold.
        drift = walked(elapsed, car.drift_time) - relaxed(elapsed, car.drift_time) ** 2
        variance = (
            noise * walked(elapsed, CORRELATION_TIME)
            + car.drift_std**2 * drift
            + car.slope_force**2 * walked(distance, car.slope_length)
        )
        return namespace(variance).clip(variance, 0.0, None)  # rounding, of the first moments

    def variance_between(self, one: PlanEnd, other: PlanEnd) -> float:
        """Variance of the difference of two plans' energies, J^2, from all but the coefficients.

        Both begin at one moment; of one length they are taken to lead along one road.
        """
        car = self.linear
        # As floats: numpy takes ten times as long for one number.
        elapsed = [float(plan.elapsed) for plan in (one, other)]
        lengths = [float(plan.distance) for plan in (one, other)]
        squares = [float(plan.square_speed) for plan in (one, other)]
        variance = sum(
            (car.standing_noise**2 + car.moving_noise**2 * square)
            * walked(seconds, CORRELATION_TIME)
            for seconds, square in zip(elapsed, squares, strict=True)
        )
        common, memory = min(elapsed), car.drift_time
        alone = max(elapsed) - common
        # The drift where the first of them ends, and what it does from there on.
        begun = relaxed(alone, memory)
        there = -math.expm1(-2 * common / memory) * begun**2
        variance += car.drift_std**2 * (there + walked(alone, memory) - begun**2)
        if abs(lengths[0] - lengths[1]) > SAME_LENGTH:
            slopes = (walked(length, car.slope_length) for length in lengths)
            variance += car.slope_force**2 * sum(slopes)
        return max(float(variance), 0.0)

    def _features(self, motion: Motion, xp: Any) -> list[Any]:
        """The features but the last, each of the motion's shape."""
        car, v = self.linear, motion.speed
        flow = v + motion.head_wind
        drag = 0.5 * motion.air_density * flow * abs(flow) * v
        # v cos(grade), as a root that has a slope at standstill too
        level = xp.clip(v * v - motion.climb * motion.climb, 0.0, None)
        rolling = GRAVITY * (xp.sqrt(level + TINY**2) - TINY)
        force = GRAVITY * motion.climb + car.rotating_mass_factor * motion.acceleration * v
        wheel = car.drag_area * drag + car.rolling_mass * rolling + car.mass * force
        driving = (wheel > 0) * 1.0
        driven = [driving * part for part in (drag, rolling, force)]
        fade = xp.clip((v - FADE_END) / (FADE_SPEED - FADE_END), 0.0, 1.0)
        whole = (drag, rolling, force)
        braked = [(all_ - part) * fade for all_, part in zip(whole, driven, strict=True)]
        pull = xp.clip(wheel / car.mass / xp.clip(v, LEAST_SPEED, None), -MOST_FORCE, MOST_FORCE)
        return [*driven, *braked, xp.ones_like(v), turning(v), pull * pull * (v > CREEPING)]


def vehicle_model(vehicle: Vehicle, residual_sigma: float) -> PowerModel:
    """The model of a vehicle file: its priors, and 1-sigma of power around the physics, W."""
    return combined_model(*prior_identifiable(vehicle), vehicle, residual_sigma)


def combined_model(
    combined: Identifiable, sigmas: Identifiable, vehicle: Vehicle, residual_sigma: float
) -> PowerModel:
    """The model that the identifiable combinations make, their errors taken as independent.

    Args:
        combined: floats.
        sigmas: their 1-sigma.
        vehicle: for the inertia of rotating parts.
        residual_sigma: 1-sigma of power around the physics, W.
    """
    mass, area, c_rr, regeneration, p_aux = combined
    driving = np.array([area, mass * c_rr, mass])
    by_name = np.array([[0.0, c_rr, 1.0], [1.0, 0.0, 0.0], [0.0, mass, 0.0]])  # mass, area, c_rr
    zero = np.zeros(3)
    rows = [[*row, *(regeneration * row), 0.0] for row in by_name]
    rows += [[*zero, *driving, 0.0], [*zero, *zero, 1.0]]
    directions = np.array(sigmas)[:, None] * np.pad(np.array(rows), ((0, 0), (0, 3)))
    return PowerModel(
        LinearPower(
            drag_area=area,
            rolling_mass=mass * c_rr,
            mass=mass,
            rotating_mass_factor=vehicle.rotating_mass_factor,
            standing_noise=residual_sigma,
            moving_noise=0.0,
            drift_std=0.0,
            drift_time=1.0,
            slope_force=0.0,
            slope_length=1.0,
            mean=np.array([*driving, *(regeneration * driving), p_aux, 0.0, 0.0, 0.0]),
            directions=directions,
        )
    )


def prior_identifiable(vehicle: Vehicle) -> tuple[Identifiable, Identifiable]:
    """The combinations of the vehicle's priors, and their 1-sigma to first order.

    Relative variances of products and quotients of independent quantities add up.
    """
    combined = identifiable(vehicle.initial, vehicle.frontal_area)
    relative = {
        name: prior.std / prior.value if prior.value else 0.0
        for name, prior in vehicle.priors.items()
    }
    sigmas = Identifiable(
        mass_over_eta=combined.mass_over_eta * math.hypot(relative["mass"], relative["eta"]),
        drag_area_over_eta=combined.drag_area_over_eta
        * math.hypot(relative["c_d"], relative["eta"]),
        c_rr=vehicle.priors["c_rr"].std,
        regeneration=combined.regeneration * math.hypot(relative["eta"], relative["mu"]),
        p_aux=vehicle.priors["p_aux"].std,
    )
    return combined, sigmas
