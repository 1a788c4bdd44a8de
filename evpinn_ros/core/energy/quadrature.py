"""Energy as the integral of sampled power: the trapezoid rule.

dE/dt = P does not depend on E, so the classical Runge-Kutta step of the paper is a quadrature
rule; between samples nothing but the samples is known, and the trapezoid is exact for power that
is linear in between. Gaps are counted, never filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.energy.plausible import ROUNDING
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.track import GAP_STEPS, RATE_READINGS

MAX_GAP = 2.0  # s
NONE = np.empty(0)
NO_STAMP = np.iinfo(np.int64).min
MOST_COUNTED = 1e15  # of any saved value, so that sums stay finite
Amount: TypeAlias = Annotated[float, Range(0.0, MOST_COUNTED)]
Count: TypeAlias = Annotated[int, Range(0, MOST_COUNTED)]


def trapezoid(values: np.ndarray, at: np.ndarray) -> float:
    """The integral of samples, both of shape (n,); NumPy renamed its own in 2.0."""
    return float((np.diff(at) * (values[1:] + values[:-1]) / 2.0).sum())


def joined(steps: np.ndarray, max_gap: float, before: np.ndarray = NONE) -> np.ndarray:
    """Mask of the steps, s, shape (n,), that are integrated, by the rule of `SignalTrack`.

    Args:
        steps: positive, in order.
        max_gap: longest step that is integrated, s; or `GAP_STEPS` usual steps of slow samples.
        before: earlier steps.
    """
    mask: np.ndarray = steps <= max_gap
    if mask.all():
        return mask
    series = np.concatenate((before, steps))
    for index in np.flatnonzero(~mask).tolist():
        last = len(before) + index
        recent = np.sort(series[max(0, last - RATE_READINGS) : last])
        mask[index] = len(recent) and steps[index] <= GAP_STEPS * recent[len(recent) // 2]
    return mask


def counted(flags: np.ndarray) -> np.ndarray:
    """Number of true flags before each of n and after the last, shape (n + 1,)."""
    counts = np.zeros(len(flags) + 1, np.int64)
    flags.cumsum(out=counts[1:])
    return counts


def split(steps: np.ndarray, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drawn and regenerated energy of steps, J, both >= 0; exact where the power changes sign.

    Args:
        steps: s, positive, shape (n,) as all.
        begin: power at the begin of each, W.
        end: power at the end of each, W.
    """
    whole = (begin + end) / 2 * steps
    high, low = np.maximum(begin, end), np.minimum(begin, end)
    crossing = (high > 0.0) & (low < 0.0)
    triangle = steps / (2 * np.where(crossing, high - low, 1.0))
    return (
        np.where(crossing, high * high * triangle, np.maximum(whole, 0.0)),
        np.where(crossing, low * low * triangle, np.maximum(-whole, 0.0)),
    )


@dataclass(frozen=True, slots=True)
class SavedIntegral:
    """Totals and counters of an `EnergyIntegral`.

    The last sample is not saved, so that an integral restored the next morning does not count
    the night as a gap.
    """

    drawn: Amount = 0.0
    regenerated: Amount = 0.0
    covered_s: Amount = 0.0
    gaps: Count = 0
    gap_s: Amount = 0.0
    out_of_order: Count = 0
    not_finite: Count = 0

    def refuse_above(self, most: float) -> None:
        """Raise a ValueError if it exceeds a constant power of `most`, W."""
        if self.drawn + self.regenerated > most * self.covered_s * ROUNDING:
            raise ValueError(f"more than {most:g} all the time was integrated")


NOTHING = SavedIntegral()


class IntegralCourse(NamedTuple):
    """Course of an integral along a block of n samples, of which it uses m.

    Attributes:
        used: number of used samples after 0 to n samples, shape (n + 1,).
        places: indices of the used samples in the block, shape (m,).
        stamps: of the used samples, ns, shape (m,).
        steps: s from the used sample before to each, 0 at the very first, shape (m,).
        joined: whether that step was integrated, shape (m,).
        begin: value at the begin of the step, shape (m,).
        end: value at its end, shape (m,).
        drawn: integral of positive values after 0 to m used samples, shape (m + 1,).
        regenerated: integral of negative values, as a positive number, shape (m + 1,).
        covered_s: time that was integrated, s, shape (m + 1,).
        gaps: number of steps too long to integrate, shape (m + 1,).
        recent: steps before the block, and those in it.
    """

    used: np.ndarray
    places: np.ndarray
    stamps: np.ndarray
    steps: np.ndarray
    joined: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    drawn: np.ndarray
    regenerated: np.ndarray
    covered_s: np.ndarray
    gaps: np.ndarray
    recent: np.ndarray

    def longest(self, used: int) -> float:
        """`GAP_STEPS` usual steps after a number of used samples, s."""
        last = len(self.recent) - len(self.steps) + used
        recent = np.sort(self.recent[max(0, last - RATE_READINGS) : last])
        return GAP_STEPS * float(recent[len(recent) // 2]) if len(recent) else 0.0


class EnergyIntegral:
    """Integrates power over blocks of samples.

    A step longer than `max_gap` and `GAP_STEPS` usual steps is not integrated: it counts as a gap.
    A sample that is not newer than the last one, or not finite, is dropped and counted. How
    samples are cut into blocks changes nothing.

    Attributes:
        total: totals and counters so far.
    """

    def __init__(self, max_gap: float = MAX_GAP, saved: SavedIntegral = NOTHING) -> None:
        """Start from zero or from a saved integral.

        Args:
            max_gap: longest step that is integrated, s (see `joined`).
            saved: totals and counters before the first sample.
        """
        self._max_gap, self.total = max_gap, saved
        self._last_ns, self._last = np.array([NO_STAMP]), np.zeros(1)
        self._recent = np.empty(0)

    @property
    def dropped(self) -> int:
        """Samples that were not used."""
        return self.total.out_of_order + self.total.not_finite

    def extend(self, stamps: np.ndarray, values: np.ndarray) -> IntegralCourse:
        """Add samples in order of arrival: stamps, ns, and values, W, shape (n,) each."""
        finite = np.isfinite(values)
        newest = np.maximum.accumulate(
            np.concatenate((self._last_ns, np.where(finite, stamps, NO_STAMP)))
        )
        taken = finite & (stamps > newest[:-1])
        at, end = stamps[taken], values[taken]
        is_first = bool(self._last_ns[0] == NO_STAMP)
        before_ns, before = (at, end) if is_first else (self._last_ns, self._last)
        steps = np.diff(at, prepend=before_ns[:1]) / NANOSECONDS
        begin = np.concatenate((before[:1], end[:-1]))[: len(at)]
        real = slice(int(is_first), None)  # the very first sample ends no step
        mask, gap = np.zeros((2, len(at)), dtype=bool)
        mask[real] = joined(steps[real], self._max_gap, self._recent)
        gap[real] = ~mask[real]
        total = self.total
        before_all = total.drawn, total.regenerated, total.covered_s, total.gaps, total.gap_s
        added = *split(steps, begin, end) * mask, steps * mask, gap, steps * gap
        drawn, regenerated, covered_s, gaps, gap_s = np.column_stack((before_all, added)).cumsum(1)
        course = IntegralCourse(
            counted(taken),
            taken.nonzero()[0],
            at,
            steps,
            mask,
            begin,
            end,
            drawn,
            regenerated,
            covered_s,
            gaps,
            np.concatenate((self._recent, steps[real])),
        )
        self._recent = course.recent[-RATE_READINGS:]
        if len(at):
            self._last_ns, self._last = at[-1:], end[-1:]
        finite_count = int(np.count_nonzero(finite))
        self.total = SavedIntegral(
            float(drawn[-1]),
            float(regenerated[-1]),
            float(covered_s[-1]),
            int(gaps[-1]),
            float(gap_s[-1]),
            total.out_of_order + finite_count - len(at),
            total.not_finite + len(values) - finite_count,
        )
        return course
