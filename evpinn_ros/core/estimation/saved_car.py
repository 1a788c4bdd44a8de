"""A car as it is saved: with the names of its states, so that a new state voids no file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evpinn_ros.core.estimation.gaussian import Gaussian, is_possible
from evpinn_ros.core.estimation.posterior import CarState, initial_state
from evpinn_ros.core.estimation.states import LASTING, NAMES, OFFSETS, SIZE, known_names
from evpinn_ros.core.estimation.terms import Equation

MOST_AWAY = 30.0  # prior sigmas; no state was ever learned further away


def saved_state(state: CarState) -> CarState:
    """A state to save: every state has a variance from drive to drive, zero but for `OFFSETS`."""
    variance = np.zeros(SIZE)
    variance[OFFSETS] = state.offset_variance
    return replace(state, offset_variance=variance)


def state_of(saved: CarState, equation: Equation) -> CarState:
    """The state that was saved; entries that the file lacks are at their prior.

    Raises:
        ValueError: numbers are missing, the state is no Gaussian, or the car is farther from the
            prior of its vehicle file than any drive leads.
    """
    fresh = initial_state(equation)
    count, size = len(fresh.mean), len(saved.names)
    sizes = saved.mean.size, saved.covariance.size, saved.offset_variance.size
    if sizes != (count * size, count * size * size, size) or len({*saved.names}) != size:
        raise ValueError("numbers of the states are missing")
    theirs, ours = known_names(saved.names)
    if not ours:
        raise ValueError("none of the states is known")
    mean, covariance = fresh.mean.copy(), fresh.covariance.copy()
    covariance[:, ours, :] = covariance[:, :, ours] = 0.0
    mean[:, ours] = np.reshape(saved.mean, (count, size))[:, theirs]
    square = np.reshape(saved.covariance, (count, size, size))
    covariance[:, np.array(ours)[:, None], ours] = square[:, np.array(theirs)[:, None], theirs]
    gaussian = Gaussian(mean, covariance)
    prior = np.sqrt(np.diagonal(fresh.covariance, axis1=1, axis2=2))[:, LASTING]
    away = np.abs(mean - fresh.mean)[:, LASTING] / np.maximum(prior, 1e-9)
    if not (is_possible(gaussian) and away.max() <= MOST_AWAY):
        raise ValueError("the state of the car is out of range")
    variance = np.zeros(len(NAMES))
    variance[OFFSETS] = fresh.offset_variance
    variance[ours] = saved.offset_variance[theirs]
    if variance[OFFSETS].min() < 0.0:
        raise ValueError("a variance of the state is negative")
    offsets = variance[OFFSETS]
    return replace(saved, mean=mean, covariance=covariance, offset_variance=offsets, names=NAMES)
