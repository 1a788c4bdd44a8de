"""Where the energy went: the parts add up, and their sums move with what is learned later."""

from dataclasses import replace
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.estimation.breakdown import (
    DISTANCE,
    HEIGHT_STRAYS,
    LEAST_DISTANCE,
    Breakdown,
    PartSums,
    Totals,
)
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.car_state import SIZE, State, prior_of
from evpinn_ros.estimation.terms import COUNT, WHOLE, Part, parts
from evpinn_ros.estimation.weak_form import Constants, Warmth, spent
from evpinn_ros.signals.interval import Interval, Steps
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.road import Conditions
from evpinn_ros.vehicle.files import load_vehicle
from test.estimation.test_weak_form import surroundings

MODEL_3 = load_vehicle("tesla_model_3_lr")
CAR, PRIOR = Constants.of(MODEL_3), prior_of(MODEL_3)
WARMTH = Warmth(0.7, 0.4)


def drawn(seed: int, motor: bool) -> tuple[np.ndarray, Steps]:
    """A state about the prior, the fast ones included, and some steps."""
    rng = np.random.default_rng(seed)
    spread = PRIOR.std.copy()
    spread[[State.AUX, State.FORCE, State.CLIMB]] = 300.0, 0.004, 0.5
    count = int(rng.integers(1, 7))
    speed, duration = rng.uniform(0.0, 35.0, count), rng.uniform(1.0, 2.0, count)
    motor_energy = rng.uniform(0.0, 4e4, (2, count)) if motor else np.full((2, count), math.nan)
    kinetic, climb = speed * rng.normal(0.0, 1.0, count), speed * rng.normal(0.0, 0.02, count)
    steps = Steps(duration, duration * speed, duration * speed**3, kinetic, climb, *motor_energy)
    return PRIOR.mean + rng.normal(0.0, 1.0, SIZE) * spread, steps


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**31), st.booleans(), surroundings)
def test_the_parts_are_the_whole_to_rounding(seed, motor, conditions):
    mean, steps = drawn(seed, motor)
    energy, gradient = parts(mean, steps, conditions, WARMTH, CAR)
    whole = spent(mean[None], steps, conditions, WARMTH, CAR)
    size = float(np.abs(energy).sum())
    assert energy[WHOLE].sum() == pytest.approx(whole.energy[0], rel=1e-9, abs=1e-9 * size)
    own = gradient[WHOLE].sum(0)
    scale = np.abs(gradient).sum(0) + 1e-9
    assert np.all(np.abs(own - whole.gradient[0]) <= 1e-9 * scale + 1e-9 * size)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31), st.booleans(), surroundings)
def test_the_gradient_of_each_part_is_its_change(seed, motor, conditions):
    mean, steps = drawn(seed, motor)
    _, gradient = parts(mean, steps, conditions, WARMTH, CAR)
    for state in (State.MASS, State.C_D, State.C_RR, State.COLD, State.P_AUX, State.NO_LOAD):
        step = np.zeros(SIZE)
        step[state] = 1e-6 * max(1.0, abs(mean[state]))
        above, below = (parts(mean + s, steps, conditions, WARMTH, CAR)[0] for s in (step, -step))
        slope = (above - below) / (2 * step[state])
        unbroken = state not in (State.MASS, State.C_D, State.C_RR)
        # The states at the wheels also move the force that copper loses to: left out, as `spent`.
        chosen = slice(None) if unbroken else slice(0, Part.BRAKES)
        assert slope[chosen] == pytest.approx(gradient[chosen, state], rel=1e-3, abs=20.0)


def interval(rng: np.random.Generator, start: int, energy: float = 0.0) -> Interval:
    speed = rng.uniform(3.0, 30.0)
    kinetic = speed * rng.normal(0.0, 1.0, 3)
    one, unknown = np.ones(3), np.full(3, math.nan)
    steps = Steps(one, one * speed, one * speed**3, kinetic, 0.0 * one, unknown, unknown)
    calm = Conditions(1.2, 0.0, None, 0.0, False)
    end = start + 3 * NANOSECONDS
    return Interval(start, end, steps, calm, False, energy, 0.0)


def driven(filter_: CarFilter, seed: int, count: int, share: float = 1.0) -> CarFilter:
    """The filter after intervals that draw this share of what it expects."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        one = interval(rng, number * 3 * NANOSECONDS)
        mean = filter_.mixture().mean[None]
        found = spent(mean, one.steps, one.conditions, filter_.warmth, filter_.constants)
        filter_.learn(interval_with(one, share * float(found.energy[0])))
    return filter_


def interval_with(one: Interval, energy: float) -> Interval:
    return replace(one, energy=energy)


def breakdown_of(filter_: CarFilter) -> Breakdown:
    found = filter_.parts.breakdowns(filter_.weights, 2e4, filter_.hilliness).of(-1)
    assert found is not None
    return found


def test_parts_and_the_unexplained_are_the_measured_energy():
    found = breakdown_of(driven(CarFilter(MODEL_3), 1, 60, share=1.07))
    amounts = found.amounts()
    whole = sum(amount.kwh for name, amount in amounts.items() if name != "regained")
    assert whole == pytest.approx(found.total().kwh, rel=1e-12)
    assert found.seconds == pytest.approx(180.0)
    assert found.distance > LEAST_DISTANCE


def test_covariances_stay_possible_and_shrink_with_what_is_learned():
    filter_ = driven(CarFilter(MODEL_3), 2, 100)
    covariance = breakdown_of(filter_).covariance
    assert np.abs(covariance - covariance.T).max() <= 1e-6 * np.abs(covariance).max()
    assert np.linalg.eigvalsh(covariance).min() >= -1e-6 * np.abs(covariance).max()
    before = PRIOR.std[State.MASS] ** 2 + PRIOR.std[State.C_D] ** 2
    whole = breakdown_of(filter_)
    sigma = math.sqrt(covariance[WHOLE, WHOLE].sum())
    assert sigma < 0.05 * math.sqrt(before) * np.abs(whole.energy[WHOLE]).sum()


def test_what_is_learned_later_moves_the_sums_of_before():
    """Half of the drive has no data on the standing load; a stop has, and the sum moves."""
    filter_ = driven(CarFilter(MODEL_3), 3, 20)
    before = filter_.parts.breakdowns(filter_.weights, 2e4, 0.0).of(-1)
    sums, state = filter_.parts, filter_.mixture()
    sigma = math.sqrt(state.covariance[State.P_AUX, State.P_AUX])
    still = Steps(*(np.array([x]) for x in (60.0, 0.0, 0.0, 0.0, 0.0, math.nan, math.nan)))
    load = float(state.mean[[State.P_AUX, State.AUX_DRIVE, State.AUX]].sum()) + 3 * sigma
    stop = Interval(
        10**12, 10**12 + 60 * NANOSECONDS, still, Conditions(1.2, 0.0, None, 0.0, False), False,
        60.0 * load, 0.0,
    )  # fmt: skip
    filter_.learn(stop)
    after = filter_.parts.breakdowns(filter_.weights, 2e4, 0.0).of(-1)
    own = float(filter_.mixture().mean[[State.P_AUX, State.AUX_DRIVE, State.AUX]].sum()) * 60.0
    moved = after.energy[Part.STANDING] - before.energy[Part.STANDING] - own
    assert sums is not filter_.parts
    assert moved > 0.2 * sigma * before.seconds  # the minute before was of the same load


def test_another_drive_begins_with_nothing():
    filter_ = driven(CarFilter(MODEL_3), 4, 10)
    filter_.begin_drive()
    assert filter_.parts.breakdowns(filter_.weights, 2e4, 0.0).of(-1) is None


def test_sums_that_go_on_over_a_long_stop_hold_both_sides_of_it():
    """The car is the same, so what comes later still teaches what was before."""
    filter_ = driven(CarFilter(MODEL_3), 4, 20)
    before = breakdown_of(filter_)
    filter_.begin_drive(goes_on=True)
    assert breakdown_of(filter_).energy == pytest.approx(before.energy)
    whole = breakdown_of(driven(filter_, 5, 60))
    assert whole.seconds > before.seconds and whole.measured > before.measured
    other = driven(CarFilter(MODEL_3), 4, 20)
    other.begin_drive(keep=True)
    driven(other, 5, 60)
    pieces = other.parts.breakdowns(other.weights, 2e4, other.hilliness).joined([0, 0]).of(0)
    assert whole.measured == pytest.approx(pieces.measured, rel=1e-3)
    sigmas = np.sqrt(np.diag(whole.covariance))
    assert np.all(np.abs(whole.energy - pieces.energy) <= 0.01 * sigmas)
    assert np.linalg.eigvalsh(whole.covariance).min() > -1e-6 * np.abs(whole.covariance).max()


def test_an_interval_without_battery_is_not_counted():
    filter_ = driven(CarFilter(MODEL_3), 5, 10)
    before = breakdown_of(filter_)
    filter_.learn(interval(np.random.default_rng(0), 10**12, energy=math.nan))
    assert breakdown_of(filter_).energy == pytest.approx(before.energy)
    assert breakdown_of(filter_).seconds == before.seconds


def test_parts_that_only_their_sum_is_known_of_are_given_together():
    covariance = np.diag(np.full(COUNT, 1e6))
    energy = np.full(COUNT, 1e5)
    covariance[Part.AIR, Part.AIR] = covariance[Part.DRIVETRAIN, Part.DRIVETRAIN] = 1e10
    covariance[Part.AIR, Part.DRIVETRAIN] = covariance[Part.DRIVETRAIN, Part.AIR] = -0.99e10
    found = Breakdown(energy, covariance, 8e5, 0.0, 1e4, 600.0)
    assert found.together() == [(Part.AIR, Part.DRIVETRAIN)]
    assert found.of(Part.AIR, Part.DRIVETRAIN).sigma_kwh < found.of(Part.AIR).sigma_kwh / 5


def test_nothing_is_shared_of_nothing():
    found = Breakdown(np.zeros(COUNT), np.zeros((COUNT, COUNT)), 0.0, 0.0, 0.0, 5.0)
    assert found.of(Part.AIR).share is None
    assert found.of(Part.AIR).kwh_per_100km is None
    assert found.together() == []


def test_a_state_that_is_moved_takes_along_the_parts_that_depend_on_it():
    cross = np.arange(2.0 * COUNT * SIZE).reshape(2, COUNT, SIZE)
    sums = replace(PartSums.none(2), cross=cross).moved(State.NO_LOAD, np.array([0.0, 0.5]))
    assert np.array_equal(sums.mean[0], np.zeros(COUNT))
    assert np.array_equal(sums.mean[1], 0.5 * cross[1, :, State.NO_LOAD])
    assert np.array_equal(sums.cross, cross)


def test_a_measured_height_strays_at_both_ends_of_each_drive():
    """Slope is taken from tyres or given to them; heights of two drives stray apart."""
    weight, drives = 2e4, (Totals(1e6, 0.0, 5e3, 400.0), Totals(1e6, 0.0, 1e4, 400.0))
    none = PartSums.none(1)
    sums = PartSums(np.zeros((1, 2 * COUNT)), np.zeros((1, 2 * COUNT, 2 * COUNT)), none.cross)
    found = replace(sums, drives=drives).breakdowns(np.ones(1), weight, 0.0)
    ends = math.sqrt(2.0) * weight * HEIGHT_STRAYS / 3.6e6
    one = found.of(0)
    assert one.of(Part.SLOPE).sigma_kwh == one.of(Part.TYRES).sigma_kwh == pytest.approx(ends)
    assert one.of(Part.SLOPE, Part.TYRES).sigma_kwh == pytest.approx(0.0, abs=1e-9)
    both = math.hypot(ends * DISTANCE / 5e3, ends * DISTANCE / 1e4)
    assert found.difference(1, 0).of(Part.SLOPE).sigma_kwh == pytest.approx(both)
    unseen = tuple(replace(each, unseen=each.distance) for each in drives)
    without = replace(sums, drives=unseen).breakdowns(np.ones(1), weight, 0.0)
    assert without.of(0).of(Part.SLOPE).sigma_kwh == 0.0
