"""Scales bands of energy by the errors of rehearsals (`estimation.rehearsal`).

The spread of the errors of predictions without the battery, in sigmas, scales the variance of a
real dropout or forecast, up or down, separately for dropouts and whole drives. Where no height is
known, the errors also show how hilly the roads of this car are: flat country has narrow bands.
Drives with known heights show it by how far above or below their start they ended (`Hills`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range

GROWTHS = np.array([0.0004, 0.004, 0.04])  # m^2 of unseen height per m: flat, hilly, mountains
HILLS_KEPT = 0.98  # share of their evidence that one rehearsal passes to the next
MOST_DEVIATE = 4.0  # sigmas; one odd road counts no more
MOST_DEVIATE_HILLS = 3.0  # the same, when hills are judged
# Prior cases of 1 sigma, the degrees of freedom of a Student's t of errors, because cars differ;
# its variance is `scale`. On seven cars 3 to 8 give the same CRPS of whole drives to 1 %.
DEGREES = 6.0
CASES_KEPT = 40.0  # newest cases that count
LEAST_HEIGHTS_METRES = 10e3  # m of known heights from which on `Hills` counts
HILLS_MEMORY_METRES = 300e3  # m of road over which earlier road is forgotten to 1/e
KEPT = 1.0 - 1.0 / CASES_KEPT  # share of the sums of `TrackRecord` kept from drive to drive
MOST_SUM = 1e15  # of squares and products over a car's life
MOST_COUNTED = 999  # drives; the sum of `KEPT` determines no larger number


class PredictedEnergy(NamedTuple):
    """Energy of a journey.

    Attributes:
        mean: J.
        variance: without unseen hills, J^2.
        hills: variance of unseen hills over `Bands.growth`, J^2/m: the length of road without
            heights, times the square of weight over eta.
    """

    mean: float
    variance: float
    hills: float

    def with_hills(self, growth: Any) -> Any:
        """Variance with unseen hills, J^2; growth: variance of height per length of road, m."""
        return self.variance + growth * self.hills


class Spread(NamedTuple):
    """Errors in sigmas: number of cases, and sum of squares."""

    cases: Annotated[float, Range(0.0, CASES_KEPT)] = 0.0
    squares: Annotated[float, Range(0.0, MOST_SUM)] = 0.0

    @property
    def scale(self) -> float:
        """Factor of the variance, above or below 1."""
        return (DEGREES + self.squares) / (DEGREES - 2.0 + self.cases)

    @property
    def seen(self) -> float:
        """Factor as `scale`, 1 before any case."""
        return (DEGREES - 2.0 + self.squares) / (DEGREES - 2.0 + self.cases)

    def after(self, deviate: float) -> Spread:
        """The spread with one more error, in sigmas."""
        keep = min(1.0, (CASES_KEPT - 1.0) / max(self.cases, 1.0))
        square = min(abs(deviate), MOST_DEVIATE) ** 2
        return Spread(keep * self.cases + 1.0, keep * self.squares + square)


class TrackRecord(NamedTuple):
    """Errors of whole drives that were predicted at their start: sums over the drives so far.

    Attributes:
        drives: predicted, of which the newest `CASES_KEPT` count most.
        measured: absolute energy, J.
        learned: absolute errors of the car as learned before each drive, J.
        file: absolute errors of the vehicle file alone, J.
    """

    drives: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    measured: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    learned: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    file: Annotated[float, Range(0.0, MOST_SUM)] = 0.0

    def after(self, drawn: float, learned: float, file: float) -> TrackRecord:
        """The record after one more drive: measured energy and both predictions, J."""
        more = 1.0, abs(drawn), abs(learned - drawn), abs(file - drawn)
        return TrackRecord(*(KEPT * sum_ + add for sum_, add in zip(self, more, strict=True)))

    @property
    def sentence(self) -> str | None:
        """Sentence on how well this car's drives were predicted; None before any."""
        if not self.measured:
            return None
        learned, file = (100.0 * error / self.measured for error in (self.learned, self.file))
        forgotten = max(1.0 - self.drives / CASES_KEPT, KEPT**MOST_COUNTED)
        drives = math.log(forgotten) / math.log(KEPT)  # number of drives whose sum is `drives`
        text = f"the energy of {drives:.0f} drive{'s' * (drives > 1.5)} was off by {learned:.0f} %"
        return (
            f"Forecast from the drives before, {text}; "
            f"forecast from the vehicle file alone, by {file:.0f} %."
        )


@dataclass(frozen=True, slots=True)
class Bands:
    """Outcome of the rehearsals.

    Attributes:
        dropout: spread of errors of dropouts within a drive.
        drive: spread of errors of whole drives.
        hills: logarithm of the odds of `GROWTHS`.
        record: errors of whole drives.
    """

    dropout: Spread = field(default_factory=Spread)
    drive: Spread = field(default_factory=Spread)
    hills: tuple[Annotated[float, Range(-1e6, 0.0)], ...] = (0.0,) * len(GROWTHS)
    record: TrackRecord = field(default_factory=TrackRecord)

    def __post_init__(self) -> None:
        """Refuse odds that are not of `GROWTHS`."""
        if len(self.hills) != len(GROWTHS):
            raise ValueError("bands: hills are missing")

    @property
    def growth(self) -> float:
        """Variance of unseen height per length of road, m."""
        odds = np.exp(np.array(self.hills) - max(self.hills))
        return float(odds @ GROWTHS / odds.sum())

    def after_drive(self, energy: PredictedEnergy, file: float, drawn: float) -> Bands:
        """The bands after a drive that drew `drawn`, J; file: predicted by the vehicle file, J."""
        sigma = math.sqrt(energy.with_hills(self.growth))
        return replace(
            self,
            drive=self.drive.after((drawn - energy.mean) / sigma),
            record=self.record.after(drawn, energy.mean, file),
        )

    def after_dropout(self, energy: PredictedEnergy, drawn: float, *, long: bool) -> Bands:
        """The bands after one more rehearsed dropout."""
        error = drawn - energy.mean
        bands = self
        if long:
            sigma = math.sqrt(energy.with_hills(self.growth))
            bands = replace(self, dropout=self.dropout.after(error / sigma))
        if energy.hills == 0.0:
            return bands
        variance = energy.with_hills(GROWTHS)
        square = np.minimum(error**2 / variance, MOST_DEVIATE_HILLS**2)
        odds = HILLS_KEPT * np.array(self.hills) - 0.5 * (square + np.log(variance))
        return replace(bands, hills=tuple((odds - odds.max()).tolist()))


@dataclass(frozen=True, slots=True)
class Hills:
    """Net climbs of drives, over their road with known heights.

    Attributes:
        squares: sum of squared net climbs of earlier drives, m^2.
        metres: sum of their lengths, m.
        way: length of this drive, m.
        climb: net climb of this drive, m.
    """

    squares: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    metres: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    way: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    climb: Annotated[float, Range(-1e5, 1e5)] = 0.0

    @property
    def growth(self) -> float:
        """Variance of height per length of road, m; 0 while unknown."""
        return self.squares / self.metres if self.metres >= LEAST_HEIGHTS_METRES else 0.0

    def plus(self, way: float, climb: float) -> Hills:
        """The value after more road with known heights, m, and its net climb, m."""
        return replace(self, way=self.way + way, climb=self.climb + climb)

    def next_drive(self) -> Hills:
        """The value at the start of another drive."""
        kept = math.exp(-self.way / HILLS_MEMORY_METRES)
        squares, metres = kept * self.squares + self.climb**2, kept * self.metres + self.way
        return Hills(min(squares, MOST_SUM), min(metres, MOST_SUM))
