"""Battery power as a linear combination of known terms: recursive and batch least squares.

With the specific force f = k a + g sin(grade) (k: rotating mass), power less known loads is

    P = th1 rho |v| v^2 + th2 |v| + th3 v f+ + th4 v f- + th5  [+ th6 v^2 + th7 a^2]

where f+ is f while positive and f- while negative: eq. 21 with the threshold beta at zero, so
th1 = A C_d / (2 eta), th2 = C_rr m g / eta, th3 = m / eta, th4 = th3 times what braking gives
back, th5 = P_aux; th6 and th7 are the losses of iron and copper that a constant efficiency leaves
out. Every fit starts from the priors of the vehicle file, held loosely.
"""

from __future__ import annotations

import math

import numpy as np

from evpinn_ros.estimation.learner import PowerPrediction
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import identifiable
from evpinn_ros.vehicle.physics import GRAVITY

FIVE_TERMS, SEVEN_TERMS = 5, 7
FORGETTING = 0.995  # per sample: a memory of 200; best of 0.99 to 1, docs/project/benchmarks.md
START_SPREAD = 0.5  # 1-sigma of a coefficient before driving, relative to its start
LOSS_SPREAD = (20.0, 600.0)  # 1-sigma of th6, W/(m/s)^2, and th7, W/(m/s^2)^2, about zero
NOISE = 1500.0  # W, 1-sigma of what the terms leave: how much data outweigh the start
HUBER = 3.0  # sigmas beyond which a residual's weight falls (Huber, 1981)
NOISE_MEMORY = 3000.0  # samples over which the size of the residuals is followed
REFIT_NS = 60 * NANOSECONDS  # batch: time between two fits


class Terms:
    """The terms of one car, each over its size, so that all coefficients are of order one."""

    def __init__(self, vehicle: Vehicle, count: int) -> None:
        """Take the first `count` terms of the module's text, `FIVE_TERMS` or `SEVEN_TERMS`."""
        self._rotating_mass_factor = vehicle.rotating_mass_factor
        self._count = count
        combined = identifiable(vehicle.initial, vehicle.frontal_area)
        start = np.zeros(SEVEN_TERMS)
        start[:FIVE_TERMS] = (
            0.5 * combined.drag_area_over_eta,
            combined.c_rr * combined.mass_over_eta * GRAVITY,
            combined.mass_over_eta,
            combined.mass_over_eta * combined.regeneration,
            combined.p_aux,
        )
        spread = START_SPREAD * start
        spread[FIVE_TERMS - 1] = vehicle.priors["p_aux"].std
        spread[FIVE_TERMS:] = LOSS_SPREAD
        self.spread = spread[:count]
        self.start = start[:count] / self.spread

    def row(self, sample: Sample) -> np.ndarray:
        """The terms at a sample, W for a coefficient of one, shape (count,)."""
        v, a = abs(sample.speed), sample.acceleration
        force = self._rotating_mass_factor * a + GRAVITY * math.sin(sample.grade)
        row = (
            sample.air_density * v * v * sample.speed,
            v,
            sample.speed * max(force, 0.0),
            sample.speed * min(force, 0.0),
            1.0,
            v * v,
            a * a,
        )
        return np.array(row[: self._count]) * self.spread


class _Regression:
    """Power that is linear in its terms; how the coefficients are found is the heirs' matter."""

    def __init__(self, vehicle: Vehicle, count: int) -> None:
        self._terms = Terms(vehicle, count)
        self._weights = self._terms.start.copy()

    @property
    def coefficients(self) -> np.ndarray:
        """Present coefficients of the module's text, SI, shape (count,)."""
        return self._weights * self._terms.spread

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power of the present coefficients, W."""
        power = float(self._terms.row(sample) @ self._weights)
        return PowerPrediction(power + sample.known_auxiliary, math.nan)


class RecursiveLeastSquares(_Regression):
    """Recursive least squares with exponential forgetting and Huber's weight.

    Haykin, Adaptive Filter Theory, ch. 10. While the data say nothing, as at standstill, nothing
    is forgotten either: the covariance never exceeds its start in all.
    """

    def __init__(
        self, vehicle: Vehicle, count: int, *, forgetting: float = FORGETTING, huber: float = HUBER
    ) -> None:
        super().__init__(vehicle, count)
        self._forgetting, self._huber = forgetting, huber
        self._covariance = np.eye(count)
        self._variance = NOISE**2

    def observe(self, sample: Sample, power: float) -> None:
        """One step."""
        row = self._terms.row(sample)
        residual = power - sample.known_auxiliary - float(row @ self._weights)
        limit = self._huber * math.sqrt(self._variance)
        clipped = min(abs(residual), limit)
        self._variance += (clipped**2 - self._variance) / NOISE_MEMORY
        doubt = abs(residual) / limit if abs(residual) > limit else 1.0
        projected = self._covariance @ row
        gain = projected / (row @ projected + self._forgetting * NOISE**2 * doubt)
        self._weights = self._weights + gain * residual
        covariance = self._covariance - np.outer(gain, projected)
        if np.trace(covariance) < self._forgetting * len(row):
            covariance = covariance / self._forgetting
        self._covariance = 0.5 * (covariance + covariance.T)


class BatchLeastSquares(_Regression):
    """Least squares on all samples so far, solved anew each minute.

    All samples stay in the sums of the normal equations, which are kept with the start as one
    more observation of each coefficient.
    """

    def __init__(self, vehicle: Vehicle, count: int) -> None:
        super().__init__(vehicle, count)
        self._information = np.eye(count)
        self._target = self._terms.start.copy()
        self._fitted_ns: int | None = None

    def observe(self, sample: Sample, power: float) -> None:
        """Add a sample, and fit when a minute has passed."""
        row = self._terms.row(sample)
        self._information += np.outer(row, row) / NOISE**2
        self._target += row * (power - sample.known_auxiliary) / NOISE**2
        if self._fitted_ns is None:
            self._fitted_ns = sample.stamp_ns
        if sample.stamp_ns - self._fitted_ns >= REFIT_NS:
            self._fitted_ns = sample.stamp_ns
            self._weights[:] = np.linalg.solve(self._information, self._target)
