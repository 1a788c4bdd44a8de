"""Parameters of the car from every sample: an extended Kalman filter on the dynamics.

State x (see `STATES`): the logarithms of eta, mu, mass, C_rr and C_d, the auxiliary power, the
copper loss that the paper's constant efficiency leaves out, and the unknown slope of the road
(grade and wind that no sensor reports act alike). The measurement is battery power:

    P = s w + p_aux + known + copper a^2,    s = 1 if w > 0 else eta mu
    w = v [rho A C_d u |u| / 2 + m g (+-C_rr cos(th) + sin(th)) + k m a] / eta,  th = grade + slope
    u = v + head wind

(eq. 12-19 in the `wheel_power` form; + C_rr forward, - in reverse.) In logarithms the products
that data determine are sums, so the direction they cannot tell, (eta, 1/mu, mass, C_d) scaled
together, is one straight line in which the prior's variance simply stays: the posterior is honest
without any special case.

With the copper loss free, power is predicted better, but eta and mu no longer mean what they mean
in eq. 12-21. So the hybrid learner runs this filter twice: with the loss to predict power, and
without it, as the paper defines them, to publish the parameters.

Every state relaxes towards its prior with its own time constant, so its variance never exceeds
the prior's: long standstill or constant speed cannot wind it up (openpilot issue 21454).

Residuals at 10 Hz are strongly correlated. Counting each sample in full would make the variances
several times too small, so a sample counts dt / `CORRELATION_TIME`, whatever the rate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.estimation.window import Batch
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES, Parameters
from evpinn_ros.vehicle.physics import GRAVITY, STANDSTILL_SPEED, drag_force, inertia_force

STATES = (*PARAMETER_NAMES, "copper", "slope")
ETA, MU, MASS, C_RR, C_D, P_AUX, COPPER, SLOPE = range(len(STATES))
LOGARITHMIC = [ETA, MU, MASS, C_RR, C_D]
BOUNDED = {ETA: 1, MU: 1, P_AUX: -1}  # never above 0 (eta and mu at most 1), never below

COPPER_STD = 600.0  # W/(m/s^2)^2: loss that grows with force squared, 1-sigma about zero
SLOPE_STD = 0.006  # rad: unknown grade and wind
SLOPE_LENGTH = 300.0  # m of road after which the slope is forgotten
HOUR = 3600.0
TIME_CONSTANTS = {  # s of relaxation to the prior
    ETA: 100 * HOUR,
    MU: 100 * HOUR,
    MASS: 100 * HOUR,
    C_RR: 10 * HOUR,
    C_D: 100 * HOUR,
    P_AUX: HOUR / 6,
    COPPER: 100 * HOUR,
}

LONGEST_STEP = HOUR  # s; longer gaps are parking or a clock being set, and the car is the same

POWER_NOISE = 60.0  # W, 1-sigma of the residual at standstill
FORCE_NOISE = 100.0  # N over eta: 1-sigma of the residual while moving is this times speed
CORRELATION_TIME = 0.5  # s over which residuals are alike
OUTLIER = 2.5  # sigmas beyond which a residual's weight falls (Huber)
NOISE_MEMORY = 300.0  # s over which the size of the residuals is learned
NOISE_RANGE = (0.25, 9.0)  # of variance, relative to the constants above
TINY = 1e-12  # variance of a state that is held
FAR = 20.0  # prior sigmas within which every state lies


class Prediction(NamedTuple):
    """Power at one sample, W, its parameter and residual 1-sigma, W, and dP/dx, shape (8,)."""

    power: float
    parameter_std: float
    residual_std: float
    gradient: np.ndarray

    @property
    def sigma(self) -> float:
        """1-sigma of all causes, W."""
        return math.hypot(self.parameter_std, self.residual_std)


class ParameterFilter:
    """The extended Kalman filter of the module's text."""

    def __init__(self, vehicle: Vehicle, *, copper_loss: bool) -> None:
        """Start at the priors of the vehicle file; without copper_loss that state stays zero."""
        self._vehicle = vehicle
        self._prior_mean, prior_std = _prior(vehicle, COPPER_STD if copper_loss else 0.0)
        self._prior_variance = prior_std**2
        self.mean = self._prior_mean.copy()
        self.covariance = np.diag(self._prior_variance)
        self.noise_scale = 1.0
        self._time_constants = np.full(len(STATES), np.inf)
        for index, constant in TIME_CONSTANTS.items():
            self._time_constants[index] = constant
        self._last_ns: int | None = None

    def predict(self, sample: Sample) -> Prediction:
        """Battery power at a sample from all that was learned so far."""
        power, gradient = self._model(sample, self.mean[SLOPE])
        parameter_variance = float(gradient @ self.covariance @ gradient)
        return Prediction(
            float(power),
            math.sqrt(max(0.0, parameter_variance)),
            math.sqrt(self._residual_variance(sample)),
            gradient,
        )

    def advance(self, sample: Sample) -> None:
        """Let time pass up to a sample: every state relaxes towards its prior."""
        step = self._step(sample)
        self._last_ns = sample.stamp_ns
        keep = self._keep(sample, step)
        self.mean = self._prior_mean + keep * (self.mean - self._prior_mean)
        self.covariance = self.covariance * np.outer(keep, keep)
        self.covariance[np.diag_indices(keep.size)] += (1 - keep**2) * self._prior_variance

    def update(self, sample: Sample, power: float, step: float) -> float:
        """Learn from measured power, W, that stands for `step` seconds; returns the residual, W.

        Call `advance` with the same sample first.
        """
        prediction = self.predict(sample)
        residual = power - prediction.power
        self._learn_noise(sample, residual, prediction, step)
        variance = self._residual_variance(sample) * max(1.0, CORRELATION_TIME / step)
        beyond = abs(residual) / (OUTLIER * prediction.sigma)
        variance *= max(1.0, beyond)
        projected = self.covariance @ prediction.gradient
        gain = projected / (prediction.gradient @ projected + variance)
        self.mean = self.mean + gain * residual
        self.covariance = self.covariance - np.outer(gain, projected)
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        self.limit_states()
        return residual

    def parameters(self) -> Parameters:
        """Present values of the parameters."""
        values = self.mean[: len(PARAMETER_NAMES)].copy()
        values[LOGARITHMIC] = np.exp(values[LOGARITHMIC])
        return Parameters(*(float(value) for value in values))

    def parameter_std(self) -> Parameters:
        """1-sigma of the parameters."""
        std = np.sqrt(np.diag(self.covariance))[: len(PARAMETER_NAMES)]
        std[LOGARITHMIC] *= np.exp(self.mean[LOGARITHMIC])
        return Parameters(*(float(value) for value in std))

    def deviation(self) -> Parameters:
        """Distance of each parameter from its prior, in prior sigmas."""
        away = (self.mean - self._prior_mean) / np.sqrt(np.maximum(self._prior_variance, TINY))
        return Parameters(*(float(value) for value in away[: len(PARAMETER_NAMES)]))

    def prior_share(self) -> Parameters:
        """Variance left of the prior's, 0 (all data) to 1 (all prior), for each parameter."""
        learned = slice(len(PARAMETER_NAMES))
        share = np.diag(self.covariance)[learned] / self._prior_variance[learned]
        return Parameters(*(float(min(1.0, value)) for value in share))

    def identifiable(self) -> tuple[Identifiable, Identifiable, Identifiable]:
        """The identifiable combinations, their 1-sigma and the share of variance left of prior."""
        combine = _combination_matrix()
        physics = slice(len(STATES))
        mean = combine @ self.mean[physics]
        mean[1] += math.log(self._vehicle.frontal_area)
        covariance = self.covariance[physics, physics]
        variance = np.einsum("ij,jk,ik->i", combine, covariance, combine)
        prior_variance = (combine**2) @ self._prior_variance[physics]
        value = np.append(np.exp(mean[:-1]), mean[-1])
        std = np.sqrt(variance) * np.append(value[:-1], 1.0)
        share = np.minimum(1.0, variance / prior_variance)
        return (
            Identifiable(*map(float, value)),
            Identifiable(*map(float, std)),
            Identifiable(*map(float, share)),
        )

    @property
    def frontal_area(self) -> float:
        """Frontal area of the vehicle, m^2."""
        return self._vehicle.frontal_area

    @property
    def air_density(self) -> float:
        """Air density of the vehicle file, kg/m^3."""
        return self._vehicle.air_density

    @property
    def slope(self) -> float:
        """Unknown slope of the road now, rad."""
        return float(self.mean[SLOPE])

    def apparent_slope(self, sample: Sample, power: float) -> float:
        """Slope of the road, rad, that power, W, of a moving sample speaks of by itself."""
        flat = replace(sample, grade=0.0)
        expected, gradient = self._model(flat, 0.0)
        return float((power - expected) / gradient[SLOPE])

    def residual_std(self, sample: Sample) -> float:
        """1-sigma of the residual at a sample, W."""
        return math.sqrt(self._residual_variance(sample))

    def residual_stds(self, speed: np.ndarray) -> np.ndarray:
        """1-sigma of the residual at speeds, shape (n,), W."""
        return np.sqrt(POWER_NOISE**2 + self.noise_scale * (FORCE_NOISE * speed) ** 2)

    def prior_precision(self) -> np.ndarray:
        """Inverse prior covariance of the states that vary slowly, all but slope, shape (7, 7)."""
        variance = np.maximum(self._prior_variance[:SLOPE], TINY)
        return np.diag(1.0 / variance)

    def powers(self, data: Batch) -> tuple[np.ndarray, np.ndarray]:
        """Battery power, W, shape (n,), and gradient without slope, shape (n, 7), of many samples.

        Each with the slope believed at its time and the present values of all else.
        """
        power, gradient = self._model(data, data.slope)
        return power, gradient[:, :SLOPE]

    def shift_mass(self, change: float, std: float) -> None:
        """Take up a known change of load: of the logarithm of mass, and its 1-sigma.

        The variance stays within the prior's, as everywhere.
        """
        self.mean[MASS] += change
        self.covariance[MASS, MASS] += std**2
        most = math.sqrt(min(1.0, self._prior_variance[MASS] / self.covariance[MASS, MASS]))
        self.covariance[MASS, :] *= most
        self.covariance[:, MASS] *= most

    def forget_time(self) -> None:
        """Start time anew after a jump: the car may be on another road."""
        self._last_ns = None
        self.mean[SLOPE] = self._prior_mean[SLOPE]
        self.covariance[SLOPE, :] = self.covariance[:, SLOPE] = 0.0
        self.covariance[SLOPE, SLOPE] = self._prior_variance[SLOPE]

    def export(self) -> dict[str, Any]:
        """State to save."""
        return {
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "noise_scale": self.noise_scale,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a saved state; ValueError when it does not fit."""
        mean = np.array(state["mean"], dtype=float)
        covariance = np.array(state["covariance"], dtype=float)
        noise_scale = float(state["noise_scale"])
        size = self.mean.size
        if mean.shape != (size,) or covariance.shape != (size, size):
            raise ValueError("the saved filter has another shape")
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise ValueError("the saved filter is not finite")
        if not self._is_possible(mean, covariance):
            raise ValueError("the saved filter is no state this car could have")
        if not NOISE_RANGE[0] <= noise_scale <= NOISE_RANGE[1]:
            raise ValueError("the saved noise is out of range")
        self.mean, self.covariance, self.noise_scale = mean, covariance, noise_scale

    def _keep(self, sample: Sample, step: float) -> np.ndarray:
        """Share of its distance from the prior that each state keeps over `step` seconds."""
        keep = np.exp(-step / self._time_constants)
        keep[SLOPE] = math.exp(-abs(sample.speed) * step / SLOPE_LENGTH)
        return keep

    def _model(self, sample: Sample | Batch, slope: Any) -> tuple[Any, np.ndarray]:
        """Battery power, W, shape (...), and its gradient, shape (..., 8), at samples."""
        return self._physics(self.mean, sample, slope)

    def _physics(
        self, state: np.ndarray, sample: Sample | Batch, slope: Any
    ) -> tuple[Any, np.ndarray]:
        """Battery power and gradient, as `_model`, of a car whose parameters are those of `state`.

        Only the slope is given apart, for a batch has one at each sample.
        """
        eta, mu, mass, c_rr, c_d = np.exp(state[LOGARITHMIC])
        v, a = sample.speed, sample.acceleration
        angle = sample.grade + slope
        weight = mass * GRAVITY * v
        area = self._vehicle.frontal_area * c_d
        drag = drag_force(v + sample.head_wind, area, sample.air_density) * v
        rolling = np.abs(weight) * c_rr * np.cos(angle)
        climbing = weight * np.sin(angle)
        inertia = inertia_force(mass * self._vehicle.rotating_mass_factor, a) * v
        wheel = drag + rolling + climbing + inertia
        driving = wheel > 0
        share = np.where(driving, 1.0 / eta, mu)
        # The slope is guessed from power alone, so it is no known force to learn mass or eta by:
        # counted as one, its noise would be taken for excitation.
        known = wheel - (climbing - weight * np.sin(sample.grade))
        gradient = np.stack(
            (
                np.where(driving, -share * known, 0.0),
                np.where(driving, 0.0, share * known),
                share * (known - drag),
                share * rolling,
                share * drag,
                np.ones_like(wheel),
                np.square(a),
                share * weight * np.cos(angle),
            ),
            axis=-1,
        )
        rest = state[P_AUX] + sample.known_auxiliary + state[COPPER] * np.square(a)
        return share * wheel + rest, gradient

    def _residual_variance(self, sample: Sample) -> float:
        moving = (FORCE_NOISE * sample.speed) ** 2
        return POWER_NOISE**2 + self.noise_scale * moving

    def _learn_noise(
        self, sample: Sample, residual: float, prediction: Prediction, step: float
    ) -> None:
        """Follow the size of the residuals while moving."""
        if abs(sample.speed) < STANDSTILL_SPEED:
            return
        excess = min(residual**2 / prediction.sigma**2, OUTLIER**2)
        rate = min(1.0, step / NOISE_MEMORY)
        scale = self.noise_scale * (1.0 + rate * (excess - 1.0))
        self.noise_scale = min(max(scale, NOISE_RANGE[0]), NOISE_RANGE[1])

    def limit_states(self) -> None:
        """Project onto `BOUNDED` along the covariance (Simon, 2010, section 2.4).

        Onto as few bounds as keep all of them.
        """
        passed = {index for index, sign in BOUNDED.items() if sign * self.mean[index] > 0.0}
        if not passed:
            return
        for count in range(1, len(BOUNDED) + 1):
            for held in map(list, combinations(BOUNDED, count)):
                if passed.isdisjoint(held):
                    continue
                columns = self.covariance[:, held]
                mean = self.mean - columns @ np.linalg.solve(columns[held], self.mean[held])
                mean[held] = 0.0
                if all(sign * mean[index] <= 0.0 for index, sign in BOUNDED.items()):
                    self.mean = mean
                    return

    def _is_possible(self, mean: np.ndarray, covariance: np.ndarray) -> bool:
        """Whether a state has a true covariance within the prior's, and a mean not too far off."""
        scale = np.sqrt(np.maximum(self._prior_variance, TINY))
        near = np.abs(mean - self._prior_mean) <= FAR * scale
        relative = covariance / np.outer(scale, scale)
        if not (near.all() and np.allclose(relative, relative.T)):
            return False
        return bool(np.linalg.eigvalsh(relative)[0] > -1e-6 and np.diag(relative).max() < 1 + 1e-6)

    def _step(self, sample: Sample) -> float:
        if self._last_ns is None:
            return 0.0
        return min(max(0.0, (sample.stamp_ns - self._last_ns) * 1e-9), LONGEST_STEP)


def _prior(vehicle: Vehicle, copper_std: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and 1-sigma of the states before driving, shape (8,) each."""
    mean, std = np.zeros(len(STATES)), np.zeros(len(STATES))
    for index, name in enumerate(PARAMETER_NAMES):
        prior = vehicle.priors[name]
        mean[index], std[index] = prior.value, prior.std
    std[LOGARITHMIC] /= mean[LOGARITHMIC]
    mean[LOGARITHMIC] = np.log(mean[LOGARITHMIC])
    std[[COPPER, SLOPE]] = copper_std, SLOPE_STD
    return mean, std


def _combination_matrix() -> np.ndarray:
    """Rows: log m/eta, log A C_d/eta (less log A), log C_rr, log eta mu, p_aux; shape (5, 8)."""
    matrix = np.zeros((len(Identifiable._fields), len(STATES)))
    matrix[0, [MASS, ETA]] = 1.0, -1.0
    matrix[1, [C_D, ETA]] = 1.0, -1.0
    matrix[2, C_RR] = 1.0
    matrix[3, [ETA, MU]] = 1.0
    matrix[4, P_AUX] = 1.0
    return matrix
