"""Energy as the integral of sampled power: the trapezoid rule.

dE/dt = P does not depend on E, so the classical Runge-Kutta step of the paper is a quadrature
rule; between samples nothing but the samples is known, and the trapezoid is exact for power that
is linear in between. What cannot be integrated is counted, never guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
import math
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.energy.plausible import ROUNDING
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.track import GAP_STEPS, RATE_READINGS, Cadence

MAX_GAP = 2.0  # s
MOST_COUNTED = 1e15  # of any saved value: sums of two stay numbers
Amount: TypeAlias = Annotated[float, Range(0.0, MOST_COUNTED)]
Count: TypeAlias = Annotated[int, Range(0, MOST_COUNTED)]


def trapezoid(values: np.ndarray, at: np.ndarray) -> float:
    """The integral of samples, both of shape (n,); numpy calls it by another name before 2.0."""
    return float((np.diff(at) * (values[1:] + values[:-1]) / 2.0).sum())


def joined(steps: np.ndarray, max_gap: float, before: Sequence[float] = ()) -> np.ndarray:
    """Mask of the steps, s, shape (n,), that are integrated, by the rule of `Cadence`.

    Args:
        steps: positive, in order.
        max_gap: longest step that is integrated, s; of slow samples some of their own steps.
        before: steps that went before.
    """
    mask: np.ndarray = steps <= max_gap
    for index in np.flatnonzero(~mask).tolist():
        recent = [*before, *steps[max(0, index - RATE_READINGS) : index].tolist()]
        recent = sorted(recent[-RATE_READINGS:])
        mask[index] = bool(recent) and steps[index] <= GAP_STEPS * recent[len(recent) // 2]
    return mask


class Step(NamedTuple):
    """Two neighbouring samples of power and the time between them.

    Attributes:
        dt: s, positive.
        power: at the start, W.
        power_next: at the end, W.
    """

    dt: float
    power: float
    power_next: float

    @property
    def energy(self) -> float:
        """Integral of the linearly interpolated power, J."""
        return (self.power + self.power_next) / 2 * self.dt

    @property
    def parts(self) -> tuple[float, float]:
        """Drawn and regenerated energy, J, both >= 0; exact where the power changes sign."""
        if self.power * self.power_next >= 0:
            return max(self.energy, 0.0), max(-self.energy, 0.0)
        high, low = max(self.power, self.power_next), min(self.power, self.power_next)
        triangle = self.dt / (2 * (high - low))
        return high * high * triangle, low * low * triangle


@dataclass(frozen=True, slots=True)
class SavedIntegral:
    """Totals and counters of an `EnergyIntegral`.

    The last sample is not among them, so that one restored the next morning does not count the
    night as a gap.
    """

    drawn: Amount = 0.0
    regenerated: Amount = 0.0
    covered_s: Amount = 0.0
    gaps: Count = 0
    gap_s: Amount = 0.0
    out_of_order: Count = 0
    not_finite: Count = 0

    def refuse_above(self, most: float) -> None:
        """ValueError when it is more than a power of `most`, W, all the time would have made."""
        if self.drawn + self.regenerated > most * self.covered_s * ROUNDING:
            raise ValueError(f"more than {most:g} all the time was integrated")


FIELDS, NOTHING = fields(SavedIntegral), SavedIntegral()


class EnergyIntegral:
    """Integrates power sample by sample.

    A step longer than `longest_step` is not integrated: it counts as a gap. A sample that is not
    newer than the last one, or not finite, is dropped and counted.

    Attributes:
        drawn: integral of the power where it is positive, J.
        regenerated: integral of the power where it is negative, as positive J.
        covered_s: time that was integrated, s.
        gaps: steps longer than `longest_step`.
        gap_s: their duration, s.
        out_of_order: samples dropped because of their stamp.
        not_finite: samples dropped because their power is NaN or infinite.
    """

    def __init__(self, max_gap: float = MAX_GAP, saved: SavedIntegral = NOTHING) -> None:
        """An integral of zero, or one that goes on from what was saved.

        Args:
            max_gap: longest step that is integrated, s; of slow samples some of their own steps
                (`signals.track.Cadence`).
            saved: totals and counters before the first sample.
        """
        self._cadence = Cadence(max_gap)
        self._last: tuple[int, float] | None = None
        self.drawn, self.regenerated = saved.drawn, saved.regenerated
        self.covered_s = saved.covered_s
        self.gaps, self.gap_s = saved.gaps, saved.gap_s
        self.out_of_order, self.not_finite = saved.out_of_order, saved.not_finite

    @property
    def longest_step(self) -> float:
        """Longest step that is integrated, s."""
        return self._cadence.gap_ns / NANOSECONDS

    @property
    def energy(self) -> float:
        """Net energy, J: drawn minus regenerated."""
        return self.drawn - self.regenerated

    @property
    def dropped(self) -> int:
        """Samples that were not used."""
        return self.out_of_order + self.not_finite

    @property
    def last_stamp_ns(self) -> int | None:
        """Stamp of the last sample used, ns."""
        return self._last[0] if self._last else None

    @property
    def last_power(self) -> float:
        """Power of the last sample used, W, NaN before the first."""
        return self._last[1] if self._last else math.nan

    def append(self, stamp_ns: int, power: float) -> Step | None:
        """Take one sample of power, W; returns the step it completed, None without one."""
        if not math.isfinite(power):
            self.not_finite += 1
            return None
        last = self._last
        since = math.inf if last is None else (stamp_ns - last[0]) / NANOSECONDS
        if since <= 0:
            self.out_of_order += 1
            return None
        self._last = (stamp_ns, power)
        if last is None:
            return None
        longest = self.longest_step
        self._cadence.add_step(since)
        if since > longest:
            self.gaps += 1
            self.gap_s += since
            return None
        step = Step(since, last[1], power)
        drawn, regenerated = step.parts
        self.drawn += drawn
        self.regenerated += regenerated
        self.covered_s += since
        return step

    def saved(self) -> SavedIntegral:
        """Totals and counters."""
        return SavedIntegral(**{each.name: getattr(self, each.name) for each in FIELDS})
