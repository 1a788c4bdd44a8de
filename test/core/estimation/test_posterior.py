"""The posterior: pure functions of values, and one solve over a window is the same estimate."""

from dataclasses import replace
import math

import numpy as np
import pytest

from benchmarks.truth import PROFILE
from evpinn_ros.core.estimation import posterior
from evpinn_ros.core.estimation.gaussian import Gaussian
from evpinn_ros.core.estimation.journey import NOWHERE, Journey, noise_of, wandered
from evpinn_ros.core.estimation.posterior import (
    BANK,
    advance,
    begin_drive,
    initial_state,
    interval_terms,
    learn,
    see_motor,
    update,
)
from evpinn_ros.core.estimation.states import LASTING, OFFSETS, SIZE, WEIGHTS, State
from evpinn_ros.core.estimation.terms import HEATING, Warmth, equation_of
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.signals.reorder import in_order
from evpinn_ros.core.signals.stream import SampleStream, StreamSettings
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.physics import GRAVITY
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from test.core.estimation.conftest import measured

CAR = load_vehicle("tesla_model_3_lr")
EQUATION = equation_of(CAR)


@pytest.fixture(scope="module")
def town(intervals):
    """Four minutes of a car that differs from the prior, with noise."""
    drive = intervals((DriveKind.URBAN, 240.0, 0), begin_ns=0)
    return measured(EQUATION, drive, 2e3, seed=1, MASS_OVER_ETA=1.1, DRAG_AREA_OVER_ETA=0.9)


def learned(drive):
    state = initial_state(EQUATION)
    for interval in drive:
        state, _ = learn(state, EQUATION, interval_terms(EQUATION, interval, state.seconds))
    return state


@pytest.fixture(scope="module")
def known(town):
    """The state after that drive."""
    return learned(town)


def test_one_after_the_other_is_one_solve_over_the_whole_window(monkeypatch):
    """Given noise, without outliers: what is older is the arrival cost, to 1e-9.

    A load that wanders is given by its covariance over the window.
    """
    monkeypatch.setattr(posterior, "OUTLIER", 1e6)
    monkeypatch.setattr(posterior, "LEAST_SCALE", 1.0)
    monkeypatch.setattr(posterior, "MOST_SCALE", 1.0)
    rng = np.random.default_rng(0)
    state, count, seconds = initial_state(EQUATION), 25, 10.0
    start = state
    rows = rng.normal(size=(count, SIZE)) * np.sqrt(np.diag(EQUATION.covariance) + 1.0) * 10.0
    rows[:, State.LOAD :] = 0.0  # states of this moment: the journey puts them in
    rows[:, State.LOSS_DRIVE] = 0.0  # which no interval shows
    rows[:, WEIGHTS] = rng.normal(size=(count, rows[:, WEIGHTS].shape[1])) * 1e3
    energy, sampling = rng.normal(size=count) * 1e5, 4e6
    for row, drawn in zip(rows, energy, strict=True):
        journey = Journey(row, seconds, np.zeros(3), 0.0)
        state, _ = update(advance(state, seconds), journey, drawn, sampling)
    left, integral, rest = wandered(seconds)
    for k in range(len(BANK)):
        # Loads of each interval as sums of independent numbers: start, then fresh ones.
        size = BANK[k, 1]
        fresh = size**2 * np.array(
            [[1.0 - left**2, integral * (1.0 - left)], [integral * (1.0 - left), rest]]
        )
        load, drawn = [size], []
        shape = np.linalg.cholesky(fresh)
        for _ in range(count):
            drawn.append([part * integral for part in load])
            load = [part * left for part in load] + shape[0].tolist()
            drawn[-1] += shape[1].tolist()
        parts = np.array([row + [0.0] * (len(drawn[-1]) - len(row)) for row in drawn])
        covariance = parts @ parts.T + sampling * np.eye(count)
        prior = start.covariance[k].copy()
        prior[State.LOAD, State.LOAD] = 0.0
        seen = rows @ prior @ rows.T + covariance
        gain = prior @ rows.T @ np.linalg.inv(seen)
        mean = start.mean[k] + gain @ (energy - rows @ start.mean[k])
        left_over = prior - gain @ rows @ prior
        index = LASTING + OFFSETS
        scale = np.sqrt(np.diag(prior)[index]) + 1e-12
        away = (state.mean[k][index] - mean[index]) / scale
        assert np.abs(away).max() < 1e-9
        block = np.ix_(index, index)
        apart = (state.covariance[k][block] - left_over[block]) / np.outer(scale, scale)
        assert np.abs(apart).max() < 1e-9


def test_another_drive_keeps_the_car_and_part_of_the_offsets(known):
    after = begin_drive(known, EQUATION)
    np.testing.assert_array_equal(after.mean[:, LASTING], known.mean[:, LASTING])
    kept = [posterior.DRIVE_KEPT[offset] for offset in OFFSETS]
    assert after.mean[:, OFFSETS] == pytest.approx(kept * known.mean[:, OFFSETS])
    grown = np.diagonal(after.covariance - known.covariance, axis1=1, axis2=2)[:, LASTING]
    assert (grown >= 0.0).all() and grown.max() > 0.0
    assert (after.seconds, after.intervals, after.last_drive) == (0.0, 0, known.seconds)
    # The prior of a car never driven is as wide as it is; from then on drives are judged.
    assert initial_state(EQUATION).model(EQUATION).trust == 1.0 < after.model(EQUATION).trust


def test_how_drives_differ_is_learned_from_many(known):
    state = known
    for sign in (1, -1) * 10:
        mean = state.mean.copy()
        mean[:, State.LOAD_DRIVE] = sign * 2000.0
        state = begin_drive(replace(state, mean=mean, intervals=20), EQUATION)
    index = OFFSETS.index(State.LOAD_DRIVE)
    learned_std = math.sqrt(state.offset_variance[index])
    assert learned_std > 1000.0 > math.sqrt(known.offset_variance[index])


def test_whatever_a_winter_taught_heating_is_never_below_zero(known):
    """The likeliest car that heats: what is known of sums of states stays."""
    mean, covariance = known.mean.copy(), known.covariance.copy()
    mean[:, [State.COLD, State.HOT_START]] = -50.0, -10.0
    covariance[:, State.COLD, State.LOAD_DRIVE] = covariance[:, State.LOAD_DRIVE, State.COLD] = 0.0
    model = known.with_gaussian(Gaussian(mean, covariance)).model(EQUATION)
    assert model.mean[HEATING].min() >= 0.0
    unsure = known.with_gaussian(Gaussian(known.mean, known.covariance)).model(EQUATION)
    assert unsure.mean[HEATING].min() >= 0.0


def test_neither_battery_nor_motor_teaches_what_drives_differ_by():
    """So it goes with no other state, and its variance alone fades."""
    drive = simulate(DriveKind.URBAN, CAR, 300.0, 4, motor_torque=True, can_profile=PROFILE)
    stream = SampleStream(StreamSettings(), CAR.air_density, CAR.motor_ratio)
    state, told = initial_state(EQUATION), 0
    for _, interval in stream.add(in_order(Block.of(drive.readings))).intervals:
        if math.isnan(interval.energy):
            continue
        told += interval.steps.motor_known
        state, _ = learn(state, EQUATION, interval_terms(EQUATION, interval, state.seconds))
    model = state.model(EQUATION)
    assert told > 10 and model.mean[State.LOSS_DRIVE] == 0.0
    others = np.delete(model.covariance[State.LOSS_DRIVE], State.LOSS_DRIVE)
    assert not others.any()
    np.testing.assert_allclose(model.covariance, model.covariance.T, rtol=1e-6, atol=1e-6)


def test_drives_differ_by_more_than_what_no_drive_showed(known):
    """The share of a drive is in the 1-sigma of the next whole one, and fades in a drive."""
    begun = begin_drive(known, EQUATION).model(EQUATION)
    share = State.LOSS_DRIVE.std
    assert begun.covariance[State.LOSS_DRIVE, State.LOSS_DRIVE] == pytest.approx(share**2)
    later = known.model(EQUATION).covariance[State.LOSS_DRIVE, State.LOSS_DRIVE]
    assert known.seconds > 100.0 and later < 0.4 * share**2


def test_a_dropout_is_less_and_less_sure_and_journeys_add_up(town, known):
    model, sigmas = known.model(EQUATION), []
    first, second = (interval_terms(EQUATION, interval, 300.0).journey for interval in town[:2])
    both = first.plus(second)
    assert both.less(second).row == pytest.approx(first.row)
    assert both.share(0.5).seconds == pytest.approx(first.seconds)
    journey = NOWHERE
    for interval in town:
        journey = journey.plus(interval_terms(EQUATION, interval, 300.0).journey)
        sigmas.append(model.predicted(journey)[1])
    assert (np.diff(sigmas) > 0.0).all()
    assert model.predicted(NOWHERE) == (0.0, 0.0)
    trusted_less = replace(model, trust=4.0 * model.trust)  # a factor of the variance
    assert trusted_less.predicted(journey)[1] == pytest.approx(2.0 * sigmas[-1])


def test_what_is_wrong_while_driving_says_nothing_of_a_car_that_stands(town):
    """Where clocks of speed and battery differ, starts and stops are wrong, and nothing else."""
    town = [replace(interval, height_known=True) for interval in town]  # no hill takes the blame
    way = [abs(interval.distance) / interval.duration for interval in town]
    assert min(way) < 0.1, "it stands at times"
    wrong = [
        replace(
            interval,
            energy=interval.energy + (-1) ** i * 2000.0 * interval.duration * (0.2 < speed < 5.0),
        )
        for i, (interval, speed) in enumerate(zip(town, way, strict=True))
    ]
    right, spoilt = (learned(4 * drive).model(EQUATION) for drive in (town, wrong))
    journeys = [interval_terms(EQUATION, interval, 600.0).journey for interval in town]
    still, fast = (journeys[way.index(speed)] for speed in (min(way), max(way)))
    assert spoilt.predicted(fast)[1] > 2.0 * right.predicted(fast)[1]
    assert spoilt.predicted(still)[1] < 1.3 * right.predicted(still)[1]


def test_noise_is_of_the_kind_of_what_the_car_did(town):
    """150 W while it stands, with 40 N more while it moves, 30 N with torque; ten s, scale 1."""
    steps, ten = town[0].steps, np.full(10, 1.0)
    unknown = np.nan * ten
    still = steps._replace(
        duration=ten, distance=0.0 * ten, motor_drive=unknown, motor_brake=unknown
    )
    assert noise_of(still) == pytest.approx([1.5 * 10 * 150**2, 0, 0])
    fast = still._replace(distance=20.0 * ten)
    moving = 1.5 * 10 * (150**2 + (40 * 20) ** 2)
    assert noise_of(fast) == pytest.approx([0, moving, 0])
    with_torque = 1.5 * 10 * (150**2 + (30 * 20) ** 2)
    told = fast._replace(motor_drive=ten, motor_brake=ten)
    assert noise_of(told) == pytest.approx([0, 0, with_torque])


def test_coldness_goes_from_one_to_nothing_and_comes_back_as_the_car_stands():
    assert Warmth.after(0.0) == (1.0, 1.0)
    assert max(Warmth.after(1e6)) < 1e-9
    assert Warmth.after(1e6).stood(1e6) == pytest.approx((1.0, 1.0))


def test_what_the_hypotheses_were_worth_is_forgotten(town):
    """What one had over another before an interval is less after it, whatever it shows."""
    state = learned(town[:5])
    head_start = np.arange(len(BANK)) * 3.0
    ahead = replace(state, evidence=state.evidence + head_start)
    level, biased = (
        learn(start, EQUATION, interval_terms(EQUATION, town[5], 30.0))[0]
        for start in (state, ahead)
    )
    left = np.diff(biased.evidence - level.evidence)
    assert left == pytest.approx(3.0 * (1.0 - 1.0 / posterior.EVIDENCE_KEPT), abs=1e-9)


def test_a_fast_car_s_motor_tells_less_of_its_mass():
    """Its noise is a force, which is energy by the road; drawn alike, more of it is noise."""
    rows = np.zeros((2, SIZE))
    rows[:, State.MASS_OVER_ETA], rows[:, State.MOTOR_DRIVE] = 100.0, -1e5
    slow, fast = (see_motor(initial_state(EQUATION), rows, square) for square in (1e2, 1e5))
    variances = [
        state.covariance[:, State.MASS_OVER_ETA, State.MASS_OVER_ETA] for state in (slow, fast)
    ]
    assert (variances[0] < 0.9 * variances[1]).all()


def test_letting_time_pass_is_one_linear_step_of_the_states_with_noise():
    rng = np.random.default_rng(0)
    start = initial_state(EQUATION)
    root = rng.standard_normal(start.covariance.shape)
    mean, covariance = rng.standard_normal(start.mean.shape), root @ root.transpose(0, 2, 1)
    before = replace(start, mean=mean, covariance=covariance)
    after = advance(before, 10.0, 100.0)
    left, integral, rest = wandered(10.0)
    step = np.eye(SIZE)
    step[State.WANDERED, State.LOAD_ENERGY] = step[State.CLIMBED, State.CLIMB] = 1.0
    step[State.CLIMB, State.CLIMB] = step[State.LOAD_ENERGY, State.LOAD_ENERGY] = 0.0
    step[State.LOAD_ENERGY, State.LOAD], step[State.LOAD, State.LOAD] = integral, left
    fresh = after.covariance - step @ covariance @ step.T
    np.testing.assert_allclose(after.mean, mean @ step.T, rtol=1e-12)
    load, energy, climb = State.LOAD, State.LOAD_ENERGY, State.CLIMB
    weight = GRAVITY * mean[:, State.MASS_OVER_ETA]
    for k, variance in enumerate(before.load_variance):
        expected = np.zeros((SIZE, SIZE))
        expected[load, load], expected[energy, energy] = variance * (1 - left**2), variance * rest
        expected[load, energy] = expected[energy, load] = variance * integral * (1 - left)
        expected[climb, climb] = weight[k] ** 2 * before.bands.growth * 100.0
        np.testing.assert_allclose(fresh[k], expected, rtol=1e-9, atol=1e-6 * variance)


def test_of_a_sparse_log_no_interval_is_trusted_more_for_the_power_that_it_measured(town):
    """With rows seconds apart the variance is that of predicted power: bursts are seen or not."""
    dense = town[10]
    steps = dense.steps
    slow = (5.0 * column for column in (steps.duration, steps.distance, steps.air))
    sparse = replace(dense, steps=Steps(*slow, *steps[3:]), end_ns=dense.start_ns + 30 * 10**9)

    def sigma(interval, sampling):
        measured = replace(interval, sampling_variance=sampling)
        state = initial_state(EQUATION)
        return learn(state, EQUATION, interval_terms(EQUATION, measured, 0.0))[1].sigma

    assert sigma(dense, 1e12) > 2.0 * sigma(dense, 1e6)
    assert sigma(sparse, 1e12) == sigma(sparse, 1e6)
    even = sparse.steps._replace(
        distance=np.full(6, sparse.distance / 6), kinetic=np.zeros(6), climb=np.zeros(6)
    )
    bursts = even._replace(kinetic=200.0 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))
    apart = (sigma(replace(sparse, steps=driven), 0.0) for driven in (even, bursts))
    assert next(apart) < next(apart)
