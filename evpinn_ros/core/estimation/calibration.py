"""Bands that cover what they claim: sigma is scaled by how errors really spread.

The sigma of a model is only as true as the model. Here the ratio of error to sigma that 90 % of
the samples stay under is followed online (Gibbs and Candes, 2021, adaptive conformal inference,
on a logarithmic scale), and sigma is scaled so that +-1.645 sigma covers 90 %.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

COVERAGE = 0.9
GAUSSIAN_QUANTILE = 1.6449  # of |z| at COVERAGE
RATE = 0.02  # of the logarithm: up by 0.9 of it after a miss, down by 0.1 of it otherwise
RATIO_RANGE = (0.05, 20.0)
RECENT = 600  # samples over which coverage is reported, a minute at 10 Hz
MOST_SUM = 1e15  # of squares and products over a car's life


class SavedBand(NamedTuple):
    """Ratios of error to sigma that 90 % stay under, of a moving and of a standing car."""

    moving: Annotated[float, Range(*RATIO_RANGE)]
    standing: Annotated[float, Range(*RATIO_RANGE)]


@dataclass(frozen=True, slots=True)
class SavedBands:
    """Those of predicted and of smoothed power."""

    predicted: SavedBand
    smoothed: SavedBand


class BandCalibration(Saveable[SavedBand]):
    """Scale of sigma, apart for a moving and a standing car, whose errors differ in kind."""

    def __init__(self) -> None:
        self._ratio = {True: GAUSSIAN_QUANTILE, False: GAUSSIAN_QUANTILE}
        self._inside: deque[bool] = deque(maxlen=RECENT)

    @property
    def coverage(self) -> float:
        """Share of the recent samples inside the 90 % band, NaN before the first."""
        return sum(self._inside) / len(self._inside) if self._inside else math.nan

    def sigma(self, sample: Sample, model_sigma: float) -> float:
        """Calibrated 1-sigma, W, from the model's."""
        return model_sigma * self._ratio[_moving(sample)] / GAUSSIAN_QUANTILE

    def learn(self, sample: Sample, error: float, model_sigma: float) -> None:
        """Learn from the error, W, of a prediction whose uncalibrated sigma, W, is given."""
        moving = _moving(sample)
        ratio = self._ratio[moving]
        missed = abs(error) > ratio * model_sigma
        self._inside.append(not missed)
        step = RATE * (float(missed) - (1.0 - COVERAGE))
        self._ratio[moving] = min(max(ratio * math.exp(step), RATIO_RANGE[0]), RATIO_RANGE[1])

    def saved(self) -> SavedBand:
        """State to save."""
        return SavedBand(self._ratio[True], self._ratio[False])

    def take(self, saved: SavedBand) -> None:
        """Go on from a saved band."""
        self._ratio = {True: saved.moving, False: saved.standing}


def _moving(sample: Sample) -> bool:
    return abs(sample.speed) > STANDSTILL_SPEED
