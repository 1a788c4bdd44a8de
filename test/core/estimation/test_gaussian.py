"""Conditioning against the same in dense algebra, written out one by one."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.estimation.gaussian import (
    Gaussian,
    Innovation,
    at_least_zero,
    condition,
    innovate,
    mixture,
    outlier_variance,
    replace_states,
)

COUNT, SIZE = 3, 5
seeds = st.integers(0, 10_000)


def covariances(rng, count=COUNT) -> np.ndarray:
    root = rng.standard_normal((count, SIZE, SIZE))
    return root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(SIZE)


def drawn(rng) -> Gaussian:
    return Gaussian(rng.standard_normal((COUNT, SIZE)), covariances(rng))


@given(seeds)
def test_a_measurement_is_that_of_each_hypothesis_alone(seed):
    rng = np.random.default_rng(seed)
    state = drawn(rng)
    gradient, measured = rng.standard_normal((COUNT, SIZE)), rng.standard_normal(COUNT)
    variance, extra = rng.uniform(0.1, 2.0, (2, COUNT))
    seen = innovate(state, gradient, measured, variance)
    conditioned = condition(state, seen, extra)
    for k in range(COUNT):
        # The information form: precisions add up.
        row, noise = gradient[k], variance[k] + extra[k]
        inverse = np.linalg.inv(state.covariance[k]) + np.outer(row, row) / noise
        posterior = np.linalg.inv(inverse)
        np.testing.assert_allclose(conditioned.covariance[k], posterior, rtol=1e-6, atol=1e-8)
        expected = state.mean[k] + posterior @ row * measured[k] / noise
        np.testing.assert_allclose(conditioned.mean[k], expected, rtol=1e-6, atol=1e-8)


@given(seeds)
def test_a_mixture_of_equals_is_the_one_and_moments_are_those_of_draws(seed):
    rng = np.random.default_rng(seed)
    bank, weights = drawn(rng), rng.dirichlet(np.ones(COUNT))
    equal = mixture(weights, Gaussian(*(np.repeat(part[:1], COUNT, 0) for part in bank)))
    np.testing.assert_allclose(equal.mean, bank.mean[0], atol=1e-12)
    np.testing.assert_allclose(equal.covariance, bank.covariance[0], atol=1e-12)
    whole = mixture(weights, bank)
    second = sum(
        w * (c + np.outer(m, m))
        for w, m, c in zip(weights, bank.mean, bank.covariance, strict=True)
    )
    outer = np.outer(whole.mean, whole.mean)
    np.testing.assert_allclose(whole.covariance + outer, second, atol=1e-9)


def test_what_is_replaced_is_without_correlation_and_the_rest_is_as_it_was():
    state = drawn(np.random.default_rng(0))
    before = Gaussian(state.mean.copy(), state.covariance.copy())
    replaced = replace_states(state, {1: np.array([1.0, 2.0, 3.0]), 3: 0.0})
    assert replaced.mean[:, [1, 3]].tolist() == [[0.0, 0.0]] * COUNT
    assert replaced.covariance[:, 1, 1].tolist() == [1.0, 2.0, 3.0]
    off = replaced.covariance.copy()
    off[:, 1, 1] = 0.0
    assert not off[:, [1, 3]].any() and not off[:, :, [1, 3]].any()
    rest = np.ix_(range(COUNT), [0, 2, 4], [0, 2, 4])
    assert np.array_equal(replaced.covariance[rest], state.covariance[rest])
    assert np.array_equal(before.covariance, state.covariance), "functions are pure"


def test_an_outlier_pulls_no_further_than_its_limit():
    """Huber: beyond the limit the weighted residual, r / (R x^2), falls instead of growing."""
    variance = np.array([4.0])

    def pull(residual: float) -> tuple[float, float]:
        seen = Innovation(np.array([residual]), variance, np.ones((1, 1)))
        extra = outlier_variance(seen, variance, limit=2.5)
        return float(extra[0]), residual / float(variance[0] + extra[0])

    assert pull(4.9)[0] == pull(-5.0)[0] == 0.0
    assert pull(10.0)[0] == pytest.approx(4.0 * (2.0**2 - 1.0))
    assert pull(50.0)[1] < pull(10.0)[1] < pull(5.0)[1]


@given(seeds, st.sets(st.integers(0, SIZE - 1)))
def test_the_likeliest_mean_with_entries_of_at_least_zero_meets_the_conditions_of_a_minimum(
    seed, entries
):
    """Karush, Kuhn and Tucker: uphill where an entry is held at zero, level elsewhere."""
    rng = np.random.default_rng(seed)
    state = Gaussian(3.0 * rng.standard_normal(SIZE), covariances(rng, 1)[0])
    likeliest = at_least_zero(state, sorted(entries))
    slope = np.linalg.solve(state.covariance, likeliest - state.mean)
    for entry, value in enumerate(likeliest.tolist()):
        held = entry in entries and value == 0.0
        assert value >= 0.0 or entry not in entries
        assert slope[entry] >= -1e-9 if held else abs(slope[entry]) < 1e-8


@given(seeds)
def test_a_known_sum_stays_when_a_part_of_it_cannot_be_negative(seed):
    rng = np.random.default_rng(seed)
    state, ones = Gaussian(rng.standard_normal(SIZE), covariances(rng, 1)[0]), np.ones(SIZE)
    exactly = np.zeros(())
    of_sum = condition(state, innovate(state, ones, exactly, exactly), exactly)
    likeliest = at_least_zero(of_sum, range(SIZE - 1))
    assert likeliest.sum() == pytest.approx(state.mean.sum(), abs=1e-8)
