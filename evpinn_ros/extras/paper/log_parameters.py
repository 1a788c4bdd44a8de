"""The five parameters of the paper as logarithms over their initial values, and their best fit.

A parameter is its initial value (eq. 24, 25) times exp(z). For any given power the best parameters
solve a least-squares problem in five unknowns; the vehicle file's priors fix the direction that no
data determine:

minimise over z   sum (P - P_physics(z))^2 / (c s^2) + sum (z_i / prior_i)^2,

with s^2 the variance of the residuals and c the number of samples that count as one. Its curvature
gives Laplace's covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np
import torch

from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES, POWERS
from evpinn_ros.core.vehicle.parameters import LIMITS, Parameters
from evpinn_ros.core.vehicle.physics import auxiliary_power

LEARNED = ("eta", "mu", "mass", "c_rr", "c_d")
ITERATIONS = 20  # at most
CONVERGED = 1e-5  # of z: far below any 1-sigma, possible in single precision
LONGEST_STEP = 0.5  # of z: a longer Gauss-Newton step is not valid
LEAST_NOISE = 60.0  # W, least 1-sigma of the residuals
CORRELATED_SAMPLES = 5.0  # correlated samples at 10 Hz that count as one
COMBINATIONS = {name: POWERS[name] for name in IDENTIFIABLE_NAMES if name != "p_aux"}

Physics: TypeAlias = Callable[[torch.Tensor], torch.Tensor]  # power, shape (n,), at z


class ParameterFit(NamedTuple):
    """Logarithms z of the parameters over their initial values."""

    log_scale: torch.Tensor  # z, shape (5,), in the order of `LEARNED`
    covariance: np.ndarray  # of z, shape (5, 5)
    converged: bool  # False if the iterations did not converge


class LogParameters:
    """The parameters of one vehicle by their logarithms."""

    def __init__(self, vehicle: Vehicle) -> None:
        priors = [vehicle.priors[name] for name in LEARNED]
        self._initial = [prior.value for prior in priors]
        self.prior_std = np.array([prior.std / prior.value for prior in priors])
        self._precision = np.diag(self.prior_std**-2.0)

    def tensors(self, log_scale: torch.Tensor, p_aux: float) -> Parameters:
        """The parameters at z, shape (5,), as tensors; P_aux, W, is given, not learned."""
        initial = torch.tensor(self._initial, dtype=log_scale.dtype, device=log_scale.device)
        return Parameters._make([*(initial * torch.exp(log_scale)), p_aux])

    def values(self, log_scale: torch.Tensor, p_aux: float) -> Parameters:
        """The parameters at z as numbers; at z = 0 the initial values of eq. 24 and 25."""
        scale = torch.exp(log_scale.detach().double()).tolist()
        scaled = [first * factor for first, factor in zip(self._initial, scale, strict=True)]
        return Parameters._make([*scaled, p_aux])

    def fit(
        self, physics: Physics, power: torch.Tensor, start: torch.Tensor, unit: float = 1.0
    ) -> ParameterFit:
        """The z, from `start`, that best fits a power, (n,), in `unit` W, and the priors."""
        log_scale, converged = start.detach().clone(), False
        for _ in range(ITERATIONS):
            curvature, slope = self._normal_equations(physics, power, log_scale, unit)
            step = np.linalg.solve(curvature, slope)
            step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), CONVERGED))
            log_scale = log_scale + torch.as_tensor(step).to(log_scale)
            converged = bool(np.abs(step).max() < CONVERGED)
            if converged:
                break
        covariance = self.covariance(physics, power, log_scale, unit)
        return ParameterFit(log_scale, covariance, converged)

    def covariance(
        self, physics: Physics, power: torch.Tensor, log_scale: torch.Tensor, unit: float = 1.0
    ) -> np.ndarray:
        """Covariance of z, shape (5, 5), from the curvature of the loss; arguments as of `fit`."""
        return np.linalg.inv(self._normal_equations(physics, power, log_scale, unit)[0])

    def _normal_equations(
        self, physics: Physics, power: torch.Tensor, log_scale: torch.Tensor, unit: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Curvature, shape (5, 5), and gradient, (5,), of the minimised sum."""
        log_scale = log_scale.detach()
        jacobian = torch.func.jacfwd(physics)(log_scale)
        rows = jacobian.double().cpu().numpy()
        with torch.no_grad():
            residual = (power - physics(log_scale)).double().cpu().numpy()
        noise = max(float(np.mean(residual**2)), (LEAST_NOISE / unit) ** 2) * CORRELATED_SAMPLES
        pulled = self._precision @ log_scale.double().cpu().numpy()
        return rows.T @ rows / noise + self._precision, rows.T @ residual / noise - pulled


def relative_std(exponents: Mapping[str, float], covariance: np.ndarray) -> float:
    """1-sigma of the logarithm of a combination, from the covariance of z, shape (5, 5)."""
    weights = np.array([exponents.get(name, 0.0) for name in LEARNED])
    return float(np.sqrt(weights @ covariance @ weights))


def standing_load(speed: np.ndarray, power: np.ndarray, otherwise: float) -> float:
    """P_aux, W: the median power at standstill (section III.C), or else `otherwise`."""
    load = auxiliary_power(speed, power)
    return otherwise if np.isnan(load) else max(load, LIMITS["p_aux"].lower)
