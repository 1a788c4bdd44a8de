"""Least squares finds the coefficients that made the data."""

from dataclasses import replace
import math

import numpy as np
import pytest

from benchmarks.regression import (
    FIVE_TERMS,
    NOISE,
    SEVEN_TERMS,
    BatchLeastSquares,
    RecursiveLeastSquares,
    Terms,
)
from evpinn_ros.vehicle.physics import GRAVITY

# rho |v| v^2, |v|, v f+, v f-, 1, v^2, a^2: drag, rolling, inertia, braking, auxiliary, losses.
TRUE = np.array([0.4, 250.0, 2500.0, 1600.0, 900.0, 15.0, 400.0])
COUNTS = [FIVE_TERMS, SEVEN_TERMS]


def power_of(terms, count):
    coefficients = TRUE[:count] / terms.spread
    return lambda sample: float(terms.row(sample) @ coefficients) + sample.known_auxiliary


def test_terms_by_hand(vehicle, samples):
    terms = Terms(vehicle, SEVEN_TERMS)
    sample = next(s for s in samples if s.acceleration < -0.5)
    v, a = sample.speed, sample.acceleration
    force = 1.03 * a + GRAVITY * math.sin(sample.grade)
    wanted = [1.2 * v**3, v, 0.0, v * force, 1.0, v**2, a**2]
    assert terms.row(sample) / terms.spread == pytest.approx(wanted)


@pytest.mark.parametrize("count", COUNTS)
def test_before_driving_it_is_near_the_prior(vehicle, samples, count):
    initial = vehicle.initial
    start = RecursiveLeastSquares(vehicle, count).coefficients
    mass = initial.mass / initial.eta
    assert start[:3] == pytest.approx(
        [1.11 * initial.c_d / initial.eta, mass * GRAVITY * initial.c_rr, mass]
    )
    assert np.all(start[5:] == 0.0)


@pytest.mark.parametrize("count", COUNTS)
def test_recursive_finds_its_own_coefficients(vehicle, samples, teach, count):
    terms = Terms(vehicle, count)
    method = teach(RecursiveLeastSquares(vehicle, count), samples, power_of(terms, count))
    assert method.coefficients == pytest.approx(TRUE[:count], rel=0.02)


@pytest.mark.parametrize("count", COUNTS)
def test_batch_finds_its_own_coefficients(vehicle, samples, teach, count):
    terms = Terms(vehicle, count)
    # Its start counts as an observation, so it is near, not equal.
    method = teach(BatchLeastSquares(vehicle, count), samples, power_of(terms, count))
    assert method.coefficients == pytest.approx(TRUE[:count], rel=0.05)


def test_recursive_without_forgetting_is_the_batch_with_the_same_start(vehicle, samples, teach):
    terms = Terms(vehicle, SEVEN_TERMS)
    rng = np.random.default_rng(1)
    noise = {s.stamp_ns: rng.normal(0.0, 800.0) for s in samples}
    clean = power_of(terms, SEVEN_TERMS)
    method = RecursiveLeastSquares(vehicle, SEVEN_TERMS, forgetting=1.0, huber=math.inf)
    teach(method, samples, lambda s: clean(s) + noise[s.stamp_ns])
    rows = np.array([terms.row(s) for s in samples])
    target = np.array([clean(s) + noise[s.stamp_ns] - s.known_auxiliary for s in samples])
    # Ordinary least squares with the start as one more observation of each coefficient.
    rows = np.vstack((rows / NOISE, np.eye(SEVEN_TERMS)))
    target = np.append(target / NOISE, terms.start)
    batch = np.linalg.lstsq(rows, target, rcond=None)[0] * terms.spread
    assert method.coefficients == pytest.approx(batch, rel=1e-6)


def test_batch_is_fitted_each_minute_only(vehicle, samples, teach):
    power = power_of(Terms(vehicle, FIVE_TERMS), FIVE_TERMS)
    method = BatchLeastSquares(vehicle, FIVE_TERMS)
    start = method.coefficients
    teach(method, samples[:600], power)
    assert np.all(method.coefficients == start)
    teach(method, samples[600:610], power)
    fitted = method.coefficients
    assert np.all(fitted != start)
    teach(method, samples[610:1200], power)
    assert np.all(method.coefficients == fitted)


def test_one_wild_reading_hardly_moves_the_robust_one(vehicle, samples, teach):
    power = power_of(Terms(vehicle, FIVE_TERMS), FIVE_TERMS)
    moved = []
    for huber in (3.0, math.inf):
        method = RecursiveLeastSquares(vehicle, FIVE_TERMS, huber=huber)
        teach(method, samples[:3000], power)
        before = method.predict(samples[3001]).power
        method.observe(samples[3000], power(samples[3000]) + 200_000.0)
        moved.append(abs(method.predict(samples[3001]).power - before))
    assert moved[0] < 0.1 * moved[1]


def test_ten_minutes_of_standstill_cannot_wind_it_up(vehicle, samples, teach):
    power = power_of(Terms(vehicle, SEVEN_TERMS), SEVEN_TERMS)
    method = teach(RecursiveLeastSquares(vehicle, SEVEN_TERMS), samples, power)
    before = method.predict(samples[100]).power
    still = replace(samples[-1], speed=0.0, acceleration=0.0, grade=0.0, known_auxiliary=0.0)
    for _ in range(6_000):
        method.observe(still, 900.0)
    method.observe(samples[0], power(samples[0]) + 500.0)
    assert method.predict(samples[100]).power == pytest.approx(before, abs=1000.0)
