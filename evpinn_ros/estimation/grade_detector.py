"""A grade of the wrong sign, found from what hills cost."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.estimation.calibration import MOST_SUM
from evpinn_ros.signals.interval import Interval

GRADE_SIGN = "grade_sign"
LENGTH = 100.0  # m over which a reported grade, and gusts, are alike
MEMORY = 20e3  # m of road that the verdict rests on
ENOUGH = 2e3  # m before there is a verdict
FAST = 5.0  # m/s: slower, auxiliaries outweigh hills
SUSPECT_SIGMAS, CLEAR_SIGMAS = -3.0, 0.0  # of the climb that energy shows over the one reported


@dataclass(frozen=True, slots=True)
class GradeDetector:
    """Detector of a reported grade of the wrong sign: to climb costs energy.

    Regressed is the climb that the battery's energy shows on the one that is reported, over the
    road: 1 as it should be, -1 with the sign flipped, 0 for a report that has nothing to do with
    the road. Each `LENGTH` counts as one observation.

    Attributes:
        detected: the verdict.
        sums: of 1, x, y, x^2, x y and y^2 along the road, m.
    """

    detected: bool = False
    sums: tuple[Annotated[float, Range(-MOST_SUM, MOST_SUM)], ...] = (0.0,) * 6

    def __post_init__(self) -> None:
        """Refuse sums that are not these six."""
        if len(self.sums) != 6:
            raise ValueError("grade: sums are missing")

    def after(self, interval: Interval, residual: float, weight_over_eta: float) -> GradeDetector:
        """The detector after one more interval.

        Args:
            interval: learned from; one without a measured height says nothing.
            residual: energy measured less predicted, J.
            weight_over_eta: m g / eta, N.
        """
        road = abs(interval.distance)
        if not interval.height_known or road < FAST * interval.duration:
            return self
        x = float(interval.steps.climb.sum()) / road
        y = x + residual / weight_over_eta / road
        new = np.array([1.0, x, y, x * x, x * y, y * y])
        sums = math.exp(-road / MEMORY) * np.array(self.sums) + road * new
        sigmas = _sigmas(*sums.tolist())
        limit = CLEAR_SIGMAS if self.detected else SUSPECT_SIGMAS
        return GradeDetector(sigmas is not None and sigmas < limit, tuple(sums.tolist()))


def _sigmas(
    road: float, x: float, y: float, xx: float, xy: float, yy: float
) -> float | None:  # fmt: skip
    """The regression's coefficient over its 1-sigma, None while there is no telling."""
    if road < ENOUGH:
        return None
    x, y, xx, xy, yy = (each / road for each in (x, y, xx, xy, yy))
    spread, both, size = xx - x * x, xy - x * y, yy - y * y
    rest = size * spread - both**2  # of the variance of y, times that of x
    if spread <= 0.0 or rest <= 0.0:
        return None
    return float(both * math.sqrt(road / LENGTH / rest))
