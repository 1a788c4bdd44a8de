"""Scales sigma so that bands of 90 % hold 90 % of the measured values.

The sigma of a model is only as true as the model. So the ratio of error to sigma below which 90 %
of the samples lie is followed online (Gibbs and Candes, 2021, adaptive conformal inference,
on a logarithmic scale), and sigma is scaled so that +-1.645 sigma covers 90 %.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable

COVERAGE = 0.9
GAUSSIAN_QUANTILE = 1.6449  # of |z| at COVERAGE
RATE = 0.02  # of the logarithm: 0.9 of it up after a miss, 0.1 of it down otherwise
RATIO_RANGE = (0.05, 20.0)
RECENT = 600  # samples over which coverage is reported, a minute at 10 Hz
MOST_WAITING = 2000  # predictions


class SavedBand(NamedTuple):
    """Ratios of error to sigma below which 90 % lie, of a moving and of a standing car."""

    moving: Annotated[float, Range(*RATIO_RANGE)]
    standing: Annotated[float, Range(*RATIO_RANGE)]


@dataclass(frozen=True, slots=True)
class SavedBands:
    """Bands of predicted and of smoothed power."""

    predicted: SavedBand
    smoothed: SavedBand


class Waiting(NamedTuple):
    """Predictions that await a battery reading: stamps, power and 1-sigma, W, and if moving."""

    stamp_ns: np.ndarray
    power: np.ndarray
    sigma: np.ndarray
    moving: np.ndarray

    def and_then(self, later: Waiting) -> Waiting:
        """These predictions and `later` ones, concatenated."""
        return Waiting(*map(np.concatenate, zip(self, later, strict=True)))

    def after(self, index: np.ndarray) -> Waiting:
        """At most `MOST_WAITING` predictions after the measured ones, at increasing indices."""
        first = max(len(self.power) - MOST_WAITING, *(index[-1:] + 1), 0)
        return Waiting(*(column[first:] for column in self))


NO_PREDICTIONS = Waiting(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0, dtype=bool))


class Checked(NamedTuple):
    """A prediction whose power was measured.

    Attributes:
        place: number of predictions that come before this is known.
        moving: whether the car moves.
        error: measured less predicted power, W.
        sigma: 1-sigma of the model, not calibrated, W.
    """

    place: int
    moving: bool
    error: float
    sigma: float


class BandCalibration(Saveable[SavedBand]):
    """Scale of sigma, separate for a moving and a standing car, whose errors differ in kind."""

    def __init__(self) -> None:
        self._ratio = {True: GAUSSIAN_QUANTILE, False: GAUSSIAN_QUANTILE}
        self._inside: deque[bool] = deque(maxlen=RECENT)

    @property
    def coverage(self) -> float:
        """Share of the recent samples inside the 90 % band, NaN before the first."""
        return sum(self._inside) / len(self._inside) if self._inside else math.nan

    def scale(self, *, moving: bool) -> float:
        """Calibrated 1-sigma over that of the model, now."""
        return self._ratio[moving] / GAUSSIAN_QUANTILE

    def calibrated(
        self, moving: np.ndarray, sigma: np.ndarray, learned: Sequence[Checked]
    ) -> np.ndarray:
        """Calibrated 1-sigma of n predictions, W, each by what was learned before it.

        Args:
            moving: whether the car moves, shape (n,).
            sigma: 1-sigma of the model, W, shape (n,).
            learned: predictions that are measured meanwhile, in order.
        """
        ratios = np.empty(len(sigma))
        begin = 0
        for checked in (*learned, None):
            end = len(sigma) if checked is None else checked.place
            if end > begin:
                ratios[begin:end] = np.where(
                    moving[begin:end], self._ratio[True], self._ratio[False]
                )
                begin = end
            if checked is not None:
                self._learn(checked)
        return np.asarray(sigma * ratios / GAUSSIAN_QUANTILE)

    def _learn(self, checked: Checked) -> None:
        ratio = self._ratio[checked.moving]
        missed = abs(checked.error) > ratio * checked.sigma
        self._inside.append(not missed)
        step = RATE * (float(missed) - (1.0 - COVERAGE))
        bounded = min(max(ratio * math.exp(step), RATIO_RANGE[0]), RATIO_RANGE[1])
        self._ratio[checked.moving] = bounded

    def saved(self) -> SavedBand:
        """The learned ratios."""
        return SavedBand(self._ratio[True], self._ratio[False])

    def take(self, saved: SavedBand) -> None:
        """Go on from a saved band."""
        self._ratio = {True: saved.moving, False: saved.standing}
