"""What is published is true by energy, as `simulation.truth` defines it."""

import math

import numpy as np
import pytest

from benchmarks.truth import PROFILE, VEHICLES, CarChain, compare, true_so_far
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.pinn import LearnedCar
from evpinn_ros.estimation.published import EnergySums, mass_over_eta, published
from evpinn_ros.estimation.weak_form import Warmth, spent
from evpinn_ros.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import load_vehicle
from test.signals.test_interval import polled

COPPER = 2000.0  # W / (m/s^2)^2, a strong one


def test_it_starts_at_the_priors(vehicle):
    found = published(CarFilter(vehicle), EnergySums())
    mean = [*np.exp(found.now.mean[:3]), found.now.mean[3], *np.exp(found.now.mean[4:5])]
    assert [*mean, found.now.mean[5]] == pytest.approx(vehicle.initial)


def test_efficiencies_of_a_car_with_copper_loss_are_by_energy(vehicle, intervals):
    """eta: wheel energy over that and its losses; mu: what of braking comes back."""
    car, sums = CarFilter(vehicle), EnergySums()
    car.state.mean[:, State.COPPER] = COPPER
    out = lost = offered = heat = 0.0
    mean = car.state.mean
    eta, mu = (math.exp(mean[0, state]) for state in (State.ETA, State.MU))
    for one in intervals((DriveKind.URBAN, 600.0, 1)):
        found = spent(mean, one.steps, one.conditions, Warmth(0.0, 0.0), car.constants)
        sums.add(one, found, car.weights, 0.0)
        out += found.wheel_drive[0]
        lost += found.wheel_drive[0] * (1 / eta - 1) + COPPER * found.force_drive[0]
        offered += found.wheel_brake[0]
        heat += found.wheel_brake[0] * (1 - mu * found.recovered[0])
        heat += COPPER * found.force_brake[0]
    now = published(car, sums).now.mean
    # Sums fade over ten hours, a little within these ten minutes.
    assert math.exp(now[0]) == pytest.approx(out / (out + lost), rel=2e-3)
    assert math.exp(now[1]) == pytest.approx(1 - heat / offered, rel=1e-2)
    assert math.exp(now[0]) < eta and math.exp(now[1]) < mu


def test_an_efficiency_map_is_published_by_energy():
    """Ten minutes of mixed roads with cars of three models that have a map of losses.

    Over 36 cars in town, on mixed roads and on the motorway m / eta is 0.2 % high in the mean.
    """
    found = list(compare(DriveKind.MIXED, VEHICLES, range(3), marks=(600,)))
    errors = {
        name: np.abs([one.error_percent for one in found if one.name == name])
        for name in ("mass_over_eta", "regeneration")
    }
    assert np.median(errors["mass_over_eta"]) < 2.0 and errors["mass_over_eta"].max() < 4.0
    assert np.median(errors["regeneration"]) < 3.0
    assert np.mean([one.covered for one in found]) >= 0.85


def test_true_so_far_of_a_whole_drive_is_its_truth(drive):
    whole = drive(1, 60.0)
    assert true_so_far(whole, 60) == whole.truth


def learned(vehicle, readings) -> LearnedCar:
    chain = CarChain(vehicle)
    for reading in readings:
        chain.add_reading(reading)
    return chain.car


@pytest.mark.parametrize("seed", [1, 2])
def test_a_polled_log_tells_the_same_car_as_a_dense_one(vehicle, seed):
    """10 Hz thinned to 1.2 s, each signal at a time of its own: within the sigma of both."""
    readings = simulate(DriveKind.URBAN, vehicle, 600.0, seed).readings
    dense, thin = (learned(vehicle, each) for each in (readings, list(polled(readings))))
    one, other = (published(car.filter, car.sums).now for car in (dense, thin))
    # The thin log may not be surer. It is of C_rr, by a quarter of the variance for one seed.
    for weights, least in (
        ([-1, 0, 1, 0, 0, 0], 0.9),
        ([1, 1, 0, 0, 0, 0], 0.9),
        ([0, 0, 0, 1, 0, 0], 0.7),
    ):
        away = abs(np.dot(weights, one.mean - other.mean))
        assert away < 1.5 * math.sqrt(weights @ other.covariance @ weights), weights
        assert weights @ other.covariance @ weights >= least * (weights @ one.covariance @ weights)


@pytest.mark.parametrize("kind", ["slip", "dropouts"])
def test_faults_of_sensors_move_little(vehicle, drive, kind):
    """Bursts of wheel slip, and 30 % of all readings lost: within 2 sigma of the clean drive."""
    readings = drive(2, 240.0).readings
    rng, begin, slipping = np.random.default_rng(0), readings[0].stamp_ns, []
    for reading in readings:
        second = (reading.stamp_ns - begin) / NANOSECONDS
        if kind == "dropouts" and rng.uniform() < 0.3:
            continue
        slips = kind == "slip" and isinstance(reading, SpeedReading) and second % 40 < 0.5
        slipping.append(SpeedReading(reading.stamp_ns, reading.speed * 1.4) if slips else reading)
    clean, faulty = learned(vehicle, readings), learned(vehicle, slipping)
    (log, std), (moved, _) = (mass_over_eta(car.filter, car.sums) for car in (clean, faulty))
    assert abs(moved - log) < 2 * std


@pytest.mark.parametrize(("name", "most"), [("nissan_leaf", 0.2), ("generic", 0.05)])
def test_motor_torque_tells_the_mass_in_kilograms(name, most):
    """Of its prior share little is left, and the truth is within its interval."""
    model, shares = load_vehicle(name), {}
    for torque in (False, True):
        drive = simulate(
            DriveKind.MIXED, model, 600.0, 4, motor_torque=torque, can_profile=PROFILE
        )
        chain = CarChain(model)
        for reading in drive.readings:
            chain.add_reading(reading)
        mass = chain.parameters().parameters["mass"]
        shares[torque] = mass.prior_share
    assert shares[True] < most and shares[True] < 0.5 * shares[False]
    assert mass.state.value == "valid"
    assert abs(mass.value - drive.truth.parameters.mass) < 2.0 * mass.std
