"""The true values are what their definitions say, and cars can be made to have wished ones."""

from dataclasses import astuple

import numpy as np
import pytest

from evpinn_ros.simulation.car import STEP
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.simulation.truth import (
    LEAST_AUXILIARY,
    PLAUSIBLE_ETA,
    PLAUSIBLE_MU,
    plausible_parameters,
    prior_parameters,
)
from evpinn_ros.vehicle.files import load_vehicle, vehicle_names
from evpinn_ros.vehicle.parameters import LIMITS
from evpinn_ros.vehicle.physics import GRAVITY

CAR = load_vehicle("tesla_model_3_lr")


def test_the_five_parameter_form_spends_the_energy_of_the_drive(drive):
    """Fed with true wheel power: eta, mu, p_aux and the loss of turning are every joule."""
    parameters, trace = drive.truth.parameters, drive.trace
    wheel = trace.wheel_power
    form = np.where(wheel > 0, wheel / parameters.eta, parameters.mu * wheel) + parameters.p_aux
    spent = np.sum(trace.power - trace.no_load_loss)
    assert np.sum(form) == pytest.approx(spent, rel=1e-9)


def test_definitions_recomputed_interval_by_interval(urban):
    trace, total = urban.trace, {"out": 0.0, "in": 0.0, "braked": 0.0, "back": 0.0, "other": 0.0}
    for wheel, load, friction, auxiliary in zip(
        trace.wheel_power.tolist(),
        trace.load_loss.tolist(),
        trace.friction_power.tolist(),
        trace.auxiliary.tolist(),
        strict=True,
    ):
        total["other"] += auxiliary
        if wheel > 0:
            total["out"] += wheel
            total["in"] += wheel + load
        elif wheel < 0:
            total["braked"] -= wheel
            total["back"] -= wheel + friction + load
    parameters = urban.truth.parameters
    assert parameters.eta == pytest.approx(total["out"] / total["in"], rel=1e-9)
    assert parameters.mu == pytest.approx(total["back"] / total["braked"], rel=1e-9)
    assert parameters.p_aux == pytest.approx(total["other"] / len(trace.power), rel=1e-9)


def test_true_rolling_and_mass(drive):
    parameters, trace, motion = drive.truth.parameters, drive.trace, drive.trace.motion
    weight = parameters.mass * GRAVITY * np.cos(motion.grade)
    work = parameters.c_rr * np.sum(weight * motion.speed) * STEP
    assert work == pytest.approx(np.sum(trace.rolling_power) * STEP, rel=1e-9)
    assert (parameters.mass, parameters.c_d) == (drive.car.mass, drive.car.c_d)


def test_identifiable_combinations_belong_to_the_parameters(drive):
    parameters, combined = drive.truth.parameters, drive.truth.identifiable
    assert combined.mass_over_eta == pytest.approx(parameters.mass / parameters.eta)
    assert combined.regeneration == pytest.approx(parameters.eta * parameters.mu)
    area = drive.car.frontal_area
    assert combined.drag_area_over_eta == pytest.approx(area * parameters.c_d / parameters.eta)


@pytest.mark.parametrize("kind", DriveKind)
def test_a_car_gets_the_wished_parameters(kind):
    wish = {"eta": 0.7, "mu": 0.5, "mass": 2100, "c_rr": 0.011, "c_d": 0.25, "p_aux": 1300}
    truth = simulate(kind, CAR, 200.0, 5, car=wish).truth.parameters
    assert truth._asdict() == pytest.approx(wish, rel=1e-5)


def test_what_a_car_cannot_do_is_told_truly():
    wish = {"eta": 0.8, "mu": 1.0, "p_aux": 0.0}
    truth = simulate(DriveKind.URBAN, CAR, 120.0, 5, car=wish).truth.parameters
    assert 0.6 < truth.mu < 0.9 and truth.p_aux == pytest.approx(LEAST_AUXILIARY)


def test_a_car_driven_again_is_the_same_car(urban):
    again = simulate(DriveKind.HIGHWAY, CAR, 120.0, 77, car=urban.car)
    assert again.car is urban.car
    assert again.truth.parameters.mass == urban.truth.parameters.mass
    assert again.truth.parameters.eta != urban.truth.parameters.eta  # another drive


@pytest.mark.parametrize("name", vehicle_names())
def test_plausible_cars_are_plausible(name):
    vehicle, rng = load_vehicle(name), np.random.default_rng(1)
    for _ in range(50):
        drawn = plausible_parameters(vehicle, rng)
        assert PLAUSIBLE_ETA[0] <= drawn.eta <= PLAUSIBLE_ETA[1]
        assert PLAUSIBLE_MU[0] <= drawn.mu <= PLAUSIBLE_MU[1]
        for key in ("mass", "c_rr", "c_d", "p_aux"):
            prior = vehicle.priors[key]
            assert abs(getattr(drawn, key) - prior.value) <= 1.5 * prior.std


def test_draws_from_the_priors_have_their_mean_and_spread():
    """Of priors that their limits hardly cut, as the paper's are."""
    car, rng = CAR.as_published, np.random.default_rng(1)
    drawn = np.array([prior_parameters(car, rng) for _ in range(4000)])
    for column, (name, prior) in zip(drawn.T, car.priors.items(), strict=True):
        assert column.mean() == pytest.approx(prior.value, abs=0.1 * prior.std)
        assert column.std() == pytest.approx(prior.std, rel=0.1)
        assert LIMITS[name].lower < column.min() and column.max() < LIMITS[name].upper


def test_drives_from_prior_draws_have_these_truths():
    rng = np.random.default_rng(3)
    for seed in range(6):
        wish = prior_parameters(CAR, rng)
        truth = simulate(DriveKind.URBAN, CAR, 60.0, seed, car=wish._asdict()).truth.parameters
        assert truth._replace(mu=wish.mu) == pytest.approx(wish, rel=1e-5)
        assert truth.mu <= wish.mu + 1e-5
        assert np.all(np.isfinite(astuple(simulate(DriveKind.URBAN, CAR, 60.0, seed).truth)[0]))
