"""Hills of a car's roads: how much a road without heights may climb."""

from dataclasses import replace

import pytest

from evpinn_ros.core.estimation.bands import HILLS_MEMORY_METRES, LEAST_HEIGHTS_METRES, Hills
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind


def test_up_and_down_a_town_on_a_slope_tells_how_hilly_it_is():
    """Each drive ends 160 m above or below its start, 4 km away: 6.4 m^2 per m."""
    hills = Hills()
    for number in range(12):
        hills = hills.plus(2000.0, 100.0 * (-1) ** number).plus(2000.0, 60.0 * (-1) ** number)
        hills = hills.next_drive()
    assert hills.growth == pytest.approx(6.4, rel=0.02)


def test_few_roads_with_heights_tell_nothing_and_level_ones_that_all_is_level():
    assert Hills().plus(LEAST_HEIGHTS_METRES - 1.0, 160.0).next_drive().growth == 0.0
    hills = Hills().plus(20e3, 400.0).next_drive()
    assert hills.plus(20e3, 0.0).next_drive().growth < 0.6 * hills.growth


def test_hills_of_long_ago_are_forgotten():
    """A car that moved from mountains to plains: a mean over all its roads would fall slower."""
    hills = Hills().plus(100e3, 300.0).next_drive()
    for _ in range(3):
        flat = hills.plus(HILLS_MEMORY_METRES, 0.0).next_drive()
        assert flat.growth < 0.4 * hills.growth
        hills = flat


def test_a_road_without_heights_is_none_of_them(vehicle, intervals):
    car = LearnedCar.new(equation_of(vehicle))
    town = intervals((DriveKind.URBAN, 300.0, 0), begin_ns=0)
    unknown = [replace(interval, height_known=False) for interval in town]
    assert car.after(unknown).hills == Hills()
    level = [replace(interval, height_known=True) for interval in town]
    way = sum(abs(interval.distance) for interval in town)
    assert car.after(level).hills.way == pytest.approx(way)


def test_a_car_of_hilly_roads_is_less_sure_of_a_road_without_heights():
    """In flat land it is as sure as a car of no known road."""
    car = LearnedCar.new(equation_of(load_vehicle("bmw_i3")))
    steep = replace(car, hills=Hills(0.5 * 20e3, 20e3))
    assert steep.model().growth == pytest.approx(0.5)
    flat = replace(car, hills=Hills(1e-6, 20e3))
    assert flat.model().growth == car.model().growth == car.state.bands.growth
