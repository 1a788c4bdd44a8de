"""Payload that comes and goes at a stop."""

from copy import deepcopy
from dataclasses import replace
import math

import pytest

from benchmarks.truth import CarChain
from evpinn_ros.core.estimation.payload import (
    CHANCE_KEPT,
    LEAST_CHANGE,
    PROBATION,
    Chance,
    PayloadDetector,
)
from evpinn_ros.core.estimation.published import mass_over_eta
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, simulate


class Driver:
    """A simulated car driven in town, leg by leg with stops between."""

    def __init__(self, vehicle) -> None:
        self.chain, self._vehicle, self._seconds = CarChain(vehicle), vehicle, 0
        self._car = None

    @property
    def payload(self) -> PayloadDetector:
        return self.chain.car.payload

    @property
    def log_mass_over_eta(self) -> float:
        car = self.chain.car
        return mass_over_eta(car.state, car.equation, car.driven)[0]

    def drive(self, delta: float, seed: int, seconds: int) -> None:
        """With so many kg more than at first."""
        car = self._car and replace(self._car, mass=self._car.mass + delta)
        start_ns = EPOCH_NS + self._seconds * NANOSECONDS
        leg = simulate(DriveKind.URBAN, self._vehicle, seconds, seed, car=car, start_ns=start_ns)
        self._car = self._car or leg.car
        self._seconds += seconds + 10
        self.chain.add_readings(leg.readings)


@pytest.fixture(scope="module")
def driven(vehicle) -> Driver:
    """Ten minutes in town: the detector knows what chance does."""
    driver = Driver(vehicle)
    driver.drive(0.0, 3000, 600)
    assert driver.payload.found == 0
    return driver


@pytest.fixture
def driver(driven) -> Driver:
    return deepcopy(driven)


@pytest.mark.parametrize("delta", [300.0, -300.0])
def test_a_change_is_found_followed_and_withdrawn_when_the_car_is_as_before(driver, delta):
    before, state = driver.log_mass_over_eta, driver.chain.car.state
    driver.drive(delta, 1_003_000, 240)
    change = driver.payload.change
    assert driver.payload.found == 1 and change is not None
    assert change.delta_mass == pytest.approx(delta, abs=LEAST_CHANGE)
    assert 0 < change.std < 80.0
    ratio = math.exp(driver.log_mass_over_eta - before)
    assert ratio == pytest.approx(1 + delta / driver._car.mass, rel=0.04)
    # As sharp as the car is known by now, not as when the change was found.
    stop = driver.payload.watched
    since = math.exp(driver.log_mass_over_eta - stop.before)
    assert since == pytest.approx(1 + change.delta_mass / stop.mass, abs=1e-12)
    assert PayloadDetector.of(driver.payload.saved()).change == change
    old = replace(driver.payload, watched=replace(driver.payload.watched, motion=PROBATION))
    for payload, left in ((old, change), (driver.payload, None)):  # of no old one any more
        driver.chain.car = replace(driver.chain.car, state=state, payload=payload)
        driver.drive(-delta if left else 0.0, 1, 40)
        assert driver.payload.change == left
    assert driver.payload.withdrawn == 1


@pytest.mark.slow
def test_no_change_is_found_where_there_is_none(driver):
    for seed in (1, 2):
        driver.drive(0.0, seed, 240)
    assert driver.payload.found == driver.payload.withdrawn and driver.payload.change is None


def test_before_some_stops_taught_what_chance_does_no_change_is_found(driver):
    """A change as above is found of no car whose stops are not known yet."""
    untaught = replace(driver.payload.forget_time(), chance=Chance())
    driver.chain.car = replace(driver.chain.car, payload=untaught)
    driver.drive(-300.0, 1_003_000, 240)
    assert driver.payload.found == 0


def test_where_chance_does_much_more_is_asked():
    chance = Chance()
    for _ in range(10):
        chance = chance.after(0.5)
    assert chance.scale == 1.0
    for _ in range(60):
        chance = chance.after(4.0)
    assert chance.scale == pytest.approx(4.0, rel=0.15)
    assert chance.count == pytest.approx(CHANCE_KEPT)
