"""What the battery last had beside a prediction."""

import math

import pytest

from evpinn_ros.core.estimation.persistence import DECAY, OUTLIER, Persistence

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
