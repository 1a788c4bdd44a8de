"""The five-state filter finds the car that made the data, and knows what it does not know."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.unseen.kalman import FiveStateFilter
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.identifiable import Identifiable, combined_power, identifiable

START_NS = 1_700_000_000 * NANOSECONDS
TRUE = Identifiable(2450.0, 0.78, 0.0105, 0.5, 900.0)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """Ten minutes at 10 Hz, in town and out of it, uphill and down, with a load that is known."""
    time = 0.1 * np.arange(6000)
    speed = 14.0 + 9.0 * np.sin(time / 31.0) + 4.0 * np.sin(time / 7.0)
    acceleration = np.gradient(speed, time) + 0.5 * np.sin(time / 3.0)
    grade = 0.02 * np.sin(time / 50.0)
    return [
        Sample(START_NS + i * NANOSECONDS // 10, float(v), float(a), float(g), 1.2, 300.0)
        for i, (v, a, g) in enumerate(zip(speed, acceleration, grade, strict=True))
    ]


@pytest.fixture(scope="module")
def teach() -> Callable:
    """Feed a method all samples, with power from a function of the sample."""

    def teach(method, samples, power):
        for sample in samples:
            method.observe(sample, power(sample))
        return method

    return teach


def true_power(sample):
    return 300.0 + combined_power(
        sample.speed,
        sample.acceleration,
        TRUE,
        air_density=sample.air_density,
        grade=sample.grade,
        rotating_mass_factor=1.03,
    )


def test_prior_is_that_of_the_vehicle_file(vehicle):
    method = FiveStateFilter(vehicle)
    initial = identifiable(vehicle.initial, vehicle.frontal_area)
    assert method.mean[[0, 2, 3, 4]] == pytest.approx(
        [initial.drag_area_over_eta, initial.mass_over_eta, initial.regeneration, initial.p_aux]
    )
    # k_m = m / eta: 120 kg of 1930 kg and 0.06 of 0.9 together.
    share = np.hypot(120 / 1930, 0.06 / 0.9)
    assert np.sqrt(method.covariance[2, 2]) == pytest.approx(share * method.mean[2])
    assert np.sqrt(method.covariance[4, 4]) == pytest.approx(400.0)
    assert np.linalg.eigvalsh(method.covariance)[0] >= -1e-9


def test_it_predicts_the_prior_before_driving(vehicle, samples):
    initial = identifiable(vehicle.initial, vehicle.frontal_area)
    for sample in samples[::500]:
        power = combined_power(
            sample.speed,
            sample.acceleration,
            initial,
            air_density=sample.air_density,
            grade=sample.grade,
            rotating_mass_factor=vehicle.rotating_mass_factor,
        )
        assert FiveStateFilter(vehicle).predict(sample).power == pytest.approx(power + 300.0)


def test_it_finds_the_car(vehicle, samples, teach):
    method = teach(FiveStateFilter(vehicle), samples, true_power)
    rolling = TRUE.c_rr * TRUE.mass_over_eta
    wanted = [TRUE.drag_area_over_eta, rolling, TRUE.mass_over_eta, TRUE.regeneration, TRUE.p_aux]
    assert method.mean == pytest.approx(wanted, rel=0.05)


def test_sigma_shrinks_by_driving_and_grows_with_speed(vehicle, samples, teach):
    method = FiveStateFilter(vehicle)
    before = method.predict(samples[0]).sigma
    teach(method, samples, true_power)
    assert method.predict(samples[0]).sigma < before
    still = replace(samples[-1], speed=0.0, acceleration=0.0)
    assert method.predict(still).sigma < method.predict(samples[-1]).sigma
