"""Payload that comes and goes at a stop."""

from copy import deepcopy
from dataclasses import replace
import json
import math

import pytest

from evpinn_ros.bench.truth import load_steps
from evpinn_ros.estimation.load_change import LEAST_CHANGE, STOPS_KEPT, Chance, LoadDetector
from evpinn_ros.estimation.published_filter import PublishedFilter
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.vehicle.parameters import Parameters

TRUTH = Parameters(eta=0.85, mu=0.78, mass=1900.0, c_rr=0.0105, c_d=0.235, p_aux=1250.0)


class Driver:
    """A filter and its detector, driven leg by leg with stops between."""

    def __init__(self, vehicle, synthetic) -> None:
        self.filter, self.load = PublishedFilter(vehicle), LoadDetector()
        self._synthetic, self._end = synthetic, 0

    def drive(self, mass: float, seed: int, seconds: float = 240.0) -> None:
        leg = self._synthetic(
            TRUTH._replace(mass=mass), route=seed, seed=seed, seconds=seconds, noise=0.4, hills=0.3
        )
        offset = self._end + 10 * NANOSECONDS - leg.samples[0].stamp_ns if self._end else 0
        for sample, power in zip(leg.samples, leg.powers, strict=True):
            moment = replace(sample, stamp_ns=sample.stamp_ns + offset)
            self.filter.advance(moment)
            self.filter.update(moment, power, 0.2)
            self.filter = self.load.push(self.filter, moment, power, 0.2)
            self._end = moment.stamp_ns


@pytest.fixture(scope="module")
def driven(vehicle, synthetic) -> Driver:
    """A quarter of an hour in town: the detector knows what chance does."""
    driver = Driver(vehicle, synthetic)
    driver.drive(1900.0, 0, seconds=900.0)
    assert driver.load.found == 0
    return driver


@pytest.fixture
def driver(driven) -> Driver:
    return deepcopy(driven)


@pytest.mark.parametrize("delta", [150.0, -150.0])
def test_a_change_is_found_and_followed(driver, delta):
    driver.drive(1900.0 + delta, 1)
    change = driver.load.change
    assert driver.load.found == 1 and change is not None
    assert change.delta_mass == pytest.approx(delta, abs=40.0)
    assert 0 < change.std < 50.0
    mass_over_eta = driver.filter.published().identifiable()[0].mass_over_eta
    assert mass_over_eta == pytest.approx((1900.0 + delta) / TRUTH.eta, rel=0.025)


def test_no_change_is_found_where_there_is_none(driver):
    for seed in range(1, 4):
        driver.drive(1900.0, seed)
    assert driver.load.found == 0 and driver.load.change is None


def test_what_comes_back_is_withdrawn_or_taken_back(driver):
    """A change that the following drive contradicts does not stay."""
    driver.drive(2050.0, 1, seconds=120.0)
    driver.drive(1900.0, 2)
    mass_over_eta = driver.filter.published().identifiable()[0].mass_over_eta
    assert mass_over_eta == pytest.approx(1900.0 / TRUTH.eta, rel=0.025)
    assert driver.load.found == 2 or driver.load.withdrawn == 1


def test_a_change_that_is_being_confirmed_survives_a_restart(driver, vehicle):
    """The computer restarts forty seconds into the new load."""
    driver.drive(2050.0, 1, seconds=40.0)
    assert driver.load.found == 0
    saved, filter_state = json.loads(json.dumps(driver.load.export())), driver.filter.export()
    driver.load, driver.filter = LoadDetector(), PublishedFilter(vehicle)
    driver.load.restore(saved, vehicle)
    driver.filter.restore(filter_state)
    assert driver.load.export() == saved
    driver.drive(2050.0, 2, seconds=120.0)
    assert driver.load.found == 1
    assert driver.load.change.delta_mass == pytest.approx(150.0, abs=50.0)


def test_a_saved_detector_that_does_not_fit_is_refused(driver, vehicle):
    saved = driver.load.export()
    other = LoadDetector()
    for wrong in (
        {"chance": {"stops": math.nan, "squares": 1.0}},
        {"trials": [[{"stamp_ns": 1}, {}]]},
        {"change": {"stamp_ns": 1, "delta_mass": math.inf, "std": 1.0}},
    ):
        with pytest.raises((KeyError, TypeError, ValueError)):
            other.restore({**saved, **wrong}, vehicle)
    assert other.export() == LoadDetector().export()


def test_a_car_not_known_yet_is_told_no_change(vehicle, synthetic):
    """What chance does on its roads is not known before `LEAST_STOPS` stops."""
    driver = Driver(vehicle, synthetic)
    driver.drive(1900.0, 0, seconds=180.0)
    driver.drive(2050.0, 1, seconds=120.0)
    assert driver.load.found == 0


def test_where_chance_does_much_more_is_asked():
    chance = Chance()
    for _ in range(10):
        chance.learn(0.5)
    assert chance.scale == 1.0
    for _ in range(60):
        chance.learn(4.0)
    assert chance.scale == pytest.approx(4.0, rel=0.15)
    assert chance.stops == pytest.approx(STOPS_KEPT)


def test_a_simulated_car_is_found_in_time():
    (step,) = load_steps(["tesla_model_3_lr"], [3000], before=600, after=180)
    assert step.detected_after <= 90.0
    assert abs(step.error) < LEAST_CHANGE / 2
