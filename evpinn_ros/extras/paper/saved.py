"""Results for the car: a start for the estimator node, and a vehicle file."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from evpinn_ros.common.saved_fields import plain
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, OnlineEstimator
from evpinn_ros.core.estimation.state_file import write_state
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.vehicle.files import write_vehicle
from evpinn_ros.core.vehicle.parameters import LIMITS, PARAMETER_NAMES, Parameters, Prior
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.experiment import Outcome
from evpinn_ros.extras.paper.learner import POWER_SCALE, SPEED_SCALE, WINDOW, SavedPaper
from evpinn_ros.extras.paper.log_parameters import LEARNED
from evpinn_ros.extras.paper.network import PowerNetwork
from evpinn_ros.extras.paper.problem import Problem

LEAST_RELATIVE_STD = 0.005  # of a prior written: no car is the same from one day to the next


@torch.no_grad()
def window_network(problem: Problem, network: PowerNetwork) -> PowerNetwork:
    """An equal network in the units of `extras.paper.learner`, float32, as all are affine."""
    copied = deepcopy(network).cpu().double()
    first, last = copied.layers[0], copied.layers[-1]
    end = float(problem.log.time[-1])
    middle, half_range = torch.tensor(problem.inputs, dtype=torch.float64).T
    at_now = torch.tensor([0.0, end], dtype=torch.float64)
    first.bias.add_(first.weight @ ((at_now - middle) / half_range))
    first.weight.mul_(torch.tensor([SPEED_SCALE, WINDOW], dtype=torch.float64) / half_range)
    last.weight.mul_(problem.scale.half_range / POWER_SCALE)
    last.bias.copy_((problem.scale.middle + problem.scale.half_range * last.bias) / POWER_SCALE)
    return copied.float()


def write_estimator_state(path: Path, outcome: Outcome) -> None:
    """Write a `mode: paper` state for `evpinn replay --state` and the node.

    Raises OSError, or ValueError if the estimator would not take it.
    """
    settings = EstimatorSettings(mode=Mode.PAPER, regen_form=outcome.settings.form)
    estimator = OnlineEstimator(outcome.vehicle, settings, InlineWorker(lambda: 0.0))
    problem, optimizer = outcome.training.problem, outcome.training.optimizer
    residual = outcome.predicted_power - outcome.log.power
    learner = SavedPaper(
        network=window_network(problem, optimizer.network).vector().detach().numpy(),
        log_scale=optimizer.log_scale.detach().cpu().numpy(),
        p_aux=problem.p_aux,
        covariance=outcome.covariance,
        variance=float(np.mean(residual**2)),
        fresh=False,
        regen_form=outcome.settings.form.value,
    )
    state = plain(replace(estimator.saved(), learner=learner))
    estimator.restore(state)
    write_state(path, state)


def write_vehicle_file(path: Path, outcome: Outcome, log_name: str) -> None:
    """Write the vehicle with the learned parameters as its priors, and read it back.

    Its mu is that of the form `wheel_power`, fitted to the same samples. Raises OSError or
    InputError.
    """
    vehicle = outcome.vehicle
    source = f"evpinn reproduce {log_name}, from vehicle file {vehicle.key}"
    problem = Problem(
        outcome.log, vehicle, outcome.training.problem.split, form=RegenForm.WHEEL_POWER
    )
    fit = problem.fit(problem.training, problem.training.power)
    fitted = outcome.values._replace(mu=problem.values(fit.log_scale).mu)
    values = possible(fitted, outcome.settings.form)
    variance = np.diag(outcome.covariance).copy()
    variance[LEARNED.index("mu")] = np.diag(fit.covariance)[LEARNED.index("mu")]
    relative = dict(zip(LEARNED, np.sqrt(variance).tolist(), strict=True))
    priors = {
        name: Prior(
            float(getattr(values, name)),
            float(getattr(values, name)) * max(relative[name], LEAST_RELATIVE_STD)
            if name in relative
            else vehicle.priors[name].std,
            source,
        )
        for name in PARAMETER_NAMES
    }
    write_vehicle(path, replace(vehicle, priors=priors))


def possible(values: Parameters, form: RegenForm) -> Parameters:
    """The nearest possible car: eta <= 1 and everything within its limits.

    Sliding (eta, mass, C_d) back together changes no power; in `wheel_power` mu slides the other
    way.
    """
    excess = max(1.0, values.eta / LIMITS["eta"].upper)
    slid = values._replace(
        eta=values.eta / excess,
        mu=values.mu * (excess if form is RegenForm.WHEEL_POWER else 1.0),
        mass=values.mass / excess,
        c_d=values.c_d / excess,
    )
    return Parameters(
        *(float(np.clip(getattr(slid, name), *LIMITS[name])) for name in PARAMETER_NAMES)
    )
