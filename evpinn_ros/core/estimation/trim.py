"""The trim: the error of the model in the last seconds, forgotten soon after.

Battery power is that of the car (`estimation.terms`, physics and network) plus six linear weights,
of 1, speed, and speed times the acceleration and its profile. They are learned by recursive least
squares at every measured sample, and return to zero within `FADING` as an Ornstein-Uhlenbeck
process does: the trim holds the effect of the present road, wind and second.

It is not the network of the car, which lasts and is learned with the parameters.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.estimation.journey import FORCE_NOISE, POWER_NOISE
from evpinn_ros.core.signals.kinematics import PROFILE
from evpinn_ros.core.signals.sample import Sample, Samples
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

WEIGHTS = 3 + PROFILE
LOAD_STD, FORCE_STD = 1000.0, 700.0  # W; N, and N per m/s^2: 1-sigma of the weights
PRIOR = np.array([LOAD_STD, *([FORCE_STD] * (WEIGHTS - 1))]) ** 2
FADING = 10.0  # s without a measured sample in which weights fall to 1/e
CORRELATED = 2.0  # samples of 10 Hz that count as one
OUTLIER = 3.0  # sigmas from which on a sample counts for less


def trim_rows(samples: Samples) -> np.ndarray:
    """Regressors of the weights at n samples, shape (n, WEIGHTS); 0 while the car stands."""
    speed = samples.speed[:, None]
    rows = np.empty((samples.size, WEIGHTS))
    rows[:, 0], rows[:, 1] = 1.0, samples.speed
    rows[:, 2], rows[:, 3:] = samples.speed * samples.acceleration, speed * samples.profile
    rows[np.abs(samples.speed) < STANDSTILL_SPEED] = 0.0
    return rows


class Trim(NamedTuple):
    """The trim after each of m measured samples; of one moment, m is 1.

    Attributes:
        weights: W, N and N per m/s^2, shape (m, WEIGHTS).
        covariance: of them, shape (m, WEIGHTS, WEIGHTS).
    """

    weights: np.ndarray = np.zeros((1, WEIGHTS))
    covariance: np.ndarray = np.diag(PRIOR)[None]

    def last(self) -> Trim:
        """The last of them."""
        return Trim(self.weights[-1:], self.covariance[-1:])

    def predict(
        self, rows: np.ndarray, ages: np.ndarray, which: np.ndarray | int = -1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Power beside that of the car and its 1-sigma, W, shape (n,) each.

        Args:
            rows: n of `trim_rows`.
            ages: s since the trim was last learned, shape (n,).
            which: index of the trim, of m, for each row.
        """
        keep = np.exp(ages / -FADING)
        power = keep * (rows * self.weights[which]).sum(axis=1)
        along = np.matmul(rows[:, None], self.covariance[which])[:, 0]
        variance = keep**2 * (along * rows).sum(axis=1) + (1.0 - keep**2) * (rows**2 @ PRIOR)
        return power, np.sqrt(np.maximum(variance, 0.0))

    def predict_one(self, sample: Sample, age: float) -> tuple[float, float]:
        """`predict` for one sample: power, W, and its variance, W^2."""
        speed = sample.speed
        if abs(speed) < STANDSTILL_SPEED:
            return 0.0, 0.0
        along = [speed * rise for rise in (sample.acceleration, *sample.profile)]
        row, keep = np.array([1.0, speed, *along]), math.exp(age / -FADING)
        variance = keep**2 * float(row.dot(self.covariance[-1]).dot(row))
        variance += (1.0 - keep**2) * float((row * row).dot(PRIOR))
        return keep * float(row.dot(self.weights[-1])), max(variance, 0.0)

    def learned(self, rows: np.ndarray, residuals: np.ndarray, ages: np.ndarray) -> Trim:
        """The last trim, and those after each of k measured samples: k + 1.

        Args:
            rows: of the samples, by `trim_rows`.
            residuals: measured power less that of the car, W, shape (k,).
            ages: s from the sample before to each, shape (k,).
        """
        count = len(rows)
        weights = np.empty((count + 1, WEIGHTS))
        covariance = np.empty((count + 1, WEIGHTS, WEIGHTS))
        weights[0], covariance[0] = self.weights[-1], self.covariance[-1]
        keep = np.exp(ages / -FADING)
        returned = (1.0 - keep**2)[:, None, None] * np.diag(PRIOR)
        noise = CORRELATED * (POWER_NOISE**2 + (FORCE_NOISE * rows[:, 1]) ** 2)
        columns = residuals.tolist(), noise.tolist(), keep.tolist()
        for index, (residual, unsure, kept) in enumerate(zip(*columns, strict=True)):
            row, now, shape = rows[index], weights[index + 1], covariance[index + 1]
            np.multiply(weights[index], kept, out=now)
            np.multiply(covariance[index], kept**2, out=shape)
            shape += returned[index]
            along = shape.dot(row)
            variance = float(row.dot(along)) + unsure
            error = residual - float(row.dot(now))
            gain = along / max(variance, (error / OUTLIER) ** 2)
            now += error * gain
            shape -= gain[:, None] * along
        return Trim(weights, covariance)
