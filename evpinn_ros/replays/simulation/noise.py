"""Smooth random change, of traffic, wind and the like."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline


def slow_noise(time: np.ndarray, memory: float, rng: np.random.Generator) -> np.ndarray:
    """A smooth random function of about zero mean and unit variance at rising times, s.

    Independent normal values every `memory` seconds, joined by a cubic spline.

    Returns:
        Shape (n,).
    """
    knots = np.arange(0.0, time[-1] + 4 * memory, memory)
    return np.asarray(CubicSpline(knots, rng.standard_normal(knots.size))(time))
