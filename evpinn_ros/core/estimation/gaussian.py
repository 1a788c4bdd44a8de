"""Linear algebra of Gaussians in batches, independent of cars.

Arrays carry leading axes for the hypotheses of a bank: means have shape (..., n), covariances
(..., n, n). Functions are pure: they return new arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

MOST = 1e12  # of a mean or 1-sigma of any unit: J of a month of driving
LEAST_VARIANCE, ROUNDING = 1e-12, 1e-6  # of a covariance, and of its correlations


class Gaussian(NamedTuple):
    """A mean, shape (..., n), and a covariance, shape (..., n, n)."""

    mean: np.ndarray
    covariance: np.ndarray


class Innovation(NamedTuple):
    """A scalar measurement against its prediction.

    Attributes:
        residual: measured less predicted, shape (...).
        variance: of that, as predicted, shape (...).
        along: covariance times gradient, shape (..., n).
    """

    residual: np.ndarray
    variance: np.ndarray
    along: np.ndarray


def innovate(
    state: Gaussian, gradient: np.ndarray, residual: np.ndarray, noise: np.ndarray
) -> Innovation:
    """The innovation of a scalar measurement.

    Args:
        state: before it.
        gradient: of the measurement by the state, shape (..., n) or (n,).
        residual: measured less predicted, shape (...).
        noise: variance of the measurement, shape (...).
    """
    along = np.einsum("...ij,...j->...i", state.covariance, gradient)
    return Innovation(residual, np.einsum("...i,...i->...", gradient, along) + noise, along)


def condition(state: Gaussian, seen: Innovation, extra: np.ndarray) -> Gaussian:
    """The state given a measurement; extra: additional variance of outliers, shape (...)."""
    gain = seen.along / (seen.variance + extra)[..., None]
    mean = state.mean + gain * seen.residual[..., None]
    change = gain[..., :, None] * seen.along[..., None, :]
    return Gaussian(mean, state.covariance - change)


def replace_states(state: Gaussian, variances: Mapping[Any, Any]) -> Gaussian:
    """The state with some entries set to zero, uncorrelated, with these variances by index."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    for index, variance in variances.items():
        mean[..., index] = 0.0
        covariance[..., index, :] = covariance[..., :, index] = 0.0
        covariance[..., index, index] = variance
    return Gaussian(mean, covariance)


def mixture(weights: np.ndarray, state: Gaussian) -> Gaussian:
    """Mean, shape (n,), and covariance, shape (n, n), of a weighted mixture of K states."""
    mean = weights @ state.mean
    away = state.mean - mean
    covariance = np.einsum("k,kij->ij", weights, state.covariance)
    return Gaussian(mean, covariance + np.einsum("k,ki,kj->ij", weights, away, away))


def at_least_zero(state: Gaussian, entries: Sequence[int]) -> np.ndarray:
    """Likeliest mean, shape (n,), if some entries cannot be negative.

    The other entries move by their covariance, so a known sum stays as it is. An active-set method
    (Nocedal and Wright, Numerical Optimization, 16.5).
    """
    mean, covariance = state
    held: list[int] = []
    for _ in range(2 * len(entries) + 1):
        price = np.linalg.lstsq(covariance[np.ix_(held, held)], -mean[held], rcond=1e-12)[0]
        likeliest = mean + covariance[:, held] @ price
        likeliest[held] = 0.0
        needless = [entry for entry, paid in zip(held, price, strict=True) if paid < 0.0]
        beyond = [entry for entry in entries if likeliest[entry] < 0.0]
        if not (needless or beyond):
            break
        held = [entry for entry in held if entry not in needless]
        held += [min(beyond, key=lambda entry: likeliest[entry])] if beyond else []
    return np.asarray(likeliest)


def outlier_variance(seen: Innovation, noise: np.ndarray, limit: float) -> np.ndarray:
    """Extra variance of an innovation beyond `limit` sigmas: a heavy tail (Huber, 1964)."""
    beyond = np.maximum(1.0, np.abs(seen.residual) / (limit * np.sqrt(seen.variance)))
    return np.asarray(noise * (beyond**2 - 1.0))


def is_possible(state: Gaussian) -> bool:
    """True if mean and covariance are finite, not too large, symmetric and not negative."""
    mean, covariance = state
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        return False
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    std = np.sqrt(np.maximum(variance, LEAST_VARIANCE))
    if max(np.abs(mean).max(), std.max()) > MOST or np.abs(covariance).max() > MOST**2:
        return False
    scaled = covariance / (std[..., :, None] * std[..., None, :])
    skew = np.abs(scaled - np.swapaxes(scaled, -1, -2)).max()
    return bool(skew < ROUNDING and np.linalg.eigvalsh(scaled).min() > -ROUNDING)
