"""How good a power is, and the yardsticks the paper leaves out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from evpinn_ros.energy.quadrature import CompensatedSum
from evpinn_ros.estimation.paper import LEARNED
from evpinn_ros.reproduction.drive_log import DriveLog
from evpinn_ros.reproduction.parameter_fit import fit_parameters, prior_std
from evpinn_ros.reproduction.problem import PowerScale, Problem
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.parameters import Parameters
from evpinn_ros.vehicle.physics import RegenForm, battery_power

# The combinations that enter eq. 21, as exponents of the parameters.
COMBINATIONS = {
    "mass_over_eta": {"mass": 1.0, "eta": -1.0},
    "drag_area_over_eta": {"c_d": 1.0, "eta": -1.0},
    "c_rr": {"c_rr": 1.0},
    "mu": {"mu": 1.0},
}
MAX_STEP = 2.5  # s: samples further apart are not joined by a line


class PowerScore(NamedTuple):
    """A predicted power against the measured one.

    Attributes:
        rmse_w: W.
        mae_w: W.
        r2: 1 for perfect, 0 for the mean; None when the measured power is constant.
        data_loss: mean square of the error in the units of Tables II and III.
        energy_error_percent: of the sum over these samples; None when that sum is zero.
    """

    rmse_w: float
    mae_w: float
    r2: float | None
    data_loss: float
    energy_error_percent: float | None


def power_score(predicted: np.ndarray, measured: np.ndarray, scale: PowerScale) -> PowerScore:
    """Score powers, W, shape (n,) each."""
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


def interpolated_power(training: DriveLog, validation: DriveLog) -> np.ndarray:
    """The null of a random split: a line in time between the neighbours trained on, W."""
    return np.asarray(np.interp(validation.time, training.time, training.power))


def physics_power(
    log: DriveLog, vehicle: Vehicle, parameters: Parameters, form: RegenForm
) -> np.ndarray:
    """Battery power of eq. 21, W, shape (n,)."""
    power = battery_power(
        log.speed,
        log.acceleration,
        parameters,
        area=vehicle.frontal_area,
        air_density=vehicle.air_density,
        form=form,
        beta=vehicle.beta,
    )
    return np.asarray(power)


def least_squares_power(problem: Problem) -> tuple[np.ndarray, Parameters]:
    """Eq. 21 fitted to the training data alone: its power on the validation data, W.

    Five numbers against the network's 50 049, and no time among its inputs.
    """
    fit = fit_parameters(problem, problem.training, problem.training.power)
    with torch.no_grad():
        normalised = (
            problem.physics(problem.validation.motion, fit.log_scale).double().cpu().numpy()
        )
    power = problem.scale.middle + problem.scale.half_range * normalised
    return np.asarray(power), problem.values(fit.log_scale)


def exact_energy(time: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Energy since the first sample, J, shape (n,): trapezoids with compensated summation.

    With P(t + dt/2) between two samples on their line, RK4 is this very sum.
    """
    steps = np.diff(time)
    parts = np.where(steps <= MAX_STEP, 0.5 * (power[1:] + power[:-1]) * steps, 0.0)
    total = CompensatedSum()
    energy = [0.0]
    for part in parts:
        total.add(float(part))
        energy.append(total.value)
    return np.array(energy)


def drift_included(
    vehicle: Vehicle, log_scale: torch.Tensor, covariance: np.ndarray
) -> np.ndarray:
    """Covariance of z plus how far it drifted without the data's support, shape (5, 5).

    No prior holds the paper's parameters: where the data say nothing, descent lets them go.
    """
    share = np.minimum(1.0, np.diag(covariance) / prior_std(vehicle) ** 2)
    drift = share * log_scale.detach().double().cpu().numpy()
    return covariance + np.outer(drift, drift)


class ParameterRow(NamedTuple):
    """One parameter as in Table V, with what the paper leaves out.

    Attributes:
        name: of the parameter.
        initial: guess of eq. 24, 25.
        value: found.
        std: 1-sigma from the curvature of the physics loss and the priors.
        prior_share: variance left of the prior's: 0 all data, 1 all prior.
        determined: whether the data tell it.
    """

    name: str
    initial: float
    value: float
    std: float
    prior_share: float
    determined: bool


def parameter_rows(
    vehicle: Vehicle, values: Parameters, covariance: np.ndarray, undetermined_above: float
) -> list[ParameterRow]:
    """Rows of Table V from the covariance of the log parameters, shape (5, 5)."""
    rows = []
    for index, name in enumerate(LEARNED):
        prior = vehicle.priors[name]
        variance = float(covariance[index, index])
        share = min(1.0, variance / (prior.std / prior.value) ** 2)
        value = float(getattr(values, name))
        rows.append(
            ParameterRow(
                name, prior.value, value, variance**0.5 * value, share, share < undetermined_above
            )
        )
    return rows


def combination_rows(
    vehicle: Vehicle, values: Parameters, covariance: np.ndarray, undetermined_above: float
) -> list[ParameterRow]:
    """The combinations that enter eq. 21: m/eta, A C_d/eta, C_rr and mu, likewise."""
    prior_covariance = np.diag(prior_std(vehicle) ** 2)
    before, after = (combinations(p, vehicle.frontal_area) for p in (vehicle.initial, values))
    rows = []
    for name, weights in COMBINATIONS.items():
        vector = np.array([weights.get(parameter, 0.0) for parameter in LEARNED])
        variance = float(vector @ covariance @ vector)
        share = min(1.0, variance / float(vector @ prior_covariance @ vector))
        rows.append(
            ParameterRow(
                name,
                before[name],
                after[name],
                variance**0.5 * after[name],
                share,
                share < undetermined_above,
            )
        )
    return rows


def combinations(parameters: Parameters, area: float) -> dict[str, float]:
    """Values of `COMBINATIONS`; area in m^2."""
    values = {
        "mass_over_eta": parameters.mass / parameters.eta,
        "drag_area_over_eta": area * parameters.c_d / parameters.eta,
        "c_rr": parameters.c_rr,
        "mu": parameters.mu,
    }
    return {name: float(value) for name, value in values.items()}
