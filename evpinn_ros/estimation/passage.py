"""Passage of the fast states: loads and winds forget themselves, a height becomes the next."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from evpinn_ros.estimation.car_state import SIZE, State
from evpinn_ros.estimation.gaussian import matern

ROAD = slice(State.HEIGHT, State.CLIMB + 1)  # states of the unseen road


def passage(
    rate: float,
    distance: float,
    slopes: np.ndarray,
    kept: Mapping[State, tuple[float, float | np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """Transition of the states, shape (SIZE, SIZE), and the noise it adds, (K, SIZE, SIZE).

    Args:
        rate: at which the road forgets itself, 1/m.
        distance: m.
        slopes: 1-sigma of the unseen slope of each hypothesis, shape (K,).
        kept: how much is left of a load or force, and its 1-sigma, one or of shape (K,).
    """
    road, wandered = matern(rate, distance)
    transition = np.eye(SIZE)
    noise = np.zeros((len(slopes), SIZE, SIZE))
    for state, (keep, sigma) in kept.items():
        transition[state, state] = keep
        noise[:, state, state] = sigma**2 * (1.0 - keep**2)
    transition[State.HEIGHT : State.CLIMB, State.HEIGHT : State.CLIMB] = road
    transition[State.CLIMB] = transition[State.HEIGHT]
    transition[State.CLIMB, State.HEIGHT] -= 1.0
    noise[:, ROAD, ROAD] = slopes[:, None, None] ** 2 * wandered[[0, 1, 0]][:, [0, 1, 0]]
    return transition, noise
