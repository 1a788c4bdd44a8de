"""What the battery last had beside a prediction."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.estimation.persistence import (
    DECAY,
    FADING,
    OUTLIER,
    Persistence,
    _Weights,
)

SECOND_NS = 10**9
BEGIN_NS = 1_700_000_000 * SECOND_NS


def nanoseconds(seconds: float) -> int:
    return BEGIN_NS + round(seconds * SECOND_NS)


def one(told: float, age: float, sigma: float = 1000.0, power: float = 5000.0) -> tuple:
    """Prediction 0.1 s after one of the same power, the battery `age` s before it."""
    persistence = Persistence()
    persistence.add(nanoseconds(0.0), power, sigma, 0, math.nan)
    return persistence.add(nanoseconds(0.1), power, sigma, nanoseconds(0.1 - age), told)


def test_an_error_decays():
    for age in (0.02, 0.1):
        power, sigma = one(6000.0, age)
        kept = math.exp(-age / DECAY)
        assert power == pytest.approx(5000.0 + 1000.0 * kept)
        assert sigma == pytest.approx(1000.0 * math.sqrt(1.0 - kept**2))


def test_a_glitch_counts_as_three_sigmas_and_an_unknown_power_as_nothing():
    assert one(1e9, 0.1)[0] == pytest.approx(5000.0 + OUTLIER * 1000.0 * math.exp(-0.1 / DECAY))
    assert one(math.nan, 0.1) == (5000.0, 1000.0)
    assert one(9000.0, 1.0) == (5000.0, 1000.0)  # before the first prediction


def test_nothing_is_given_back_that_neither_says():
    assert one(0.0, 0.02, power=5.0)[0] >= 0.0
    persistence = Persistence()
    persistence.add(nanoseconds(0.0), 3000.0, 2000.0, 0, math.nan)
    power, _ = persistence.add(nanoseconds(0.1), 10.0, 2000.0, nanoseconds(0.0), 100.0)
    assert power == 0.0


def test_what_a_change_of_the_prediction_is_worth_is_learned():
    """A prediction of noise beside a power that stays: the last reading is the better one."""
    persistence, wrong = Persistence(), []
    for index in range(600):
        power = 20_000.0 + 3000.0 * (-1) ** index
        battery_ns = nanoseconds(0.1 * (index - 1))
        given, _ = persistence.add(nanoseconds(0.1 * index), power, 2000.0, battery_ns, 20_000.0)
        wrong.append(abs(given - 20_000.0))
    assert max(wrong[500:]) < 300.0 < 1500.0 < wrong[1]


@given(st.integers(0, 10_000), st.floats(0.05, 0.5))
def test_the_weights_are_those_of_least_squares(seed, step):
    """By arrays: the information form of the same prior, fading and noise."""
    rng, weights = np.random.default_rng(seed), _Weights()
    mean = np.zeros(2)
    covariance = np.eye(2)
    for first, second, noise in rng.normal(0.0, (500.0, 800.0, 300.0), (40, 3)):
        seen, left = 0.8 * first - 0.5 * second + noise, math.exp(-step / FADING)
        weights.learn(first, second, seen, 900.0, step)
        mean = left * mean
        covariance = left**2 * covariance + (1.0 - left**2) * np.eye(2)
        row = np.array([first, second])
        information = np.linalg.inv(covariance)
        covariance = np.linalg.inv(information + np.outer(row, row) / 900.0**2)
        mean = covariance @ (information @ mean + row * seen / 900.0**2)
        assert weights.of(1.0, 0.0) == pytest.approx(mean[0])
        assert weights.of(0.0, 1.0) == pytest.approx(mean[1])
