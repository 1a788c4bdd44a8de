"""The network of a car: a force that eq. 12-21 leave out, as a function of speed and wheel force.

Battery power of a moving car is that of eq. 21 plus v N(v, f), with

    N(v, f) = sum_j w_j tanh(a_j . (v, f) + b_j),        f: force at the wheels over the mass,

eq. 1 of the paper with one hidden layer. The inner weights a, b are drawn once; the outer weights
w are states in the same posterior as the physics and learned from the same energies (a Bayesian
last layer over random features). What the terms of eq. 21 explain of a unit over reference driving
is subtracted from it, so that no unit competes with a parameter of the physics. The rest of
`UNITS` units is projected on its `states.NETWORK` strongest directions, which hold all but a
thousandth of it.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import like, namespace
from evpinn_ros.common.package_data import bundled_lines
from evpinn_ros.core.estimation.states import NETWORK

UNITS = 96
SPEED_CENTRE, SPEED_SCALE, FORCE_SCALE = 10.0, 15.0, 1.2  # m/s, m/s, m/s^2
SPREAD = 1.2  # 1-sigma of an inner weight
REFERENCE = "config/reference/driving.csv"
DRAWN = "config/reference/units.csv"  # `drawn_units(0)`
GRADES = (0.0, 0.0086, -0.0086)  # of the reference, a third of it each


class Driving(NamedTuple):
    """Moments of driving, shape (n,): speed m/s, acceleration m/s^2, slope; seconds of each."""

    speed: np.ndarray
    acceleration: np.ndarray
    slope: np.ndarray
    seconds: np.ndarray


@cache
def reference_driving() -> Driving:
    """Driving that the network is orthogonal over: UDDS, HWFET and WLTC at three slopes."""
    rows = _bundled_numbers(REFERENCE)
    speed, acceleration, seconds = np.tile(rows, (len(GRADES), 1)).T
    return Driving(speed, acceleration, np.repeat(GRADES, len(rows)), seconds / len(GRADES))


def drawn_units(seed: int) -> np.ndarray:
    """Weights of speed and force, and bias, of each unit, shape (UNITS, 3)."""
    rng = np.random.default_rng(seed)
    return np.column_stack((rng.normal(size=(UNITS, 2)) * SPREAD, rng.normal(size=UNITS)))


def _bundled_numbers(name: str) -> np.ndarray:
    return np.array([line.split(",") for line in bundled_lines(name)[1:]], float)


class Network(NamedTuple):
    """A network whose inner weights are fixed.

    Attributes:
        inner: weights of speed and force, shape (UNITS, 2).
        bias: shape (UNITS,).
        outer: from units to learned weights, shape (UNITS, NETWORK).
        explained: share of the terms of eq. 21 in each learned weight, shape (4, NETWORK).
    """

    inner: np.ndarray
    bias: np.ndarray
    outer: np.ndarray
    explained: np.ndarray

    def force(self, speed: Any, force: Any) -> Any:
        """Force of each learned weight, N, shape (n, NETWORK), before `explained` is taken away.

        Speed, m/s, and force at the wheels over the mass, m/s^2, have shape (n,); numpy or torch.
        """
        xp = namespace(speed)
        inner, bias, outer = self.inner, self.bias, self.outer
        if xp is not np:
            inner, bias, outer = (like(weights, speed) for weights in (inner, bias, outer))
        of_speed = ((speed - SPEED_CENTRE) / SPEED_SCALE)[..., None] * inner[:, 0]
        of_force = (force / FORCE_SCALE)[..., None] * inner[:, 1]
        return xp.tanh(of_speed + of_force + bias) @ outer


def orthogonal_network(
    seed: int, driving: Driving, force: np.ndarray, terms: np.ndarray
) -> Network:
    """A network whose power has no part in the terms of eq. 21.

    Args:
        seed: of the inner weights.
        driving: over which this holds, n moments.
        force: at the wheels over the mass there, m/s^2, shape (n,).
        terms: of eq. 21 there, W per unit of their coefficient, shape (n, 4).
    """
    units = drawn_units(seed) if seed else _bundled_numbers(DRAWN)
    inner, bias = units[:, :2], units[:, 2]
    plain = Network(inner, bias, np.eye(UNITS), np.zeros((terms.shape[1], UNITS)))
    power = driving.speed[:, None] * plain.force(driving.speed, force)
    explained = share_of_terms(driving, terms, power)
    left = np.sqrt(driving.seconds)[:, None] * (power - terms @ explained)
    _, _, directions = np.linalg.svd(left, full_matrices=False)
    outer = directions[:NETWORK].T
    return Network(inner, bias, outer, explained @ outer)


def share_of_terms(driving: Driving, terms: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Coefficients of the terms that fit k powers, W, over driving, shape (4, k).

    Least squares over time; terms are scaled, because they differ by powers of ten.
    """
    root = np.sqrt(driving.seconds)[:, None]
    size = np.sqrt((driving.seconds @ terms**2) / driving.seconds.sum())
    coefficients = np.linalg.lstsq(root * terms / size, root * power, rcond=None)[0]
    return np.asarray(coefficients / size[:, None])
