"""A grade of the wrong sign, found from what hills cost."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from evpinn_ros.signals.interval import Interval

GRADE_SIGN = "grade_sign"
LENGTH = 100.0  # m over which a reported grade, and gusts, are alike
MEMORY = 20e3  # m of road that the verdict rests on
ENOUGH = 2e3  # m before there is a verdict
FAST = 5.0  # m/s: slower, auxiliaries outweigh hills
SUSPECT_SIGMAS, CLEAR_SIGMAS = -3.0, 0.0  # of the climb that energy shows over the one reported


class GradeSuspicion:
    """Detector of a reported grade of the wrong sign: to climb costs energy.

    Regressed is the climb that the battery's energy shows on the one that is reported, over the
    road: 1 as it should be, -1 with the sign flipped, 0 for a report that has nothing to do with
    the road. Each `LENGTH` counts as one observation.
    """

    def __init__(self) -> None:
        """Start without data."""
        self.suspected = False
        self._sums = np.zeros(6)  # of 1, x, y, x^2, x y and y^2 along the road, m

    def learn(self, interval: Interval, residual: float, weight_over_eta: float) -> None:
        """Learn from an interval.

        Args:
            interval: with a measured height.
            residual: energy measured less predicted, J.
            weight_over_eta: m g / eta, N.
        """
        road = abs(interval.distance)
        if not interval.height_known or road < FAST * interval.duration:
            return
        x = float(interval.steps.climb.sum()) / road
        y = x + residual / weight_over_eta / road
        sums = np.array([1.0, x, y, x * x, x * y, y * y])
        self._sums = math.exp(-road / MEMORY) * self._sums + road * sums
        sigmas = self._sigmas()
        limit = CLEAR_SIGMAS if self.suspected else SUSPECT_SIGMAS
        self.suspected = sigmas is not None and sigmas < limit

    def export(self) -> dict[str, Any]:
        """State to save."""
        return {"suspected": self.suspected, "sums": self._sums.tolist()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a saved state; KeyError, TypeError or ValueError when it does not fit."""
        sums = np.array(state["sums"], dtype=float)
        if sums.shape != self._sums.shape or not np.isfinite(sums).all():
            raise ValueError("the saved sums of the grade detector do not fit")
        self.suspected, self._sums = bool(state["suspected"]), sums

    def _sigmas(self) -> float | None:
        """The regression's coefficient over its 1-sigma, None while there is no telling."""
        road, *sums = self._sums
        if road < ENOUGH:
            return None
        x, y, xx, xy, yy = (each / road for each in sums)
        spread, both, size = xx - x * x, xy - x * y, yy - y * y
        rest = size * spread - both**2  # of the variance of y, times that of x
        if spread <= 0.0 or rest <= 0.0:
            return None
        return float(both * math.sqrt(road / LENGTH / rest))
