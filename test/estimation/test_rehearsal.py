"""Dropouts that did not happen tell how far the sigma of those that do is to be trusted."""

from __future__ import annotations

from dataclasses import replace
import math

import pytest

from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.rehearsal import LENGTH, Rehearsal
from evpinn_ros.simulation.drive import DriveKind


def rehearsed(vehicle, intervals, energy) -> Rehearsal:
    """After half an hour, the battery's energy of an interval being what `energy` says of it."""
    car, rehearsal = CarFilter(vehicle), Rehearsal()
    for seed in range(3):
        for number, one in enumerate(intervals((DriveKind.MIXED, 600.0, seed))):
            changed = replace(one, energy=energy(number, one), sampling_variance=0.0)
            rehearsal.learn(car, changed)
            car.learn(changed)
    return rehearsal


@pytest.mark.slow
def test_energy_that_strays_for_minutes_widens_sigma(vehicle, intervals):
    """Eight kilowatts that come and go are no load that the filter knows of; two hundred are."""
    period = LENGTH / 3.0

    def load(size):
        return lambda number, one: (
            one.distance * 600.0 + size * one.duration * (number * one.duration % period > 40.0)
        )

    calm, wild = (rehearsed(vehicle, intervals, load(size)) for size in (200.0, 8000.0))
    assert calm.chance.count >= 7.0 and wild.chance.count == calm.chance.count
    assert calm.chance.scale < wild.chance.scale


def test_nothing_is_proved_by_a_dropout_or_a_car_that_stands(vehicle, intervals):
    drive = intervals((DriveKind.MIXED, 600.0, 1))
    silent = rehearsed(vehicle, intervals, lambda number, _: 0.0 if number % 20 else math.nan)
    assert silent.chance.count == 0.0
    car, rehearsal = CarFilter(vehicle), Rehearsal()
    stands = replace(drive[0], steps=drive[0].steps._replace(distance=drive[0].steps.distance * 0))
    for _ in range(400):
        rehearsal.learn(car, replace(stands, energy=1000.0))
    assert rehearsal.chance.count == 0.0


def test_a_copy_goes_its_own_way(vehicle, intervals):
    drive = intervals((DriveKind.MIXED, 600.0, 1))
    car, rehearsal = CarFilter(vehicle), Rehearsal()
    before = car.state.mean.copy()
    for one in drive[:5]:
        rehearsal.learn(car, replace(one, energy=100.0))
    other = rehearsal.copy()
    for one in drive:
        other.learn(car, replace(one, energy=100.0))
    assert other.chance.count > 0.0 and rehearsal.chance.count == 0.0
    assert (car.state.mean == before).all(), "the filter itself is not touched"
