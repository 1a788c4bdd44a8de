"""What is published is the projection of what was learned, as `simulation.truth` defines it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
import math

import numpy as np
import pytest

from benchmarks.truth import PROFILE, VEHICLES, CarChain, compare
from evpinn_ros.core.estimation.bands import Bands
from evpinn_ros.core.estimation.breakdown import climb_as_rolling
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.estimation.parameter_set import parameter_set
from evpinn_ros.core.estimation.posterior import NETWORK_STDS, initial_state
from evpinn_ros.core.estimation.published import (
    C_D,
    C_RR,
    MASS,
    Driven,
    Published,
    project,
    published,
)
from evpinn_ros.core.estimation.states import NETWORK, State
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    MotorReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from test.core.estimation.conftest import measured
from test.core.signals.test_interval import polled


def test_it_starts_at_the_priors(vehicle):
    equation = equation_of(vehicle)
    prior = published(initial_state(equation), equation, Driven.nowhere())
    mean = [*np.exp(prior.now.mean[:3]), prior.now.mean[3], *np.exp(prior.now.mean[4:5])]
    assert [*mean, prior.now.mean[5]] == pytest.approx(vehicle.initial, rel=1e-6)


@pytest.mark.parametrize(
    ("deviates", "growth"),
    [([], 1.0), ([2.0] * 8, math.sqrt(3.0)), ([0.5] * 8, 1.0), ([4.0] * 40, 2.0)],
    ids=["none yet", "twice too far", "nearer than said", "never less sure than before driving"],
)
def test_sigmas_grow_as_rehearsed_dropouts_err(vehicle, deviates, growth):
    """By the root of the mean square, with four cases of 1; a quarter of the prior is left."""
    equation, bands = equation_of(vehicle), Bands()
    for deviate in deviates:
        bands = replace(bands, dropout=bands.dropout.after(deviate))
    state = initial_state(equation)
    learned = replace(state, covariance=state.covariance / 4.0)
    first, grown = (
        published(replace(learned, bands=known), equation, Driven.nowhere())
        for known in (Bands(), bands)
    )
    own = np.sqrt(np.diag(grown.now.covariance) / np.diag(first.now.covariance))
    assert own[[MASS, C_RR, C_D]] == pytest.approx(growth, rel=1e-6)
    shares = []
    for estimate in (first, grown):
        sigma = np.sqrt(np.diag(estimate.now.covariance))
        shares.append(estimate.now.covariance[MASS, C_D] / sigma[MASS] / sigma[C_D])
    assert shares[0] == pytest.approx(shares[1])


def test_energies_of_eq_21_project_onto_their_coefficients(vehicle):
    """And what the driving does not determine stays as it was."""
    equation = equation_of(vehicle)
    rng = np.random.default_rng(0)
    terms = rng.normal(size=(20_000, 4)) * [1e4, 1e6, 1e5, 1e7]
    change = np.array([[0.1, 2.0, 200.0, 0.05]]).T
    projected = project(terms.T @ terms, terms.T @ terms @ change, equation)
    assert projected == pytest.approx(change, rel=1e-3)
    nothing = np.zeros((4, 4))
    assert not project(nothing, nothing @ change, equation).any()


@pytest.fixture(scope="module")
def in_town(vehicle) -> Callable[[int], tuple[Sequence[Reading], LearnedCar]]:
    """Readings of ten minutes in town by their seed, and the car that they taught."""

    @cache
    def driven(seed: int) -> tuple[Sequence[Reading], LearnedCar]:
        readings = simulate(DriveKind.URBAN, vehicle, 600.0, seed).readings
        return readings, learned(vehicle, readings)

    return driven


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_network_taught_in_town_is_hardly_booked_as_drag(in_town, seed):
    """Town tells drag from rolling badly: a small network made 0.3 of a car's drag there."""
    _, car = in_town(seed)
    drag, rolling = (car.driven.share(car.equation)[:2, -NETWORK:] ** 2).sum(1) ** 0.5
    std = min(NETWORK_STDS)
    assert 0.0 < std * drag < 0.12 * car.equation.mean[State.DRAG_AREA_OVER_ETA]
    assert 0.0 < std * rolling < 0.2 * car.equation.mean[State.ROLLING]


@pytest.mark.slow
def test_an_efficiency_map_is_published_by_energy():
    """Ten minutes of mixed roads with cars of three models that have a map of losses."""
    rows = list(compare(DriveKind.MIXED, VEHICLES, range(2), marks=(600,)))
    errors = {
        name: np.abs([row.error_percent for row in rows if row.name == name])
        for name in ("mass_over_eta", "regeneration")
    }
    assert np.median(errors["mass_over_eta"]) < 2.0 and errors["mass_over_eta"].max() < 4.0
    assert np.median(errors["regeneration"]) < 3.0
    assert np.mean([row.covered for row in rows]) >= 0.85


def learned(vehicle, readings) -> LearnedCar:
    chain = CarChain(vehicle)
    chain.add_readings(readings)
    return chain.car


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.slow
def test_a_polled_log_tells_the_same_car_as_a_dense_one(vehicle, in_town, seed):
    """10 Hz thinned to 1.2 s, each signal at a time of its own: within the sigma of both."""
    readings, dense = in_town(seed)
    thin = learned(vehicle, polled(readings))
    of_dense, of_thin = publish(dense).now, publish(thin).now
    for weights in ([-1, 0, 1, 0, 0, 0], [1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 0, 0]):
        away = abs(np.dot(weights, of_dense.mean - of_thin.mean))
        assert away < 1.5 * math.sqrt(weights @ of_thin.covariance @ weights), weights


@pytest.mark.parametrize("kind", ["slip", "dropouts"])
@pytest.mark.slow
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
    before, after = (publish(car).now for car in (clean, faulty))
    weights = np.array([-1, 0, 1, 0, 0, 0])  # logarithm of m / eta
    std = math.sqrt(weights @ before.covariance @ weights)
    assert abs(weights @ (after.mean - before.mean)) < 2 * std


@pytest.mark.parametrize(
    ("name", "most"),
    [pytest.param("nissan_leaf", 0.25, marks=pytest.mark.nightly), ("generic", 0.05)],
)
@pytest.mark.slow
def test_motor_torque_tells_the_mass_in_kilograms(name, most):
    """Little is left of its prior share, and the truth is within its interval."""
    model, shares = load_vehicle(name), {}
    drive = simulate(DriveKind.MIXED, model, 900.0, 4, motor_torque=True, can_profile=PROFILE)
    for torque in (False, True):
        chain = CarChain(model)
        chain.add_readings(r for r in drive.readings if torque or not isinstance(r, MotorReading))
        mass = chain.parameters().parameters["mass"]
        shares[torque] = mass.prior_share
    assert shares[True] < most and shares[True] < 0.7 * shares[False]
    assert mass.trust.value == "valid"
    assert abs(mass.value - drive.truth.parameters.mass) < 2.0 * mass.std


@pytest.fixture(scope="module")
def mixed(vehicle, intervals) -> Callable[[float], LearnedCar]:
    """A car learned on mixed roads, of whose heights the first share is not known."""
    equation = equation_of(vehicle)
    drive = measured(
        equation, intervals((DriveKind.MIXED, 600.0, 3), begin_ns=0), 500.0, MASS_OVER_ETA=1.05
    )

    @cache
    def after(unseen: float) -> LearnedCar:
        gap = int(unseen * len(drive))
        seen = (replace(interval, height_known=k >= gap) for k, interval in enumerate(drive))
        return LearnedCar.new(equation).after(seen)

    return after


def publish(car: LearnedCar) -> Published:
    return published(car.state, car.equation, car.driven)


def test_rolling_resistance_without_heights_is_as_unsure_as_the_climb(mixed):
    """Its sigma holds the climb that such a road may have, and it is never valid."""
    seen, unseen = publish(mixed(0.0)), publish(mixed(1.0))
    known, guessed = (math.sqrt(car.now.covariance[C_RR, C_RR]) for car in (seen, unseen))
    climb = climb_as_rolling(mixed(1.0).driven.distance)
    assert guessed >= min(climb, math.sqrt(unseen.prior.covariance[C_RR, C_RR]))
    assert guessed > known
    assert (seen.hills_seen, unseen.hills_seen) == (True, False)
    assert parameter_set(0, unseen).parameters["c_rr"].trust is not Trust.VALID


def test_the_road_of_a_drive_that_begins_is_as_the_last_one(vehicle, as_prior):
    """Heights that begin late leave what is known: the first hundred metres are not all roads."""
    equation = equation_of(vehicle)
    drive = as_prior(equation, (DriveKind.URBAN, 120.0, 0))
    with_heights, without = ([replace(i, height_known=k) for i in drive] for k in (True, False))
    new = LearnedCar.new(equation)
    car = new.after(without).begin_drive()
    assert not publish(car).hills_seen
    assert publish(car.after(with_heights)).hills_seen
    assert publish(new.after(with_heights).begin_drive().after(without[:15])).hills_seen


def test_a_short_stretch_without_heights_takes_little_of_what_is_known(mixed):
    """The climb of 5 % of the road is off by what it is to the whole."""
    covariances = (publish(mixed(unseen)).now.covariance for unseen in (0.0, 0.05, 1.0))
    all_seen, some, none = (
        np.sqrt(np.diag(covariance)[[C_RR, C_D]]) for covariance in covariances
    )
    assert (some - all_seen < 0.2 * (none - all_seen)).all()


@pytest.mark.slow
def test_motor_torque_without_heights_tells_the_same_car():
    """What an unseen climb takes is in the motor's energy, and no higher efficiency."""
    model = load_vehicle("nissan_leaf")
    hilly = {"rms_grade": 0.04, "motor_torque": True, "can_profile": PROFILE}
    drive = simulate(DriveKind.MIXED, model, 900.0, 4, **hilly)
    etas = {}
    for seen in (True, False):
        chain = CarChain(model)
        chain.add_readings(r for r in drive.readings if seen or not isinstance(r, AltitudeReading))
        etas[seen] = chain.parameters().parameters["eta"]
    assert etas[True].trust.value == "valid"
    assert abs(etas[False].value - drive.truth.parameters.eta) < 2.0 * etas[False].std
    assert etas[False].std < 2.0 * etas[True].std
