"""Hills of a car's roads: how much a road without heights may climb."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.estimation.car import LearnedCar
from evpinn_ros.estimation.hills import LEAST_METRES, Hills
from evpinn_ros.estimation.terms import equation_of
from evpinn_ros.estimation.unevenness import Path
from evpinn_ros.vehicle.files import load_vehicle


def drive(climb: float, metres: float = 4000.0) -> Path:
    one = np.ones(400)
    step = metres / 400.0 * one
    return Path(one, step, step**3, 0.0 * one, climb / 400.0 * one, 1.2 * one, 0.0 * one)


def test_up_and_down_a_town_on_a_slope_tells_how_hilly_it_is():
    """Each drive ends 160 m above or below its start, 4 km away: 6.4 m^2 per m."""
    hills = Hills()
    for number in range(12):
        hills = hills.after(drive(160.0 * (-1) ** number))
    assert hills.growth == pytest.approx(6.4, rel=0.02)


def test_roads_without_heights_and_few_with_them_tell_nothing():
    assert Hills().after(drive(0.0)) == Hills()
    assert Hills().after(drive(160.0, LEAST_METRES - 1.0)).growth == 0.0


def test_a_car_of_hilly_roads_is_less_sure_of_a_road_without_heights():
    """In flat land it is as sure as a car of no known road."""
    car = LearnedCar.new(equation_of(load_vehicle("bmw_i3")))
    steep = replace(car, hills=Hills(0.5 * 20e3, 20e3))
    assert steep.model().growth == pytest.approx(0.5)
    flat = replace(car, hills=Hills(1e-6, 20e3))
    assert flat.model().growth == car.model().growth == car.state.bands.growth
