"""Where the energy of a drive went: parts of the one equation, summed."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.core.estimation.breakdown import net_climb
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.terms import WHOLE, Part, equation_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from test.core.estimation.conftest import measured

EQUATION = equation_of(load_vehicle("tesla_model_3_lr"))


@pytest.fixture(scope="module")
def town(intervals):
    """Five minutes of a car a little heavier than the prior."""
    return measured(
        EQUATION, intervals((DriveKind.URBAN, 300.0, 0), begin_ns=0), 500.0, MASS_OVER_ETA=1.05
    )


@pytest.fixture(scope="module")
def learned(town) -> LearnedCar:
    """From `town`, whose heights nobody knows."""
    return LearnedCar.new(EQUATION).after(town)


@pytest.fixture(scope="module")
def seen(town) -> LearnedCar:
    """From the same intervals, their heights known."""
    return LearnedCar.new(EQUATION).after(
        replace(interval, height_known=True) for interval in town
    )


@pytest.fixture(scope="module")
def later(learned, intervals):
    """Another drive in town, a minute after the first."""
    begin_ns = learned.end_ns + 60 * 10**9
    drive = intervals((DriveKind.URBAN, 300.0, 1), begin_ns=begin_ns)
    return measured(EQUATION, drive, 500.0, seed=1, MASS_OVER_ETA=1.05)


@pytest.fixture(scope="module")
def both(learned, later):
    return learned.begin_drive(compare=True).after(later).breakdowns()


def test_parts_and_the_unexplained_are_the_measured_energy(learned, town):
    parts = learned.breakdowns().of(-1)
    total = sum(interval.energy for interval in town)
    assert parts.measured == pytest.approx(total)
    explained = sum(parts.energy[WHOLE])
    assert explained == pytest.approx(total, rel=0.02)
    assert parts.total().kwh * 3.6e6 == pytest.approx(explained, rel=0.05)


def test_parts_have_the_sign_and_size_of_what_they_are(learned):
    parts = learned.breakdowns().of(-1)
    energy = dict(zip(Part, parts.energy, strict=True))
    assert energy[Part.AIR] > 0 and energy[Part.TYRES] > 0 and energy[Part.BRAKES] > 0
    assert energy[Part.DRIVETRAIN] > 0 and energy[Part.STANDING] > 0
    assert energy[Part.REGAINED] > 0  # beside the sum: what braking gave back
    assert abs(energy[Part.SLOPE]) < 0.1 * energy[Part.TYRES]  # a flat road


def test_what_is_learned_later_moves_the_parts_of_before(learned, both):
    before, first = learned.breakdowns().of(-1), both.of(0)
    assert first.measured == pytest.approx(before.measured)
    assert first.energy != pytest.approx(before.energy, rel=1e-12)
    assert np.linalg.det(first.covariance[:4, :4]) < np.linalg.det(before.covariance[:4, :4])


def test_a_difference_is_the_one_less_the_other_per_100_km(both):
    assert len(both.drives) == 2
    difference = both.difference(1, 0)
    for part in Part:
        base, other = (
            drive.of(part).kwh * 1e5 / drive.distance for drive in (both.of(0), both.of(1))
        )
        assert difference.of(part).kwh == pytest.approx(other - base, abs=1e-6)


def test_a_drive_that_goes_on_over_a_long_stop_is_one(learned, later):
    on = learned.begin_drive(goes_on=True).after(later).breakdowns()
    assert len(on.drives) == 1
    total = learned.breakdowns().of(-1).measured + sum(interval.energy for interval in later)
    assert on.of(-1).measured == pytest.approx(total)


def test_an_interval_without_battery_is_in_no_part(learned, town):
    before = learned.breakdowns().of(-1)
    silent = [replace(interval, energy=float("nan")) for interval in town]
    after = learned.after(silent).breakdowns().of(-1)
    assert after.measured == before.measured
    assert after.energy == pytest.approx(before.energy)


def test_without_heights_the_net_climb_is_as_unknown_as_roads_make_it(seen, learned):
    """It is no part of what they add up to: what slopes took more, others took less."""
    seen, unseen = (car.breakdowns().of(-1) for car in (seen, learned))
    assert (seen.unseen, unseen.unseen) == (0.0, pytest.approx(unseen.distance))
    climb = net_climb(unseen.distance)
    assert unseen.of(Part.SLOPE).sigma_kwh * 3.6e6 >= 0.9 * climb * 9.81 * EQUATION.mean[2]
    assert seen.of(Part.SLOPE).sigma_kwh < 0.1 * unseen.of(Part.SLOPE).sigma_kwh
    for part in (Part.BRAKES, Part.DRIVETRAIN):
        assert unseen.of(part).sigma_kwh > seen.of(part).sigma_kwh
    whole = list(Part)[WHOLE]
    assert unseen.of(*whole).sigma_kwh < 1.5 * seen.of(*whole).sigma_kwh


def test_what_one_hard_braking_leaves_unexplained_is_no_reason_to_doubt_the_model(learned, town):
    energies = [interval.energy for interval in town]
    hard = [*town[:-1], replace(town[-1], energy=energies[-1] + 5e5)]  # friction took it
    calm, braked = (
        car.breakdowns().of(-1).amounts()["unexplained"]
        for car in (learned, LearnedCar.new(EQUATION).after(hard))
    )
    assert abs(calm.kwh) < 3.0 * calm.sigma_kwh
    assert braked.kwh > 0.08 and braked.kwh < 3.0 * braked.sigma_kwh


def test_parts_of_a_known_car_are_as_unsure_as_they_are_mistaken_for_each_other(seen):
    """Wind looks like tyres, and brakes blend in differently; the sum stays known."""
    state = seen.state
    mean = np.repeat(state.mixture().mean[None], len(state.mean), axis=0)
    known = replace(state, mean=mean, covariance=1e-9 * state.covariance)
    breakdown = replace(seen, state=known).breakdowns().of(0)
    energy, std = breakdown.energy, np.sqrt(np.diagonal(breakdown.covariance))
    for part, share in {Part.AIR: 0.05, Part.STANDING: 0.05}.items():
        assert std[part] == pytest.approx(share * energy[part], rel=0.1)
    # No torque shows braking here, and what brakes took is missing in what was regained.
    assert 0.08 < std[Part.REGAINED] / energy[Part.REGAINED] < 0.15
    assert std[Part.BRAKES] == pytest.approx(std[Part.REGAINED], rel=0.1)
    assert np.sqrt(breakdown.covariance[WHOLE, WHOLE].sum()) < 0.5 * std[Part.REGAINED]
