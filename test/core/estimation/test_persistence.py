"""What the battery last had beside a prediction."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.estimation.persistence import DECAY, OUTLIER, Persistence

SECOND_NS = 10**9
BEGIN_NS = 1_700_000_000 * SECOND_NS


def nanoseconds(seconds: float) -> int:
    return BEGIN_NS + round(seconds * SECOND_NS)


def one(told: float, age: float, sigma: float = 1000.0, power: float = 5000.0) -> tuple:
    """Prediction 0.1 s after one of the same power, the battery `age` s before it."""
    persistence = Persistence()
    persistence.add_one(nanoseconds(0.0), power, sigma, 0, math.nan)
    return persistence.add_one(nanoseconds(0.1), power, sigma, nanoseconds(0.1 - age), told)


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
    persistence.add_one(nanoseconds(0.0), 3000.0, 2000.0, 0, math.nan)
    power, _ = persistence.add_one(nanoseconds(0.1), 10.0, 2000.0, nanoseconds(0.0), 100.0)
    assert power == 0.0


steps = st.lists(
    st.tuples(
        st.floats(0.01, 1.5),  # s to the next sample
        st.floats(-3e4, 9e4),  # W
        st.floats(1.0, 4.0),  # s of age
        st.one_of(st.just(math.nan), st.floats(-1e5, 1e5)),
    ),
    min_size=1,
    max_size=30,
)


@settings(deadline=None)
@given(steps, st.integers(0, 30))
def test_one_by_one_is_as_in_arrays(rows: list[tuple[float, ...]], cut: int):
    seconds, powers, ages, told = np.array(rows).T
    stamps = np.array([nanoseconds(second) for second in np.cumsum(seconds)])
    told_ns = stamps - (ages**8 / 4**8 * 5.0 * SECOND_NS).astype(np.int64) - 1
    predicted = np.stack((powers, 500.0 + np.abs(powers) / 10.0), axis=1)
    scalar, arrays = Persistence(), Persistence()
    single = [
        scalar.add_one(ns, power, sigma, of_told, value)
        for ns, (power, sigma), of_told, value in zip(
            stamps.tolist(), predicted.tolist(), told_ns.tolist(), told.tolist(), strict=True
        )
    ]
    both = [
        arrays.add(stamps[part], predicted[part], told_ns[part], told[part])
        for part in (slice(cut), slice(cut, None))
    ]
    np.testing.assert_allclose(np.concatenate(both), single, rtol=1e-9, atol=1e-6)
