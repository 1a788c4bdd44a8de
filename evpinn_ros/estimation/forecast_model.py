"""The learned car as forecasts take it: coefficients of energy, and what is not known of them."""

from __future__ import annotations

import math

import numpy as np

from evpinn_ros.estimation.car_filter import FORCE_LENGTH, LOAD_TIME, CarFilter
from evpinn_ros.estimation.car_state import MILD_CELSIUS, SIZE, State
from evpinn_ros.estimation.interval_noise import STANDING_NOISE
from evpinn_ros.estimation.reported_loads import ReportedLoads
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.linear_power import FEATURES, LinearPower
from evpinn_ros.vehicle.physics import GRAVITY

DRIVE, BRAKE = slice(0, 3), slice(3, 6)
NO_LOAD, CONSTANT, FORCE_SQUARED, DRIFT = (
    FEATURES.index(name) for name in ("turning", "constant", "force_squared", "present_drift")
)
LEAST_VARIANCE = 1e-12  # of the largest direction's; less is rounding


def linear_power(
    car: CarFilter, reported: ReportedLoads, vehicle: Vehicle, celsius: float | None
) -> LinearPower:
    """Linear power model of the car at an ambient temperature, None where unknown.

    Loads that the car reports go from what they are now to what `ReportedLoads` expects, as its
    wandering load does. The slope of the present road is none of a plan's.
    """
    whole = car.mixture()
    mean, loads = whole.mean, reported.expected(celsius)
    away = 0.0 if celsius is None or reported.reports else celsius - MILD_CELSIUS
    cold, hot = max(0.0, -away), max(0.0, away)
    eta, mu, mass, c_d = (math.exp(mean[i]) for i in (State.ETA, State.MU, State.MASS, State.C_D))
    snow = 0.0 if celsius is None else max(0.0, MILD_CELSIUS - celsius) / 10.0
    rolling = mean[State.C_RR] * (1.0 + mean[State.ROLL_COLD] * snow) + mean[State.ROLL_DRIVE]
    rolling_mass = mass * car.constants.c_rr * rolling
    wheel = np.array([vehicle.frontal_area * c_d, rolling_mass, mass])
    base, by_state = np.zeros(len(FEATURES)), np.zeros((SIZE, len(FEATURES)))
    for part, rate in ((DRIVE, 1.0 / eta), (BRAKE, mu)):
        base[part] = rate * wheel
        by_state[State.MASS, part] = rate * wheel * (0.0, 1.0, 1.0)
        by_state[State.C_D, part] = rate * wheel * (1.0, 0.0, 0.0)
        tyre = rate * np.array([0.0, mass * car.constants.c_rr, 0.0])
        by_state[State.C_RR, part] = tyre * (1.0 + mean[State.ROLL_COLD] * snow)
        by_state[State.ROLL_COLD, part] = tyre * mean[State.C_RR] * snow
        by_state[State.ROLL_DRIVE, part] = tyre
    by_state[State.ETA, DRIVE], by_state[State.MU, BRAKE] = -base[DRIVE], base[BRAKE]
    for state, feature, factor in (
        (State.NO_LOAD, NO_LOAD, 1.0),
        (State.COPPER, FORCE_SQUARED, 1.0),
        (State.P_AUX, CONSTANT, 1.0),
        (State.AUX_DRIVE, CONSTANT, 1.0),
        (State.COLD, CONSTANT, cold),
        (State.HOT, CONSTANT, hot),
        (State.REPORTED, CONSTANT, loads.settled),
        (State.AUX, DRIFT, 1.0),
        (State.COLD_START, DRIFT, cold * car.warmth.cabin),
        (State.HOT_START, DRIFT, hot * car.warmth.cabin),
    ):
        by_state[state, feature] = factor
        base[feature] += factor * mean[state]
    base[CONSTANT] += loads.settled
    base[DRIFT] += loads.excess
    unknown_loads = np.zeros((1, len(FEATURES)))
    unknown_loads[0, CONSTANT] = loads.sigma
    return LinearPower(
        drag_area=wheel[0],
        rolling_mass=rolling_mass,
        mass=mass,
        rotating_mass_factor=vehicle.rotating_mass_factor,
        standing_noise=STANDING_NOISE,
        moving_noise=car.force_noise(),
        drift_std=car.load_std,
        drift_time=LOAD_TIME,
        slope_force=mass / eta * GRAVITY * car.hilliness,
        slope_length=FORCE_LENGTH,
        mean=base,
        directions=np.concatenate((_directions(by_state, whole.covariance), unknown_loads)),
    )


def _directions(by_state: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Independent directions of one sigma each, shape (k, len(FEATURES))."""
    variance, vectors = np.linalg.eigh(by_state.T @ covariance @ by_state)
    counts = variance > LEAST_VARIANCE * max(float(variance.max()), 1e-300)
    return np.asarray((vectors[:, counts] * np.sqrt(variance[counts])).T)
