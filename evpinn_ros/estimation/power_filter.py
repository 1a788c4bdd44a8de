"""Power from the physics and a network, learned together at every sample.

The equations of `ParameterFilter`, copper loss included, are one model of a car; the car is
another. What they leave, a constant efficiency above all, repeats at the same speed and
acceleration: weak recuperation at a walking pace, friction brakes in hard braking, the motor's
efficiency map. Here the filter's state also holds

- a radial-basis network over speed and acceleration whose output is a force, N: its units are
  fixed on a grid, its output weights are states. It pays for what it says by its prior (the
  physics loss of eq. 22 in the filter's terms), and where nothing was driven it says nothing;
- weights of the course of the acceleration around a moment, kg: inertia that one number for the
  acceleration misses, with it any lag between speed and power;
- the share by which reported auxiliary loads are not drawn: sensors of heaters err by kilowatts;
- the drift of the auxiliary power of this drive from that of the car.

All of it is linear, and the physics is taken as linear in its parameters about the vehicle file,
so this is a plain Kalman filter and one covariance decides what is physics and what network. Were
the physics linearised about what is believed at each moment, what was learned under one set of
derivatives would be kept under another: on real drives rolling resistance drifted to five times
its prior that way, paid back by the network. Here parameters only serve power; those that are
published come from `PublishedFilter`.

The unknown slope is that of the roads driven: how hilly they are is learned from how large the
slopes found were.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
import math
from typing import Any

import numpy as np

from evpinn_ros.estimation.parameter_filter import (
    C_D,
    C_RR,
    COPPER,
    ETA,
    FORCE_NOISE,
    HOUR,
    LOGARITHMIC,
    MASS,
    MU,
    P_AUX,
    POWER_NOISE,
    SLOPE,
    SLOPE_LENGTH,
    STATES,
    ParameterFilter,
)
from evpinn_ros.estimation.reported_loads import ExpectedLoads, ReportedLoads
from evpinn_ros.estimation.window import Batch
from evpinn_ros.signals.kinematics import COURSE, COURSE_TIMES
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.linear_power import FEATURES, LinearPower
from evpinn_ros.vehicle.physics import GRAVITY, STANDSTILL_SPEED

UNIT_SPEED_STEP, UNIT_ACCELERATION_STEP = 4.0, 0.7  # m/s and m/s^2; units are as wide as far apart
UNIT_SPEEDS = UNIT_SPEED_STEP * np.arange(11)  # to 40 m/s
UNIT_ACCELERATIONS = UNIT_ACCELERATION_STEP * (np.arange(8) - 3.5)  # +-2.45 m/s^2
UNITS = UNIT_SPEEDS.size * UNIT_ACCELERATIONS.size
UNIT_STD = 100.0  # N, of what one unit adds: the size of the residuals (`FORCE_NOISE`)
COURSE_STD = 40.0  # kg: a fiftieth of a car
REPORTED_STD = 0.5  # of the share of reported loads that is not drawn
REPORTED_TIME = 3 * HOUR  # s; a fault of a sensor stays for a drive
DRIFT_STD = 400.0  # W, from the mean of the car, within a drive and from drive to drive
DRIFT_TIME = HOUR / 6  # s
CAR_TIME = 100 * HOUR  # s in which what belongs to the car is forgotten

HILL_STD = 0.01  # rad, 1-sigma of the unknown slope on roads not yet known
HILL_RANGE = (0.003, 0.03)  # rad, a plain to mountains
HILL_LENGTH = 10e3  # m over which it is learned how hilly the roads are

REPORTED = len(STATES) + UNITS + COURSE
DRIFT = REPORTED + 1
ROAD_STATES = (REPORTED, DRIFT)  # beside the slope: of this drive, not of the car
FORECAST_STATES = [*range(SLOPE), *range(len(STATES), len(STATES) + UNITS), REPORTED, DRIFT]
CONSTANT = FEATURES.index("constant")
DIRECTIONS = 24  # of what is not known of the car, that forecasts are told


class PowerFilter(ParameterFilter):
    """The filter of the module's text."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Start at the vehicle's priors, with a network that says zero."""
        super().__init__(vehicle, copper_loss=True)
        std = np.repeat((UNIT_STD, COURSE_STD, REPORTED_STD, DRIFT_STD), (UNITS, COURSE, 1, 1))
        self._prior_mean = np.concatenate((self._prior_mean, np.zeros(std.size)))
        self._prior_variance = np.concatenate((self._prior_variance, std**2))
        self._prior_variance[SLOPE] = HILL_STD**2
        self._time_constants = np.concatenate((self._time_constants, np.full(std.size, CAR_TIME)))
        self._time_constants[[P_AUX, REPORTED, DRIFT]] = CAR_TIME, REPORTED_TIME, DRIFT_TIME
        self.mean = self._prior_mean.copy()
        self.covariance = np.diag(self._prior_variance)
        self._loads = ReportedLoads()

    @property
    def hilliness(self) -> float:
        """1-sigma of the unknown slope on the roads driven, rad."""
        return math.sqrt(self._prior_variance[SLOPE])

    @property
    def lag(self) -> tuple[float, float]:
        """By how much power follows speed, s, and its 1-sigma; negative when it comes first.

        Power that answers to the acceleration a lag ago is, to first order, inertia times the
        acceleration now and a part of its course whose centre of weight lies that lag back.
        """
        course = slice(len(STATES) + UNITS, REPORTED)
        inertia = math.exp(self.mean[MASS] - self.mean[ETA]) * self._vehicle.rotating_mass_factor
        variance = COURSE_TIMES @ self.covariance[course, course] @ COURSE_TIMES
        lag = -float(COURSE_TIMES @ self.mean[course]) / inertia
        return lag, math.sqrt(max(0.0, float(variance))) / inertia

    def update(self, sample: Sample, power: float, step: float) -> float:
        """Learn as `ParameterFilter` does, and how hilly the roads are."""
        residual = super().update(sample, power, step)
        self._loads.push(sample.known_auxiliary, sample.celsius, step)
        if abs(sample.speed) > STANDSTILL_SPEED:
            found = self.mean[SLOPE] ** 2 + self.covariance[SLOPE, SLOPE]
            share = min(1.0, abs(sample.speed) * step / HILL_LENGTH)
            variance = self._prior_variance[SLOPE]
            self._set_hills(variance + share * (found - variance))
        return residual

    def forget_time(self) -> None:
        """Start time anew after a jump: another road."""
        super().forget_time()
        for index in ROAD_STATES:
            self.mean[index] = self._prior_mean[index]
            self.covariance[index, :] = self.covariance[:, index] = 0.0
            self.covariance[index, index] = self._prior_variance[index]

    def end_drive(self) -> None:
        """What comes is another drive, with loads of its own."""
        self._loads.end_drive()

    def export(self) -> dict[str, Any]:
        """State to save."""
        return {**super().export(), "hilliness": self.hilliness, "loads": self._loads.export()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a saved state; ValueError when it does not fit."""
        hilliness = float(state["hilliness"])
        if not HILL_RANGE[0] <= hilliness <= HILL_RANGE[1]:
            raise ValueError("the saved hilliness is out of range")
        loads = ReportedLoads.restored(state["loads"])
        before = self._prior_variance[SLOPE]
        self._prior_variance[SLOPE] = hilliness**2
        try:
            super().restore(state)
        except (KeyError, TypeError, ValueError):  # a state that does not fit changes nothing
            self._prior_variance[SLOPE] = before
            raise
        self._loads = loads

    def linear_power(self, celsius: float | None = None) -> LinearPower:
        """What was learned of the car, as forecasts take it at an ambient temperature.

        The course of the acceleration is left out, for its mean effect is zero. Reported loads go
        from what they are now to what `ReportedLoads` expects, as drift does. The slope of the
        present road is none of a plan's.
        """
        loads = self._loads.expected(celsius)
        base, by_state = self._coefficients(loads)
        away = (self.mean - self._prior_mean)[FORECAST_STATES]
        covariance = self.covariance[np.ix_(FORECAST_STATES, FORECAST_STATES)]
        eta, _, mass, c_rr, c_d = np.exp(self._prior_mean[LOGARITHMIC])
        unknown_loads = np.zeros((1, base.size))
        unknown_loads[0, CONSTANT] = loads.sigma * abs(1.0 + float(self.mean[REPORTED]))
        return LinearPower(
            drag_area=self._vehicle.frontal_area * c_d,
            rolling_mass=mass * c_rr,
            mass=mass,
            rotating_mass_factor=self._vehicle.rotating_mass_factor,
            standing_noise=POWER_NOISE,
            moving_noise=FORCE_NOISE * math.sqrt(self.noise_scale),
            drift_std=DRIFT_STD,
            drift_time=DRIFT_TIME,
            slope_force=mass / eta * GRAVITY * self.hilliness,
            slope_length=SLOPE_LENGTH,
            mean=base + away @ by_state,
            directions=np.concatenate((_leading_directions(by_state, covariance), unknown_loads)),
            unit_speeds=UNIT_SPEEDS,
            unit_accelerations=UNIT_ACCELERATIONS,
        )

    def _coefficients(self, loads: ExpectedLoads) -> tuple[np.ndarray, np.ndarray]:
        """Of `LinearPower`: those at the prior's mean, and their change by each forecast state."""
        eta, mu, mass, c_rr, c_d = np.exp(self._prior_mean[LOGARITHMIC])
        whole = np.array([self._vehicle.frontal_area * c_d, mass * c_rr, mass])
        base = np.zeros(len(FEATURES) + UNITS)
        driving, braking, copper, drift = slice(3), slice(3, 6), 7, 8
        base[driving], base[braking] = whole / eta, whole * mu
        base[CONSTANT], base[drift] = self._prior_mean[P_AUX] + loads.settled, loads.excess
        by_state = np.zeros((len(FORECAST_STATES), base.size))
        by_state[ETA, driving] = -base[driving]
        by_state[MU, braking] = base[braking]
        for state, part in ((C_D, [0, 3]), (C_RR, [1, 4]), (MASS, [1, 2, 4, 5])):
            by_state[state, part] = base[part]
        by_state[P_AUX, CONSTANT] = by_state[COPPER, copper] = 1.0
        by_state[SLOPE : SLOPE + UNITS, len(FEATURES) :] = np.eye(UNITS)
        by_state[-2, CONSTANT], by_state[-2, drift] = loads.settled, loads.excess
        by_state[-1, drift] = 1.0
        return base, by_state

    def _set_hills(self, variance: float) -> None:
        """Take a new prior variance of the slope, rad^2; the present one never exceeds it."""
        variance = min(max(variance, HILL_RANGE[0] ** 2), HILL_RANGE[1] ** 2)
        self._prior_variance[SLOPE] = variance
        shrink = math.sqrt(variance / max(variance, self.covariance[SLOPE, SLOPE]))
        self.covariance[SLOPE, :] *= shrink
        self.covariance[:, SLOPE] *= shrink

    def limit_states(self) -> None:
        """Set no limit: what lies beyond one of a linear model is no efficiency beyond one."""

    def _model(self, sample: Sample | Batch, slope: Any) -> tuple[Any, np.ndarray]:
        """Battery power, W, shape (...), and its gradient by all states, shape (..., k)."""
        power, gradient = self._physics(self._prior_mean, sample, 0.0)
        change = self.mean[:SLOPE] - self._prior_mean[:SLOPE]
        power = power + gradient[..., :SLOPE] @ change + gradient[..., SLOPE] * slope
        added = _added(sample)
        power = power + added @ self.mean[len(STATES) :]
        return power, np.concatenate((gradient, added), axis=-1)


def _added(sample: Sample | Batch) -> np.ndarray:
    """Power by each state beyond those of the physics, shape (..., k - 8)."""
    speed = np.asarray(sample.speed)[..., None]
    acceleration = np.asarray(sample.acceleration)[..., None]
    units = speed * _units(speed, acceleration)
    known = isinstance(sample, Batch) or len(sample.course) == COURSE
    course = speed * (np.asarray(sample.course) if known else np.zeros(COURSE))
    reported = np.asarray(sample.known_auxiliary)[..., None]
    return np.concatenate(
        (units, course, reported, np.ones_like(reported)),
        axis=-1,
    )


def _leading_directions(by_state: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The directions that matter most, shape (`DIRECTIONS`, coefficients), one sigma each.

    Those that make up the largest shares of the variance of energy in usual driving.
    """
    variance, vectors = np.linalg.eigh(covariance)
    spread = by_state.T @ (vectors * np.sqrt(np.maximum(variance, 0.0)))
    energy = _usual_driving() @ spread
    sigma = np.linalg.norm(energy, axis=1, keepdims=True)
    _, _, order = np.linalg.svd(energy / np.maximum(sigma, 1e-9), full_matrices=False)
    directions: np.ndarray = (spread @ order[:DIRECTIONS].T).T
    return directions


@cache
def _usual_driving() -> np.ndarray:
    """Mean features and units of stretches of road, shape (stretches, coefficients).

    Each is driven at about one speed on one slope, as a calm or a lively driver accelerates.
    """
    speed, grade, liveliness, acceleration = np.meshgrid(
        np.arange(0.0, 38.0, 2.0),
        (-0.04, 0.0, 0.04),
        (0.1, 0.4, 1.0),
        np.arange(-2.5, 2.6, 0.25),
        indexing="ij",
    )
    pull = acceleration + GRAVITY * grade
    driving = pull + 0.1 + 2e-4 * speed**2 > 0.0  # against rolling resistance and drag
    parts = np.stack((0.6 * speed**3, GRAVITY * speed, speed * pull), axis=-1)
    driven = parts * driving[..., None]
    one = np.ones_like(speed)
    others = np.stack((one, acceleration**2, 0.5 * one), axis=-1)
    units = speed[..., None] * _units(speed[..., None], acceleration[..., None])
    share = np.exp(-0.5 * (acceleration / liveliness) ** 2)
    share /= share.sum(axis=-1, keepdims=True)
    moments = np.concatenate((driven, parts - driven, others, units), axis=-1)
    stretches: np.ndarray = np.einsum("sgla,sglac->sglc", share, moments)
    return stretches.reshape(-1, moments.shape[-1])


def _units(speed: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Heights of the units, shape (..., UNITS); speed and acceleration have shape (..., 1)."""
    by_speed = np.exp(-0.5 * ((speed - UNIT_SPEEDS) / UNIT_SPEED_STEP) ** 2)
    by_acceleration = np.exp(
        -0.5 * ((acceleration - UNIT_ACCELERATIONS) / UNIT_ACCELERATION_STEP) ** 2
    )
    units: np.ndarray = by_speed[..., :, None] * by_acceleration[..., None, :]
    return units.reshape(*units.shape[:-2], UNITS)
