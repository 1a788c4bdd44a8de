"""Sequential least squares in the weak form, with a prior: the baseline to beat.

Mean battery power over an interval is linear in the coefficients th, because kinetic energy and
height are exact differences over it:

    P = th0 rho v^3 / 2 + th1 g v + th2 e+ + th3 e- + th4 + th5 R- + th6 (e/v)^2 + th7 [v > 0]
        + th8 known + th9 cold + th10 g v cold + th11 + th12 g v

with e = d(v^2/2 + g h)/dt, e+ where the prior car drives and e- where it brakes, R- its road load
while it brakes, `known` the reported loads, and `cold` tens of degrees below 20 (for the standing
load only where no load is reported). th0 = A C_d/eta, th1 = C_rr m/eta, th2 = m/eta,
th3 = eta mu m/eta, th4 = P_aux; th11 and th12 are of this drive alone and forgotten with it. The
prior is the vehicle file's; the posterior of one interval is the prior of the next (recursive
least squares without forgetting, Huber's weight for outliers).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math

import numpy as np

from benchmarks.unseen.method import NAMES, Estimate, Prediction
from benchmarks.unseen.steps import DrivingStep, StepStream
from evpinn_ros.core.signals.readings import Reading
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import identifiable
from evpinn_ros.core.vehicle.physics import GRAVITY

MOVING = 0.3  # m/s
MILD = 20.0  # degrees Celsius
INTERVALS = ((0.5, 6.0), (3.0, 10.0), (math.inf, 20.0))  # s: longest step, length of an interval
# Of what the vehicle file does not say, value and 1-sigma: th5 (of the share that comes back),
# th6 W/(m/s^2)^2, th7 W, th8, th9 W, th10 and th12 (of the rolling force), th11 W.
LOST_ROAD_LOAD, COPPER, DRIVELINE, REPORTED = 0.3, (300.0, 300.0), (250.0, 150.0), (0.95, 0.2)
COLD_LOAD, COLD_ROLLING = (300.0, 300.0), (0.06, 0.04)
DRIVE_LOAD, DRIVE_ROLLING = 250.0, 0.08
DRIFT_LOAD, DRIFT = 80.0, 0.02  # between drives: of th4, W; of the others, of their prior sigma
NOISE, NOISE_FORCE = 250.0, 50.0  # W and N, 1-sigma of what the terms leave of an interval
NOISE_WEIGHT, HUBER = 30.0, 2.5  # intervals that the start of the noise counts for; sigmas
MEMORY = 40.0  # s over which residuals are alike
DRIVES_WEIGHT, MOST = 4.0, 9.0  # drives that the start of the scale counts for; of one at most


class WeakFormLeastSquares:
    """The filter of the module's docstring."""

    pairs = True

    def __init__(self, vehicle: Vehicle) -> None:
        prior = identifiable(vehicle.initial, vehicle.frontal_area)
        mass, rolling = prior.mass_over_eta, prior.c_rr * prior.mass_over_eta
        back = prior.regeneration
        share = {name: p.std / p.value for name, p in vehicle.priors.items()}
        by_eta = {name: math.hypot(std, share["eta"]) for name, std in share.items()}
        table = (
            (prior.drag_area_over_eta, prior.drag_area_over_eta * by_eta["c_d"]),
            (rolling, rolling * math.hypot(by_eta["mass"], share["c_rr"])),
            (mass, mass * by_eta["mass"]),
            (mass * back, mass * back * math.hypot(by_eta["mass"], by_eta["mu"])),
            (prior.p_aux, vehicle.priors["p_aux"].std),
            (back - 1.0, LOST_ROAD_LOAD),
            COPPER,
            DRIVELINE,
            REPORTED,
            COLD_LOAD,
            tuple(rolling * cold for cold in COLD_ROLLING),
            (0.0, DRIVE_LOAD),
            (0.0, DRIVE_ROLLING * rolling),
        )
        self._prior = (prior.drag_area_over_eta, rolling, mass, vehicle.rotating_mass_factor)
        self.mean, self._spread = np.array(table).T
        self.covariance = np.diag(self._spread**2)
        self._driven, self._braked = np.zeros((2, self.mean.size))  # sums of rows so far
        self._nudges = np.diag(1e-3 * self._spread)
        self._stream = StepStream(vehicle)
        self._noise = (NOISE_WEIGHT, NOISE_WEIGHT)  # sum of squares, number
        self._scale = (DRIVES_WEIGHT, DRIVES_WEIGHT)  # the same of whole drives
        self._begin()

    def _begin(self) -> None:
        count = self.mean.size
        self._energy = self._residual = 0.0
        self._unmeasured, self._interval, self._drive = np.zeros((3, count))
        self._interval_s = self._interval_energy = self._variance = 0.0
        self._drive_energy = self._drive_variance = 0.0
        self._start = (self.mean.copy(), self.covariance.copy())
        self._length = INTERVALS[-1][1]
        self._last_ns = 0

    def begin_next_drive(self) -> None:
        """Forget the drive's own states, add drift, and scale sigmas by the drive's error."""
        mean, covariance = self._start
        if self._drive_energy:
            variance = self._drive @ covariance @ self._drive + self._drive_variance
            square = (self._drive_energy - self._drive @ mean) ** 2 / variance
            self._scale = (self._scale[0] + min(square, MOST), self._scale[1] + 1)
        for index, drift in enumerate((DRIFT * self._spread[:-2]) ** 2):
            self.covariance[index, index] += drift
        self.covariance[4, 4] += DRIFT_LOAD**2
        self.covariance[-2:], self.covariance[:, -2:] = 0.0, 0.0
        self.covariance[(-2, -1), (-2, -1)] = self._spread[-2:] ** 2
        self.mean[-2:] = 0.0
        self._begin()
        self._stream.begin_next_drive()

    def add_reading(self, reading: Reading) -> Iterable[Prediction]:
        """Predict steps without power, and learn from those with it."""
        for step in self._stream.add_reading(reading):
            row = self._row(step)
            if math.isnan(step.power):
                yield self._predict(step, row)
            else:
                self._learn(step, row)

    def _row(self, step: DrivingStep) -> np.ndarray:
        drag_area, rolling, mass, rotating = self._prior
        v = abs(step.speed)
        drag, roll = step.density * abs(step.cube) / 2, GRAVITY * v
        specific = rotating * step.kinetic + GRAVITY * step.climb
        road = drag_area * drag + rolling * roll
        driving = mass * specific + road > 0
        moving = v > MOVING
        cold = 0.0 if step.celsius is None else max(MILD - step.celsius, 0.0) / 10
        return np.array(
            (
                drag,
                roll,
                specific if driving else 0.0,
                0.0 if driving else specific,
                1.0,
                0.0 if driving else road,
                (specific / v) ** 2 if moving else 0.0,
                float(moving),
                step.known,
                0.0 if step.known else cold,
                roll * cold,
                1.0,
                roll,
            )
        )

    def _predict(self, step: DrivingStep, row: np.ndarray) -> Prediction:
        power = float(row @ self.mean)
        noise = NOISE**2 + (NOISE_FORCE * step.speed) ** 2
        self._unmeasured += row * step.dt
        self._residual += noise * MEMORY * step.dt
        scale, residual = self._scale[0] / self._scale[1], self._noise[0] / self._noise[1]
        variance = (
            self._unmeasured @ self.covariance @ self._unmeasured + residual * self._residual
        )
        middle = self._energy + power * step.dt / 2
        self._energy += power * step.dt
        sigma = math.sqrt(residual * noise)
        return Prediction(step.middle_ns, power, sigma, middle, math.sqrt(scale * variance))

    def _learn(self, step: DrivingStep, row: np.ndarray) -> None:
        self._unmeasured, self._residual = np.zeros(row.size), 0.0
        if step.begin_ns != self._last_ns:
            self._interval, self._interval_s = np.zeros(row.size), 0.0
            self._interval_energy = self._variance = 0.0
            self._length = next(length for most, length in INTERVALS if step.dt <= most)
        self._last_ns = step.end_ns
        noise = (NOISE**2 + (NOISE_FORCE * step.speed) ** 2) * step.dt
        self._interval = self._interval + row * step.dt
        self._interval_energy += step.power * step.dt
        self._interval_s += step.dt
        self._variance += noise
        self._drive = self._drive + row * step.dt
        (self._braked if row[5] or row[3] else self._driven)[:] += row * step.dt
        self._drive_energy += step.power * step.dt
        self._drive_variance += noise * MEMORY
        if self._interval_s >= self._length:
            self._update(self._interval, self._interval_energy, self._variance, self._interval_s)
            self._last_ns = step.end_ns
            self._interval, self._interval_s = np.zeros(row.size), 0.0
            self._interval_energy = self._variance = 0.0

    def _update(self, row: np.ndarray, energy: float, variance: float, seconds: float) -> None:
        """One interval: mean power against its row."""
        row, power = row / seconds, energy / seconds
        noise = variance / seconds * self._noise[0] / self._noise[1]
        residual = power - row @ self.mean
        projected = self.covariance @ row
        expected = row @ projected + noise
        outlying = max(abs(residual) / math.sqrt(expected) / HUBER, 1.0)
        share = min(residual**2 / expected, HUBER**2)
        self._noise = (
            self._noise[0] + share * self._noise[0] / self._noise[1],
            self._noise[1] + 1,
        )
        gain = projected / (row @ projected + noise * outlying**2)
        self.mean = self.mean + gain * residual
        covariance = self.covariance - np.outer(gain, projected)
        self.covariance = (covariance + covariance.T) / 2

    def combinations(self) -> Mapping[str, Estimate]:
        """The combinations of the car's parameters.

        1/eta and the share returned by braking include the loss with force squared, by its share
        of the energy spent in driving so far.
        """
        combined = self._combined(self.mean)
        gradient = np.array(
            [self._combined(self.mean + nudge) - combined for nudge in self._nudges]
        )
        sizes = np.diag(self._nudges)[:, None]
        std = np.sqrt(np.diag((gradient / sizes).T @ self.covariance @ (gradient / sizes)))
        pairs = zip(combined.tolist(), std.tolist(), strict=True)
        return dict(zip(NAMES, pairs, strict=True))

    def _combined(self, mean: np.ndarray) -> np.ndarray:
        """The five combinations of a mean, shape (5,)."""
        parts, back = mean * self._driven, mean * self._braked
        lossless = parts[:3].sum()
        factor = 1 + parts[6] / lossless if lossless > 0 else 1.0
        offered = back[:2].sum() + mean[2] * self._braked[3]
        returned = back[[0, 1, 3, 5, 6]].sum()
        share = returned / (offered * factor) if offered < 0 else mean[3] / mean[2]
        return np.array((mean[2] * factor, share, mean[1] * factor, mean[0] * factor, mean[4]))
