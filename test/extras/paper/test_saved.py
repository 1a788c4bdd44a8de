"""What was found goes into the car: the same function for the node, a valid vehicle file."""

from dataclasses import replace
import json

import numpy as np
import pytest

from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, OnlineEstimator
from evpinn_ros.core.estimation.state_file import read_state
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.core.vehicle.physics import RegenForm, battery_power
from evpinn_ros.extras.paper.experiment import Experiment
from evpinn_ros.extras.paper.optimizers import OptimizerName
from evpinn_ros.extras.paper.run import (
    possible,
    results_of,
    write_estimator_state,
    write_vehicle_file,
)
from evpinn_ros.extras.paper.settings import Settings


@pytest.fixture(scope="module", params=list(OptimizerName))
def outcome(request, reproduced):
    return reproduced(request.param)


def test_vehicle_file_is_valid_and_holds_what_was_found(outcome, tmp_path):
    path = tmp_path / "found.yaml"
    write_vehicle_file(path, outcome, "drive.csv")
    read = load_vehicle(path)
    values = possible(outcome.training.values, outcome.settings.form)
    for name in ("eta", "mass", "c_rr", "c_d", "p_aux"):
        assert getattr(read.initial, name) == pytest.approx(getattr(values, name), rel=1e-6)
    assert 0.7 < read.initial.mu <= 1.0  # that of `wheel_power`, whatever the experiment's form
    assert read.frontal_area == outcome.vehicle.frontal_area
    assert read.can_profile == outcome.vehicle.can_profile
    assert "drive.csv" in read.priors["eta"].source


@pytest.mark.parametrize("form", RegenForm)
def test_an_impossible_eta_slides_back_without_changing_power(form):
    fitted = Parameters(eta=1.25, mu=0.6, mass=1500.0, c_rr=0.01, c_d=0.3, p_aux=800.0)
    slid = possible(fitted, form)
    assert slid.eta == 1.0
    speed, acceleration = np.array([5.0, 20.0, 30.0]), np.array([1.0, -1.0, 0.0])
    powers = [
        battery_power(
            speed, acceleration, parameters, area=2.2, air_density=1.2, form=form, beta=-0.045
        )
        for parameters in (fitted, slid)
    ]
    assert powers[0] == pytest.approx(powers[1])


def test_state_of_another_reading_of_eq_21_is_refused(outcome, tmp_path):
    path = tmp_path / "state.json"
    write_estimator_state(path, outcome)
    settings = EstimatorSettings(mode=Mode.PAPER, regen_form=RegenForm.PRINTED)
    estimator = OnlineEstimator(outcome.vehicle, settings, InlineWorker(lambda: 0.0))
    with pytest.raises(ValueError, match="regen_form 'recovery', not for regen_form 'printed'"):
        estimator.restore(read_state(path))


def test_finished_trainings_are_not_run_again(make_log, vehicle, tmp_path):
    settings = Settings(OptimizerName.GAUSS_NEWTON, epochs=4, energy_epochs=4)
    first = Experiment(make_log(), vehicle, settings, tmp_path).run(lambda *_: None)
    kept = sorted(path.name for path in tmp_path.iterdir())
    told: list[str] = []
    again = Experiment(make_log(), vehicle, settings, tmp_path).run(
        lambda title, *_: told.append(title)
    )
    assert not told
    assert results_of(again) == results_of(first)
    other = replace(settings, seed=1)
    Experiment(make_log(), vehicle, other, tmp_path).run(lambda title, *_: told.append(title))
    assert set(told) == {"power network", "chronological split", "energy networks"}
    assert set(kept) < {path.name for path in tmp_path.iterdir()}  # nothing was thrown away


@pytest.mark.parametrize(
    ("speed", "untold"),
    [
        (np.full(300, 20.0), {"mass_over_eta", "drag_area_over_eta", "c_rr", "mu"}),
        (np.linspace(1.0, 30.0, 300), {"mu"}),
    ],
    ids=["constant speed", "no braking"],
)
def test_what_a_poor_drive_does_not_tell_is_said(speed, untold, make_log, vehicle, tmp_path):
    settings = Settings(OptimizerName.GAUSS_NEWTON, epochs=4, energy_epochs=2)
    results = results_of(
        Experiment(make_log(speed), vehicle, settings, tmp_path).run(lambda *_: None)
    )
    json.dumps(results, allow_nan=False)
    rows = results["combinations"]
    assert not any(rows[name]["determined"] for name in untold)
