"""Bounds of what a car can do, for what is counted and for totals that a file claims.

Whatever passes them may still be wrong; but one reading then adds at most what a car could have
done in the time that it stands for, and no sum leaves the range of numbers.
"""

from __future__ import annotations

import math

from evpinn_ros.signals.stream import MAX_SPEED

# More than any road vehicle is charged with, and so than any draws: CharIN's Megawatt Charging
# System ends at 1250 V and 3000 A; the strongest cars drive with 1.6 MW.
MAX_POWER = 4e6  # W
# Lifetimes. The farthest-driven car known, a Volvo P1800, has 5.2e9 m; a lorry takes 7 kJ/m.
MOST_DISTANCE = 1e10  # m
MOST_ENERGY = 1e14  # J
MOST_SECONDS = 1e15  # s; a stamp that leaps may claim decades of dropout, so hardly a bound
ROUNDING = 1.0 + 1e-6  # of sums


def speed_is_possible(speed: float) -> bool:
    """Whether a speed, m/s, may be counted as distance: the gate of the estimator's stream."""
    return abs(speed) <= MAX_SPEED


def power_is_possible(power: float, sigma: float) -> bool:
    """Whether a power and its 1-sigma, W, may be counted; a sigma may be NaN, unknown."""
    return abs(power) <= MAX_POWER and (math.isnan(sigma) or 0.0 <= sigma <= MAX_POWER)
