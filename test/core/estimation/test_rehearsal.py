"""Rehearsals: dropouts that did not happen say how far sigma is to be trusted."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.core.estimation.bands import (
    DEGREES,
    GROWTHS,
    Bands,
    PredictedEnergy,
    Spread,
)
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.posterior import interval_terms
from evpinn_ros.core.estimation.rehearsal import LENGTHS
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind

EQUATION = equation_of(load_vehicle("tesla_model_3_lr"))


def learned(intervals, energy, seconds=1200.0, seed=0):
    """A car after a drive of which each interval took `energy(number)` J beside the prior's."""
    car = LearnedCar.new(EQUATION)
    for number, interval in enumerate(intervals((DriveKind.URBAN, seconds, seed), begin_ns=0)):
        drawn = float(interval_terms(EQUATION, interval, 0.0).journey.row @ EQUATION.mean)
        measured = replace(interval, energy=drawn + energy(number), sampling_variance=0.0)
        car = car.after([measured])
    return car


@pytest.mark.slow
def test_energy_that_strays_for_minutes_widens_the_band_and_little_noise_narrows_it(intervals):
    rng = np.random.default_rng(0)
    strays = np.repeat(rng.normal(0.0, 2e4, 20), 35)  # for three minutes each, W times 6 s
    wild = learned(intervals, lambda number: strays[number]).state.bands.dropout
    calm = learned(intervals, lambda _: rng.normal(0.0, 100.0)).state.bands.dropout
    assert wild.cases == calm.cases > 3.0
    assert wild.scale > 1.0 > calm.scale


def test_a_rehearsal_lasts_as_long_as_the_dropout_it_stands_for(intervals):
    car, longest = LearnedCar.new(EQUATION), dict.fromkeys(LENGTHS, 0.0)
    for interval in intervals((DriveKind.URBAN, 1.1 * max(LENGTHS), 0), begin_ns=0):
        car = car.after([replace(interval, energy=3e3, sampling_variance=0.0)])
        for length, rehearsal in car.rehearsals.dropouts.items():
            longest[length] = max(longest[length], rehearsal.journey.seconds)
    for length, seconds in longest.items():
        assert length - 15.0 < seconds < length


def test_nothing_is_proved_by_a_dropout_or_a_car_that_stands(intervals):
    car = LearnedCar.new(EQUATION)
    for interval in intervals((DriveKind.URBAN, 600.0, 0), begin_ns=0):
        car = car.after([interval])  # its battery was not measured
    assert car.state.bands == Bands() and not car.measured
    parked = LearnedCar.new(EQUATION)
    for interval in intervals(np.zeros(60_000), begin_ns=0):
        parked = parked.after([replace(interval, energy=3e3, sampling_variance=0.0)])
    assert parked.state.bands == Bands()


def test_a_spread_goes_both_ways_and_one_odd_road_counts_little():
    spread = Spread()
    for _ in range(100):
        spread = spread.after(0.5)
    assert 0.25 < spread.scale < 0.25 + DEGREES / 40
    odd = spread.after(1e6)
    assert odd.scale < spread.scale + 16.0 / 40


@pytest.mark.parametrize("cases", [2, 8, 30])
def test_where_cars_differ_the_variance_is_right_after_few_cases_too(cases):
    """The mean square of the errors of a car is drawn as Student's t has it."""
    rng, squares = np.random.default_rng(0), []
    for _ in range(3000):
        size = np.sqrt(DEGREES / rng.chisquare(DEGREES))
        *seen, last = size * rng.standard_normal(cases + 1)
        spread = Spread()
        for error in seen:
            spread = spread.after(error)
        squares.append(last**2 / spread.scale)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)
    assert np.mean(np.array(squares) < 1.645**2) == pytest.approx(0.9, abs=0.02)


def test_flat_country_has_narrow_bands_and_mountains_wide_ones():
    """By the errors of 60 s without a height, of 20 km of road each."""
    rng, widths = np.random.default_rng(0), []
    for growth in (GROWTHS[0], GROWTHS[-1]):
        bands = Bands()
        weight = 2e4**2
        for _ in range(60):
            energy = PredictedEnergy(0.0, 1e9, weight * 1000.0)
            drawn = rng.normal(0.0, np.sqrt(1e9 + growth * weight * 1000.0))
            bands = bands.after_dropout(energy, drawn, long=False)
        widths.append(bands.growth)
    assert widths[0] < 2.0 * GROWTHS[0] and widths[1] > 0.5 * GROWTHS[-1]


def test_a_whole_drive_is_judged_from_the_second_on(intervals):
    car = learned(intervals, lambda _: 0.0, 300.0)
    assert car.begin_drive().state.bands.drive == Spread()
    second = car.begin_drive()
    for interval in intervals((DriveKind.URBAN, 300.0, 1), begin_ns=10**12):
        drawn = float(interval_terms(EQUATION, interval, 0.0).journey.row @ EQUATION.mean)
        second = second.after([replace(interval, energy=drawn, sampling_variance=0.0)])
    assert second.begin_drive().state.bands.drive.cases == pytest.approx(1.0)
