"""Scores of a predicted part of a drive.

Truth is the measured battery power, integrated over its own stamps; "gross" is the integral of its
size. Only stretches count in which speed and battery are known, the same for every method. A
method that predicts less than `LEAST_COVERED` of them has no score.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math

import numpy as np

from benchmarks.unseen.drives import UnseenDrive
from benchmarks.unseen.lines import DrivePart, Line, common
from benchmarks.unseen.method import Prediction

QUANTILE_90 = 1.6448536269514722  # sigmas to either side that hold 90 % of a normal deviate
LEAST_COVERED = 0.9  # share of the stretches
MOST_SIGMAS = 4.0  # limit of an error in the log score
MEANS = (1.0, 10.0, 60.0)  # s, over which power is averaged
AGES = (1.0, 10.0, 60.0, 600.0)  # s since the last battery sample
AGE_BAND = 2.0  # RMSE at an age: from half of it up to `AGE_BAND` times it, up to the end


class Track:
    """The predictions of a method for a part of a drive.

    Attributes:
        power: W.
        energy: running integral, J.
        sigma: 1-sigma, J, of the energy since the last battery reading.
    """

    def __init__(self, drive: UnseenDrive, rows: Sequence[Prediction]) -> None:
        columns = np.array([row[1:] for row in rows], dtype=float).reshape(-1, 4).T
        time = np.array([drive.seconds(row.stamp_ns) for row in rows], dtype=float)
        gap = max(drive.power.gap, drive.speed.gap)
        self.power = Line(time, columns[0], gap)
        self.energy = Line(time, columns[2], gap)
        self.sigma = Line(time, columns[3], gap)

    def energy_over(self, spans: Iterable[DrivePart]) -> float:
        """Predicted energy of spans, J: the method's own, else the integral of its power."""
        total = 0.0
        for span in spans:
            ends = np.clip(np.array(span), self.power.time[0], self.power.time[-1])
            own = self.energy.at(ends)
            counted = self.power.over(span) if np.isnan(own).any() else own[1] - own[0]
            left_out = span.length - float(ends[1] - ends[0])
            total += float(counted) + left_out * float(self.power.value[-1])
        return total

    def sigma_at(self, time: float) -> float:
        """1-sigma of energy at the last prediction up to a time, J; NaN without one."""
        index = int(np.searchsorted(self.sigma.time, time, side="right")) - 1
        return float(self.sigma.value[index]) if index >= 0 else math.nan


@dataclass(frozen=True)
class AgeScore:
    """Sums at one age of the last battery sample: of squares, samples, and energies, J."""

    squares: float
    samples: int
    energy_error: float
    gross: float


@dataclass(frozen=True)
class PartScore:
    """Scores of one part of a drive; energies in J, powers in W; NaN where there is none."""

    covered: float  # share of what is scored that was predicted
    net: float  # measured energy
    gross: float  # measured, drawn and regenerated together
    error: float  # predicted less measured energy
    sigma: float  # 1-sigma that the method gives its energy
    squares: tuple[float, int]  # sum of squared errors at the stamps of speed, and their number
    means: dict[float, tuple[float, int]]  # the same for means over each of `MEANS` s
    ages: dict[float, AgeScore]  # by each of `AGES` that the part reaches
    absolute: float  # integral of the size of the error of power

    @property
    def valid(self) -> bool:
        """Whether there is anything to score, and the method predicted it."""
        return self.covered >= LEAST_COVERED and self.gross > 0

    @property
    def rmse(self) -> float:
        """RMSE of power at the stamps of speed, W."""
        return math.sqrt(self.squares[0] / self.squares[1]) if self.squares[1] else math.nan

    @property
    def inside_90(self) -> bool:
        """True if the 90 % interval of energy holds the measured one."""
        return abs(self.error) <= QUANTILE_90 * self.sigma

    @property
    def crps(self) -> float:
        """Continuous ranked probability score of the energy, J."""
        return crps(self.error, self.sigma)

    @property
    def log_score(self) -> float:
        """Logarithm of the density predicted for the measured share of gross energy.

        The error is cut off at `MOST_SIGMAS`, so that one drive does not decide.
        """
        away = min(abs(self.error) / max(self.sigma, 1e-9), MOST_SIGMAS)
        return -(away**2) / 2 - math.log(max(self.sigma, 1e-9) / self.gross)


def crps(error: float, sigma: float) -> float:
    """Continuous ranked probability score of a normal prediction, in the unit of the error.

    Gneiting and Raftery (2007), eq. 21; the absolute error if sigma is 0.
    """
    if sigma == 0:
        return abs(error)
    away = error / sigma
    density = math.exp(-(away**2) / 2) / math.sqrt(2 * math.pi)
    spread = away * math.erf(away / math.sqrt(2)) + 2 * density - 1 / math.sqrt(math.pi)
    return sigma * spread


def score_part(drive: UnseenDrive, track: Track, span: DrivePart) -> PartScore:
    """Score the predictions of a part of a drive."""
    spans = common(drive.spans, [span])
    seconds = sum(part.length for part in spans)
    answered = sum(part.length for part in common(spans, track.power.spans()))
    covered = answered / seconds if seconds else 0.0
    net = sum(drive.power.over(part) for part in spans)
    gross = sum(drive.power.gross(part) for part in spans)
    if covered < LEAST_COVERED:
        return PartScore(covered, net, gross, math.nan, math.nan, (0.0, 0), {}, {}, math.nan)
    time = _sample_times(drive, spans)
    error = track.power.at(time) - drive.power.at(time)
    known = np.isfinite(error)
    time, error = time[known], error[known]
    return PartScore(
        covered,
        net,
        gross,
        track.energy_over(spans) - net,
        track.sigma_at(span.end),
        (float(np.sum(error**2)), error.size),
        {length: _means(drive, track, spans, length) for length in MEANS},
        _ages(drive, track, span, time - span.begin, error),
        _absolute(time, error),
    )


def _sample_times(drive: UnseenDrive, spans: Sequence[DrivePart]) -> np.ndarray:
    """Stamps of speed in the spans, at most ten a second."""
    time = drive.speed.time
    kept = time[np.concatenate(([True], np.diff(np.floor(time / 0.0999)) > 0))]
    inside = np.zeros(kept.size, dtype=bool)
    for span in spans:
        inside |= (kept >= span.begin) & (kept <= span.end)
    return kept[inside]


def _means(
    drive: UnseenDrive, track: Track, spans: Sequence[DrivePart], length: float
) -> tuple[float, int]:
    """Sum of squared errors of mean power over pieces of a length, W^2, and their number."""
    period = float(np.median(np.diff(drive.speed.time)))
    squares, count = 0.0, 0
    if length < period:
        return squares, count
    for span in spans:
        edges = np.arange(span.begin, span.end + 1e-9, length)
        if edges.size > 1:
            error = np.diff(track.power.integral(edges) - drive.power.integral(edges)) / length
            squares, count = squares + float(np.sum(error**2)), count + error.size
    return squares, count


def _ages(
    drive: UnseenDrive, track: Track, span: DrivePart, age: np.ndarray, error: np.ndarray
) -> dict[float, AgeScore]:
    """Errors around each age, and of the energy up to it."""
    by_age = {}
    for age_s in AGES:
        upto = DrivePart(span.begin, span.begin + age_s)
        known = common(drive.spans, [upto])
        if upto.end > span.end + 1e-6 or not known:
            continue
        near = error[(age >= age_s / AGE_BAND) & (age < AGE_BAND * age_s)]
        energy = track.energy_over(known) - sum(drive.power.over(part) for part in known)
        gross = sum(drive.power.gross(part) for part in known)
        by_age[age_s] = AgeScore(float(np.sum(near**2)), near.size, abs(energy), gross)
    return by_age


def _absolute(time: np.ndarray, error: np.ndarray) -> float:
    steps = np.diff(time)
    size = np.abs(error)
    return float(np.sum(steps * (size[1:] + size[:-1]) / 2)) if time.size > 1 else 0.0
