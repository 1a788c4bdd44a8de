"""Everything learned of a car is a value: what comes after leaves it as it was."""

from dataclasses import FrozenInstanceError, replace
import math

import numpy as np
import pytest

from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.estimation.unevenness import Unevenness
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind

EQUATION = equation_of(load_vehicle("bmw_i3"))


@pytest.fixture(scope="module")
def town(as_prior):
    return as_prior(EQUATION, (DriveKind.URBAN, 300.0, 0))


def test_a_car_is_frozen_and_forks_are_free(town):
    car = LearnedCar.new(EQUATION).after(town[:20])
    fork, another = car.after(town[20:30]), car.after(town[20:30])
    assert np.array_equal(fork.state.mean, another.state.mean)
    assert car.end_ns == town[19].end_ns and fork.end_ns == town[29].end_ns
    with pytest.raises(FrozenInstanceError):
        car.end_ns = 0


def test_what_cannot_be_is_counted_and_teaches_nothing(town):
    car = LearnedCar.new(EQUATION).after(town[:10])
    steps = town[10].steps
    back = replace(town[10], steps=steps._replace(distance=-np.abs(steps.distance) - 1.0))
    rests = replace(town[11], steps=steps._replace(distance=0.0 * steps.distance))
    charging = replace(rests, energy=-7e3 * rests.duration)
    after = car.after([back, charging, replace(town[11], leaps=True)])
    assert after.gated == {"reverse": 1, "charging": 1, "speed_leaps": 1}
    assert after.state is car.state


def test_a_dropout_is_driven_and_not_learned(town):
    car = LearnedCar.new(EQUATION).after(town[:20])
    silent = car.after([replace(interval, energy=math.nan) for interval in town[20:]])
    assert silent.state is car.state and not silent.measured
    energy, sigma = silent.state.model(EQUATION).predicted(silent.dropout)
    assert abs(energy - sum(interval.energy for interval in town[20:])) < 2.0 * sigma
    again = silent.after([replace(town[0], start_ns=silent.end_ns, end_ns=silent.end_ns + 1)])
    assert again.measured and again.dropout.seconds == 0.0


def test_uneven_speed_is_learned_with_the_drive(town):
    driven = LearnedCar.new(EQUATION).after(town)
    assert not driven.unevenness.metres.any()
    uneven = driven.begin_drive().unevenness
    way = sum(interval.distance for interval in town)
    assert uneven.metres.sum() == pytest.approx(way, rel=0.01) and uneven.by_drives.max() > 0.0
    assert not Unevenness.none().metres.any()
