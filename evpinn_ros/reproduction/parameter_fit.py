"""The five parameters that fit eq. 21 to a power best: no descent needed.

The physics residual is algebraic, so for any given power, measured or a network's, the best
parameters are a least-squares problem in five unknowns. The priors of the vehicle file hold the
direction that no data determine, (eta, mass, C_d) scaled together:

    minimise over z   sum (P - P_physics(z))^2 / (c s^2) + sum (z_i / prior_i)^2,

z the logarithm of a parameter over its initial value, s^2 the variance of the residuals and c the
number of neighbours that say the same. Its curvature is Laplace's covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from evpinn_ros.estimation.paper import CORRELATED_SAMPLES, LEARNED, LEAST_NOISE
from evpinn_ros.reproduction.problem import Problem, Samples
from evpinn_ros.vehicle.files import Vehicle

ITERATIONS = 20  # at most
CONVERGED = 1e-5  # of z: far below any 1-sigma, and within reach of single precision
LONGEST_STEP = 0.5  # of z: a Gauss-Newton step further than this leaves where it is valid


class ParameterFit(NamedTuple):
    """Logarithms z of the parameters over their initial values."""

    log_scale: torch.Tensor  # z, shape (5,), in the order of `estimation.paper.LEARNED`
    covariance: np.ndarray  # of z, shape (5, 5)
    converged: bool  # False when the iterations did not settle


def prior_std(vehicle: Vehicle) -> np.ndarray:
    """1-sigma of z before the data, shape (5,)."""
    priors = [vehicle.priors[name] for name in LEARNED]
    return np.array([prior.std / prior.value for prior in priors])


def fit_parameters(
    problem: Problem, samples: Samples, power: torch.Tensor, start: torch.Tensor | None = None
) -> ParameterFit:
    """Gauss-Newton on z.

    `power`, normalised, shape (n,), is measured or what a network says at the samples; `start` is
    the z to begin at, the initial values if None.
    """
    log_scale = torch.zeros(len(LEARNED), dtype=problem.dtype, device=problem.device)
    if start is not None:
        log_scale = start.detach().clone()
    precision = np.diag(prior_std(problem.vehicle) ** -2.0)
    converged = False
    for _ in range(ITERATIONS):
        curvature, slope = _normal_equations(problem, samples, power, log_scale)
        z = log_scale.double().cpu().numpy()
        step = np.linalg.solve(curvature + precision, slope - precision @ z)
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), CONVERGED))
        log_scale = log_scale + torch.as_tensor(step, dtype=problem.dtype, device=problem.device)
        converged = bool(np.abs(step).max() < CONVERGED)
        if converged:
            break
    return ParameterFit(
        log_scale, laplace_covariance(problem, samples, power, log_scale), converged
    )


def laplace_covariance(
    problem: Problem, samples: Samples, power: torch.Tensor, log_scale: torch.Tensor
) -> np.ndarray:
    """Covariance of z, shape (5, 5): curvature of the physics loss plus the priors."""
    curvature, _ = _normal_equations(problem, samples, power, log_scale)
    return np.linalg.inv(curvature + np.diag(prior_std(problem.vehicle) ** -2.0))


def _normal_equations(
    problem: Problem, samples: Samples, power: torch.Tensor, log_scale: torch.Tensor
) -> tuple[np.ndarray, np.ndarray]:
    """J^T J and J^T r over the variance that one sample counts with."""
    jacobian = torch.func.jacfwd(lambda z: problem.physics(samples.motion, z))(log_scale.detach())
    rows = jacobian.double().cpu().numpy()
    with torch.no_grad():
        residual = (power - problem.physics(samples.motion, log_scale)).double().cpu().numpy()
    least = (LEAST_NOISE / problem.scale.half_range) ** 2
    variance = max(float(np.mean(residual**2)), least) * CORRELATED_SAMPLES
    return rows.T @ rows / variance, rows.T @ residual / variance
