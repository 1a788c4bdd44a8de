"""Scores of predicted power, and baselines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch

from evpinn_ros.core.estimation.parameter_set import VALID_BELOW
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import identifiable
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.energy_network import MAX_GAP
from evpinn_ros.extras.paper.log_parameters import (
    COMBINATIONS,
    LEARNED,
    LogParameters,
    relative_std,
)
from evpinn_ros.extras.paper.problem import Problem, Scale

GAUGE_FREE = ("c_rr", "mu")  # parameters that do not scale with others in eq. 21
KNOWN_BELOW = VALID_BELOW  # remaining share of the prior's variance if data determine a value


class PowerScore(NamedTuple):
    """A predicted power against the measured one."""

    rmse_w: float  # W
    mae_w: float  # W
    r2: float | None  # 1 for perfect, 0 for the mean; None if the measured power is constant
    data_loss: float  # mean square error in the units of Tables II and III
    energy_error_percent: float | None  # of the sum over these samples; None if that sum is zero


def power_score(predicted: np.ndarray, measured: np.ndarray, scale: Scale) -> PowerScore:
    """Score predicted against measured powers, W, shape (n,) each."""
    error = predicted - measured
    spread = float(np.sum((measured - measured.mean()) ** 2))
    total = float(measured.sum())
    mean_square = float(np.mean(error**2))
    return PowerScore(
        rmse_w=mean_square**0.5,
        mae_w=float(np.mean(np.abs(error))),
        r2=1.0 - float(np.sum(error**2)) / spread if spread > 0 else None,
        data_loss=mean_square / scale.half_range**2,
        energy_error_percent=100.0 * float(error.sum()) / abs(total) if total else None,
    )


def least_squares_power(problem: Problem) -> tuple[np.ndarray, Parameters]:
    """Power of the validation data, W, (n,), and parameters, by eq. 21 fitted to training data."""
    fit = problem.fit(problem.training, problem.training.power)
    power = problem.physics(problem.validation, fit.log_scale)
    return problem.scale.restored(power), problem.values(fit.log_scale)


def exact_energy(time: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Energy since the first sample, J, shape (n,), by trapezoids: RK4 between samples."""
    steps = np.diff(time)
    parts = np.where(steps <= MAX_GAP, 0.5 * (power[1:] + power[:-1]) * steps, 0.0)
    return np.concatenate(([0.0], np.cumsum(parts)))


def drift_included(
    vehicle: Vehicle, log_scale: torch.Tensor, covariance: np.ndarray
) -> np.ndarray:
    """Covariance of z, shape (5, 5), with its drift C S^-1 z in undetermined directions."""
    z = log_scale.detach().double().cpu().numpy()
    drift = covariance @ (z / LogParameters(vehicle).prior_std ** 2)
    return covariance + np.outer(drift, drift)


class TableFiveRow(NamedTuple):
    """One parameter as in Table V, with the figures that the paper leaves out."""

    name: str  # of the parameter
    initial: float  # value of eq. 24, 25
    value: float  # learned
    std: float  # 1-sigma from the curvature of the physics loss and the priors
    prior_share: float  # remaining share of the prior's variance: 0 all data, 1 all prior
    determined: bool  # whether the data determine it


def parameter_rows(
    vehicle: Vehicle, values: Parameters, covariance: np.ndarray, form: RegenForm
) -> list[TableFiveRow]:
    """Rows of Table V; eta, mass and C_d scale together, so no data determine one of them."""
    free = GAUGE_FREE if form is not RegenForm.WHEEL_POWER else ("c_rr",)
    rows = []
    for index, name in enumerate(LEARNED):
        prior = vehicle.priors[name]
        variance = float(covariance[index, index])
        share = min(1.0, variance / (prior.std / prior.value) ** 2)
        value = float(getattr(values, name))
        is_known = name in free and share < KNOWN_BELOW
        rows.append(TableFiveRow(name, prior.value, value, variance**0.5 * value, share, is_known))
    return rows


def combination_rows(
    vehicle: Vehicle, values: Parameters, covariance: np.ndarray, form: RegenForm
) -> list[TableFiveRow]:
    """Rows of the combinations in eq. 21, in the form of `parameter_rows`."""
    before_data = np.diag(LogParameters(vehicle).prior_std ** 2)
    area = vehicle.frontal_area
    before, after = (combinations(p, area, form) for p in (vehicle.initial, values))
    rows = []
    for name, exponents in _exponents(form).items():
        relative = relative_std(exponents, covariance)
        share = min(1.0, (relative / relative_std(exponents, before_data)) ** 2)
        std = relative * after[name]
        rows.append(TableFiveRow(name, before[name], after[name], std, share, share < KNOWN_BELOW))
    return rows


def combinations(parameters: Parameters, area: float, form: RegenForm) -> dict[str, float]:
    """Values of the combinations in this form of eq. 21; area in m^2."""
    values = {**identifiable(parameters, area)._asdict(), "mu": parameters.mu}
    return {name: float(values[name]) for name in _exponents(form)}


def _exponents(form: RegenForm) -> Mapping[str, Mapping[str, float]]:
    """Exponents by combination of a form; only `wheel_power` recovers braking by eta mu."""
    if form is RegenForm.WHEEL_POWER:
        return COMBINATIONS
    others = {
        name: exponents for name, exponents in COMBINATIONS.items() if name != "regeneration"
    }
    return {**others, "mu": {"mu": 1.0}}
