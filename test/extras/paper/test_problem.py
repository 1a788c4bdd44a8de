"""Eq. 22 on a drive: its terms, its gradients, its splits."""

import numpy as np
import pytest
import torch

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.core.vehicle.physics import RegenForm, battery_power
from evpinn_ros.extras.paper.network import PHYSICS_LOSS, PowerNetwork
from evpinn_ros.extras.paper.problem import Problem, random_split

WIDTHS = (2, 7, 7, 1)
Z = torch.tensor([0.1, -0.2, 0.05, 0.03, -0.04], dtype=torch.float64)


def test_loss_is_eq_22_in_normalised_units(make_log, vehicle):
    whole, network = make_log(), PowerNetwork(WIDTHS, seed=2, dtype=torch.float64)
    problem = Problem(whole, vehicle, random_split(len(whole.time), 3), dtype=torch.float64)
    log = chosen_rows(problem.log, problem.split.validation)
    middle = (problem.log.power.max() + problem.log.power.min()) / 2
    half = (problem.log.power.max() - problem.log.power.min()) / 2
    inputs = torch.tensor(np.stack((log.speed, log.time), axis=1))
    with torch.no_grad():
        output = network(inputs).numpy()
    physics = battery_power(
        log.speed,
        log.acceleration,
        problem.values(Z),
        area=vehicle.frontal_area,
        air_density=vehicle.air_density,
        form=RegenForm.RECOVERY,
        beta=vehicle.beta,
    )
    data_term = np.mean(((log.power - middle) / half - output) ** 2)
    physics_term = PHYSICS_LOSS * np.mean(((physics - middle) / half - output) ** 2)
    losses = problem.losses(problem.validation, network, Z)
    assert losses == pytest.approx((data_term + physics_term, data_term, physics_term), rel=1e-12)
