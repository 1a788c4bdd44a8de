"""The five-state filter finds the car that made the data, and knows what it does not know."""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.unseen.kalman import FiveStateFilter
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.identifiable import Identifiable, combined_power

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


def test_it_finds_the_car(vehicle, samples, teach):
    method = teach(FiveStateFilter(vehicle), samples, true_power)
    rolling = TRUE.c_rr * TRUE.mass_over_eta
    wanted = [TRUE.drag_area_over_eta, rolling, TRUE.mass_over_eta, TRUE.regeneration, TRUE.p_aux]
    assert method.mean == pytest.approx(wanted, rel=0.05)
