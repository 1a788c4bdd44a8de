"""Hills that the filter's bounded height does not hold: learned by heights, counted without."""

from __future__ import annotations

from dataclasses import replace
import math

import pytest

from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.long_hills import GROWTH, LongHills
from evpinn_ros.signals.interval import Interval
from evpinn_ros.simulation.drive import DriveKind


def climbing(one: Interval, slope: float, *, known: bool = True) -> Interval:
    """The interval on a road of this slope."""
    steps = one.steps._replace(climb=slope * one.steps.distance * known)
    return replace(one, steps=steps, height_known=known)


def taught(intervals, slope: float, *, known: bool = True) -> LongHills:
    hills = LongHills(GROWTH)
    for seed in range(2):
        for one in intervals((DriveKind.HIGHWAY, 600.0, seed)):
            hills = hills.after(climbing(one, slope, known=known))
    return hills


def test_a_road_that_climbs_teaches_how_far_roads_stray(intervals):
    """A slope of 4 % gains 40 m in a kilometre: 1.6 m^2 of height per m of road."""
    steep, level = taught(intervals, 0.04), taught(intervals, 0.0)
    assert level.growth < GROWTH < 0.5 < steep.growth < 1.7
    assert steep.blocks > 15.0, "half an hour of motorway"


def test_without_a_height_nothing_is_learned(intervals):
    assert taught(intervals, 0.04, known=False) == LongHills(GROWTH)


def test_a_gap_of_heights_breaks_the_stretch(intervals):
    """Kilometres of which every tenth interval has no height never are one stretch."""
    hills = LongHills(GROWTH)
    for number, one in enumerate(intervals((DriveKind.URBAN, 600.0, 1))):
        hills = hills.after(climbing(one, 0.04, known=number % 10 > 0))
    assert (hills.growth, hills.blocks) == (GROWTH, LongHills(GROWTH).blocks)


def test_a_dropout_on_a_road_of_unknown_height_is_less_sure_in_hills(vehicle, intervals):
    """By the weight of the car over eta times the height that the road may gain."""
    drive = [
        replace(one, energy=math.nan, height_known=False)
        for one in intervals((DriveKind.MIXED, 600.0, 1))
    ]
    sigmas = {}
    for growth in (0.0, 1.0):
        car = CarFilter(vehicle)
        car.hills = LongHills(growth)
        for one in drive:
            car.learn(one)
        sigmas[growth] = car.unmeasured()[1]
    weight = 9.81 * 1847.0 / 0.9
    height = math.sqrt(sum(one.distance for one in drive))
    added = math.sqrt(sigmas[1.0] ** 2 - sigmas[0.0] ** 2)
    assert added == pytest.approx(weight * height, rel=0.15)


def test_it_is_saved_with_the_car(vehicle):
    car, other = CarFilter(vehicle), CarFilter(vehicle)
    car.hills = LongHills(1.4, 40.0, 300.0, 12.0)
    other.restore(car.export())
    assert other.hills == LongHills(1.4, 40.0), "the stretch begun is not saved"
    with pytest.raises(ValueError, match="height_growth"):
        other.restore(car.export() | {"height_growth": math.nan})
