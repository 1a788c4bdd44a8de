"""Five parameters by least squares: the truth where the data tell it, the prior where not."""

import pytest
import torch

from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.problem import Problem, random_split
from evpinn_ros.extras.paper.scores import (
    combination_rows,
    combinations,
    drift_included,
    parameter_rows,
)
from test.extras.paper.conftest import TRUE


def fitted(log, vehicle, form=RegenForm.RECOVERY):
    split = random_split(len(log.time), 0)
    problem = Problem(log, vehicle, split, form=form, dtype=torch.float64)
    fit = problem.fit(problem.training, problem.training.power)
    assert fit.converged
    return problem, fit.log_scale, fit.covariance


@pytest.mark.parametrize("form", [RegenForm.RECOVERY, RegenForm.PRINTED])
def test_combinations_are_the_true_ones(form, make_log, vehicle):
    problem, z, _ = fitted(make_log(form=form), vehicle, form)
    determined = combinations(problem.values(z), vehicle.frontal_area, form)
    truth = combinations(TRUE, vehicle.frontal_area, form)
    assert determined["mass_over_eta"] == pytest.approx(truth["mass_over_eta"], rel=0.01)
    assert determined["mu"] == pytest.approx(truth["mu"], rel=0.01)
    assert determined["c_rr"] == pytest.approx(truth["c_rr"], rel=0.05)


def test_drift_along_the_unknown_direction_spares_the_combinations(make_log, vehicle):
    """Descent may let eta, mass and C_d go together: that is their error, not that of mass/eta."""
    problem, z, covariance = fitted(make_log(), vehicle)
    drift = torch.tensor([0.5, 0.0, 0.5, 0.0, 0.5], dtype=torch.float64)
    values = problem.values(z + drift)
    wide = drift_included(vehicle, z + drift, covariance)
    alone, together = (
        {row.name: row for row in rows(vehicle, values, wide, problem.form)}
        for rows in (parameter_rows, combination_rows)
    )
    narrow = {row.name: row for row in combination_rows(vehicle, values, covariance, problem.form)}
    assert alone["mass"].std / alone["mass"].value > 0.4
    assert together["mass_over_eta"].std < 1.5 * narrow["mass_over_eta"].std
    assert together["mass_over_eta"].determined and not alone["mass"].determined


def test_in_the_form_wheel_power_braking_is_told_with_eta(make_log, vehicle):
    form = RegenForm.WHEEL_POWER
    problem, z, covariance = fitted(make_log(form=form), vehicle, form)
    rows = combination_rows(vehicle, problem.values(z), covariance, form)
    told = next(row for row in rows if row.name == "regeneration")
    assert told.determined
    assert told.value == pytest.approx(TRUE.eta * TRUE.mu, rel=0.02)
