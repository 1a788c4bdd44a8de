"""The true values are what their definitions say, and cars can be made to have wished ones."""

import numpy as np
import pytest

from evpinn_ros.core.estimation.states import PHYSICS
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.identifiable import prior_identifiable
from evpinn_ros.core.vehicle.parameters import LIMITS
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from evpinn_ros.replays.simulation.truth import combinations, prior_parameters

CAR = load_vehicle("tesla_model_3_lr")


def test_a_car_that_is_eq_21_has_its_own_parameters():
    """Half an hour of mixed roads, driving and braking told apart by the car itself."""
    equation = equation_of(CAR)
    rng, count = np.random.default_rng(0), 1800
    speed = np.clip(15 + np.cumsum(rng.normal(0, 0.8, count)), 0.0, 35.0)
    climb = speed * 0.02 * np.sin(np.arange(count) / 60.0)
    second = np.ones(count)
    wheels = equation.wheels(second, speed, speed**3, speed * np.gradient(speed), climb, 1.2)
    truth = equation.mean[PHYSICS] * [1.1, 0.9, 1.05, 1.0] + [0.0, 0.0, 0.0, 0.03]
    combined = combinations(equation, wheels, second, np.asarray(wheels.terms) @ truth)
    drag, rolling, mass, _ = truth
    assert combined["mass_over_eta"] == pytest.approx(mass, rel=2e-3)
    assert combined["rolling_over_eta"] == pytest.approx(rolling, rel=0.02)
    assert combined["drag_area_over_eta"] == pytest.approx(drag, rel=0.01)


def test_what_a_short_drive_does_not_determine_stays_that_of_the_vehicle_file():
    truth = simulate(DriveKind.URBAN, CAR, 10.0, 5).truth.identifiable
    prior, _ = prior_identifiable(CAR)
    assert truth.drag_area_over_eta == pytest.approx(prior.drag_area_over_eta, rel=0.1)


def test_identifiable_combinations_belong_to_the_parameters(drive):
    parameters, combined = drive.truth.parameters, drive.truth.identifiable
    assert combined.mass_over_eta == pytest.approx(parameters.mass / parameters.eta)
    assert combined.regeneration == pytest.approx(parameters.eta * parameters.mu)
    area = drive.car.frontal_area
    assert combined.drag_area_over_eta == pytest.approx(area * parameters.c_d / parameters.eta)


@pytest.mark.parametrize("kind", DriveKind)
def test_a_car_gets_nearly_the_wished_parameters(kind):
    """As nearly as ten minutes of such a drive determine them."""
    wish = {"eta": 0.7, "mu": 0.5, "mass": 2100, "c_rr": 0.011, "c_d": 0.25, "p_aux": 1300}
    truth = simulate(kind, CAR, 600.0, 5, car=wish).truth.parameters._asdict()
    most = {"eta": 0.01, "mu": 0.01, "mass": 1e-9, "c_rr": 0.02, "p_aux": 1e-5}
    if kind is not DriveKind.URBAN:  # it hardly brakes
        most["mu"] = 0.1
    for name, share in most.items():
        assert truth[name] == pytest.approx(wish[name], rel=share), name


def test_draws_from_the_priors_have_their_mean_and_spread():
    """Priors that their limits hardly cut, as the paper's are."""
    car, rng = CAR.as_published, np.random.default_rng(1)
    drawn = np.array([prior_parameters(car, rng) for _ in range(4000)])
    for column, (name, prior) in zip(drawn.T, car.priors.items(), strict=True):
        assert column.mean() == pytest.approx(prior.value, abs=0.1 * prior.std)
        assert column.std() == pytest.approx(prior.std, rel=0.1)
        assert LIMITS[name].lower < column.min() and column.max() < LIMITS[name].upper
