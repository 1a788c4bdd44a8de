"""The textbook method: an extended Kalman filter of what battery power can determine.

State: k_a = A C_d / eta (m^2), k_r = C_rr m / eta (kg), k_m = m / eta (kg), q = eta mu and P_aux
(W). Battery power is (eq. 12-21 in the `wheel_power` form)

    P = s w + P_aux + known,  w = v [rho k_a v |v| / 2 + g k_r cos(th) + k_m (g sin(th) + k a)]

with s = 1 where w > 0, else q, and k the factor of rotating mass. Mean and covariance before
driving follow from the priors of the vehicle file. The process noise is the only choice: here it
is so large that the states follow the last residuals rather than the car. That improves the score
at 10 Hz, as holding the last value does, but no forecast.
"""

from __future__ import annotations

import math

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import identifiable
from evpinn_ros.core.vehicle.physics import GRAVITY, drag_force

# Logarithms of k_a, k_r, k_m and q in those of eta, mu, mass, C_rr and C_d.
PRIOR_NAMES = ("eta", "mu", "mass", "c_rr", "c_d")
COMBINATIONS = np.array(
    [
        [-1.0, 0.0, 0.0, 0.0, 1.0],
        [-1.0, 0.0, 1.0, 1.0, 0.0],
        [-1.0, 0.0, 1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0, 0.0, 0.0],
    ]
)
WANDER_TIME = np.array([3600.0, 360.0, 3600.0, 3600.0, 6.0])
# s in which a state may wander by one sigma of its prior: k_a, k_r, k_m, q, P_aux
LONGEST_STEP = 3600.0  # s; longer gaps are parking
CORRELATION_TIME = 0.5  # s within which residuals say the same
POWER_NOISE = 300.0  # W, 1-sigma of the residual
FORCE_NOISE = 100.0  # N, 1-sigma of the residual while moving


class FiveStateFilter:
    """Extended Kalman filter of drag, rolling resistance, mass, regeneration and standing load."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Start at the vehicle's priors."""
        self._rotating_mass_factor = vehicle.rotating_mass_factor
        combined = identifiable(vehicle.initial, vehicle.frontal_area)
        self.mean = np.array(
            [
                combined.drag_area_over_eta,
                combined.c_rr * combined.mass_over_eta,
                combined.mass_over_eta,
                combined.regeneration,
                combined.p_aux,
            ]
        )
        priors = [vehicle.priors[name] for name in PRIOR_NAMES]
        variance = np.array([(prior.std / prior.value) ** 2 for prior in priors])
        relative = COMBINATIONS @ np.diag(variance) @ COMBINATIONS.T
        self.covariance = np.zeros((5, 5))
        self.covariance[:4, :4] = relative * np.outer(self.mean[:4], self.mean[:4])
        self.covariance[4, 4] = vehicle.priors["p_aux"].std ** 2
        self._wander = np.diag(self.covariance) / WANDER_TIME
        self._last_ns: int | None = None

    def predict(self, sample: Sample) -> tuple[float, float]:
        """Power of the present state, W, with the sigma of state and residual."""
        power, gradient = self._model(sample)
        variance = float(gradient @ self.covariance @ gradient) + _residual_variance(sample)
        return power, math.sqrt(variance)

    def observe(self, sample: Sample, power: float) -> None:
        """Propagate the state to a sample, and correct it."""
        last, self._last_ns = self._last_ns, sample.stamp_ns
        step = 0.0 if last is None else (sample.stamp_ns - last) / NANOSECONDS
        step = min(max(step, 0.0), LONGEST_STEP)
        self.covariance[np.diag_indices(5)] += self._wander * step
        predicted, gradient = self._model(sample)
        alike = min(max(step, 1e-3), CORRELATION_TIME) / CORRELATION_TIME
        noise = _residual_variance(sample) / alike
        projected = self.covariance @ gradient
        gain = projected / (gradient @ projected + noise)
        self.mean = self.mean + gain * (power - predicted)
        covariance = self.covariance - np.outer(gain, projected)
        self.covariance = 0.5 * (covariance + covariance.T)

    def _model(self, sample: Sample) -> tuple[float, np.ndarray]:
        """Battery power, W, and its gradient in the state, shape (5,)."""
        v = sample.speed
        force = GRAVITY * math.sin(sample.grade) + self._rotating_mass_factor * sample.acceleration
        parts = np.array(
            [
                v * drag_force(v, 1.0, sample.air_density),
                abs(v) * GRAVITY * math.cos(sample.grade),
                v * force,
            ]
        )
        wheel = float(parts @ self.mean[:3])
        driving = wheel > 0.0
        share = 1.0 if driving else float(self.mean[3])
        gradient = np.array([*(share * parts), 0.0 if driving else wheel, 1.0])
        return share * wheel + float(self.mean[4]) + sample.known_auxiliary, gradient


def _residual_variance(sample: Sample) -> float:
    return POWER_NOISE**2 + (FORCE_NOISE * sample.speed) ** 2
