"""What cars have in common, from evidence drawn of populations that are known."""

import math

import numpy as np
import pytest

from benchmarks.truth import CarChain
from evpinn_ros.core.estimation.evidence import LINEAR, NO_EVIDENCE, Evidence
from evpinn_ros.core.estimation.published import evidence_of
from evpinn_ros.core.vehicle.files import load_vehicle, write_vehicle
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.extras.fleet.population import COMBINATIONS, Population
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

LEAF = load_vehicle("nissan_leaf")
SIGMA = np.array(
    [LEAF.priors[n].std / (1.0 if n == LINEAR else LEAF.priors[n].value) for n in PARAMETER_NAMES]
)
START = np.array(
    [
        LEAF.priors[n].value if n == LINEAR else math.log(LEAF.priors[n].value)
        for n in PARAMETER_NAMES
    ]
)
# eta, 1/mu, mass and C_d scaled together, in prior sigmas: what no data tell.
UNTOLD = np.array([1.0, -1.0, 1.0, 0.0, 1.0, 0.0]) / SIGMA
UNTOLD /= np.linalg.norm(UNTOLD)


def cars(count, mean, spread, rng):
    """Evidence of cars from N(mean, diag(spread^2)), each of other directions and precision."""
    for _ in range(count):
        true = mean + spread * rng.standard_normal(6)
        basis = np.linalg.qr(np.column_stack([UNTOLD, rng.standard_normal((6, 5))]))[0][:, 1:]
        values = 10 ** rng.uniform(0.5, 3.0, 5)
        measured = basis.T @ true + rng.standard_normal(5) / np.sqrt(values)
        yield Evidence((basis * values) @ basis.T, (basis * values) @ measured)


def directions():
    yield from (("c_rr", {"c_rr": 1.0}), ("p_aux", {"p_aux": 1.0}))
    yield from COMBINATIONS.items()


@pytest.mark.parametrize("count", [4, 20, 60])
def test_mean_and_spread_are_recovered_within_what_is_stated(count):
    """Intervals of 95 %, of 40 populations; those of the spread are known to hold 92 to 99 %."""
    rng = np.random.default_rng(3)
    means, spreads = [], []
    for _ in range(40):
        mean = rng.standard_normal(6) * math.sqrt(0.5)
        spread = rng.uniform(0.05, 0.6, 6)
        population = Population(LEAF, list(cars(count, mean, spread, rng)))
        for name, parts in directions():
            direction = np.array([parts.get(parameter, 0.0) for parameter in PARAMETER_NAMES])
            estimate = population.value(name)
            true = direction @ (START + SIGMA * mean)
            means.append((estimate.mean - true) / estimate.mean_std)
            true_spread = np.linalg.norm(direction * SIGMA * spread)
            spreads.append((estimate.spread - true_spread) / estimate.spread_std)
    for z, least in ((np.array(means), 0.9), (np.array(spreads), 0.85)):
        assert least < np.mean(np.abs(z) < 1.96) < 0.999
        assert abs(z.mean()) < 0.5


def test_without_evidence_the_vehicle_file_stays():
    for evidence in ([], [NO_EVIDENCE] * 50):
        priors = Population(LEAF, evidence).priors("test").priors
        for name, prior in LEAF.priors.items():
            assert priors[name].value == pytest.approx(prior.value, rel=1e-12)
            assert priors[name].std == pytest.approx(prior.std, rel=1e-12)
            assert Population(LEAF, evidence).value(name).cars == pytest.approx(0.0, abs=1e-9)


def test_what_is_told_together_is_not_told_of_each():
    """Mass over eta of 60 cars, exactly: of how much cars differ in mass that says little."""
    rng = np.random.default_rng(5)
    ratio = np.array([-SIGMA[0], 0.0, SIGMA[2], 0.0, 0.0, 0.0])
    ratio /= np.linalg.norm(ratio)
    evidence = [
        Evidence(1e6 * np.outer(ratio, ratio), 1e6 * ratio * z) for z in rng.normal(size=60)
    ]
    population = Population(LEAF, evidence)
    assert population.value("mass_over_eta").cars == pytest.approx(60.0, rel=0.01)
    mass = population.value("mass")
    assert mass.cars < 2.0 and mass.spread_std > 0.2 * mass.spread


def test_priors_are_a_vehicle_file(tmp_path):
    rng = np.random.default_rng(4)
    population = Population(LEAF, list(cars(10, np.zeros(6), np.full(6, 0.3), rng)))
    priors = population.priors("test")
    path = tmp_path / "deeper" / "leaf.yaml"
    write_vehicle(path, priors)
    again = load_vehicle(path)
    assert again.priors == dict(priors.priors)
    assert again.can_profile == "nissan_leaf" and again.nominal_voltage == LEAF.nominal_voltage


@pytest.fixture(scope="module")
def driven():
    """A car after four minutes in town, whose network and copper count as well."""
    chain = CarChain(LEAF)
    chain.add_readings(simulate(DriveKind.URBAN, LEAF, 240.0, 3).readings)
    return chain


def test_a_car_alone_is_in_its_population_what_it_says_of_itself(driven):
    """In kilograms and watts of the vehicle file, whatever its own prior had beside them."""
    source, car = driven.published(), driven.car
    evidence = evidence_of(car.state, car.equation, car.driven)
    population = Population(LEAF, [evidence])
    for name, parts in (("mass_over_eta", COMBINATIONS["mass_over_eta"]), ("p_aux", {LINEAR: 1})):
        direction = np.array([parts.get(parameter, 0.0) for parameter in PARAMETER_NAMES])
        own = float(direction @ source.now.mean)
        own_std = math.sqrt(direction @ source.now.covariance @ direction)
        mean, std = population.of_car(name, evidence)
        assert abs(mean - own) < 0.3 * own_std, name
        assert std == pytest.approx(own_std, rel=0.15), name
