"""The latest readings of one quantity in order of stamps, and the rate at which they come."""

from __future__ import annotations

from typing import Any

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS

TRACK_NS = 90 * NANOSECONDS  # of readings kept at least
FEW = 5  # readings for which sorting lists is faster than arrays
RATE_READINGS = 15  # steps whose median is the rate of a signal
GAP_STEPS = 6.0  # median steps across which readings are still joined
LATER = 2**62  # ns, a moment that never comes
NEVER = -LATER  # ns, before every reading


def medians(steps: np.ndarray, new: int) -> np.ndarray:
    """Median of the latest `RATE_READINGS` steps up to each of the last `new`, shape (new,).

    Of an even number of steps the larger of the two in the middle.
    """
    if new <= FEW:
        latest, begins = steps.tolist(), range(len(steps) - new + 1 - RATE_READINGS, len(steps))
        some = [sorted(latest[max(a, 0) : a + RATE_READINGS]) for a in begins[:new]]
        return np.array([window[len(window) // 2] for window in some])
    count = np.minimum(np.arange(len(steps) - new, len(steps)) + 1, RATE_READINGS)
    padded = np.concatenate((np.full(RATE_READINGS, np.inf), steps))
    windows = np.lib.stride_tricks.sliding_window_view(padded, RATE_READINGS)[-new:]
    return np.asarray(np.sort(windows, axis=1)[np.arange(new), count // 2])


class SignalTrack:
    """The latest readings of one quantity, shape (n,) each.

    Attributes:
        stamps: ns, increasing.
        values: of the same length.
        periods: usual step by each reading and those before it, s; 0 at the first.
        gaps: ns beyond which nothing is joined, by each reading and those before it.
    """

    def __init__(self, max_gap: float) -> None:
        """Join readings up to max_gap, s, apart, and slow ones up to `GAP_STEPS` usual steps."""
        self._max_gap = max_gap
        self._steps = np.empty(0)
        self._period, self._gap_ns = 0.0, int(max_gap * NANOSECONDS)
        self._forget()

    def _forget(self) -> None:
        self.stamps, self.gaps = np.empty(0, np.int64), np.empty(0, np.int64)
        self.values, self.periods = np.empty(0), np.empty(0)

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest reading, `NEVER` before the first."""
        return int(self.stamps[-1]) if len(self.stamps) else NEVER

    def rates(self, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Latest steps, s; and usual step, s, and gap, ns, by each of the readings that follow."""
        moments = np.concatenate((self.stamps[-1:], stamps))
        new = (moments[1:] - moments[:-1]) / NANOSECONDS
        steps = np.concatenate((self._steps, new))
        periods = medians(steps, len(new))
        if len(new) < len(stamps):  # the first of all ends no step
            periods = np.append(self._period, periods)
        return steps[-RATE_READINGS:], periods, self._gaps(periods)

    def _gaps(self, periods: np.ndarray) -> np.ndarray:
        gaps = np.maximum(self._max_gap, GAP_STEPS * periods) * NANOSECONDS
        return np.asarray(np.minimum(gaps, LATER).astype(np.int64))

    def extend(self, stamps: np.ndarray, values: np.ndarray) -> None:
        """Take the readings that follow, in order of stamps."""
        if not len(stamps):
            return
        self._steps, periods, gaps = self.rates(stamps)
        self._period, self._gap_ns = float(periods[-1]), int(gaps[-1])
        self.stamps = np.concatenate((self.stamps, stamps))
        self.values = np.concatenate((self.values, values))
        self.periods = np.concatenate((self.periods, periods))
        self.gaps = np.concatenate((self.gaps, gaps))

    def until_gap(self, stamps: np.ndarray) -> int:
        """How many of the readings that follow come before a gap, by the rate up to each."""
        before_ns = self.stamps[-1:] if len(self.stamps) else stamps[:1]
        steps = np.diff(np.concatenate((before_ns, stamps)))
        if not len(steps) or steps.max() <= self._max_gap * NANOSECONDS:
            return len(stamps)  # no gap is shorter
        *_, gaps = self.rates(stamps)
        apart = np.flatnonzero(steps > np.append(self._gap_ns, gaps[:-1]))
        return int(apart[0]) if len(apart) else len(stamps)

    def forget_before(self, needed_ns: int) -> None:
        """Drop readings that no moment from `needed_ns` on needs."""
        oldest = min(needed_ns, self.newest_ns - TRACK_NS)
        first = int(self.stamps.searchsorted(oldest)) - RATE_READINGS - 1
        if first > len(self.stamps) // 2:  # else copying costs more than it saves
            kept = slice(first, None)
            self.stamps, self.values = self.stamps[kept], self.values[kept]
            self.periods, self.gaps = self.periods[kept], self.gaps[kept]

    def restart(self, gap: float) -> None:
        """Forget the readings before a gap, s, which counts as a step of a slow signal."""
        self._steps = np.append(self._steps, gap)[-RATE_READINGS:]
        self._period = float(medians(self._steps, 1)[0])
        self._gap_ns = int(self._gaps(np.array([self._period]))[0])
        self._forget()

    def period(self, moments: Any = None) -> Any:
        """Usual step by the readings up to moments, s, of their shape; without moments, by all."""
        return self._last_of(self.periods, self._period, moments)

    def gap_ns(self, moments: Any = None) -> Any:
        """Gap beyond which nothing is joined, ns; arguments as in `period`."""
        return self._last_of(self.gaps, self._gap_ns, moments)

    def _last_of(self, column: np.ndarray, without: float, moments: Any) -> Any:
        if moments is None:
            return without
        if not len(column):
            return np.full(np.shape(moments), without)[()]
        return column[np.maximum(self.stamps.searchsorted(moments, side="right") - 1, 0)]

    def first_after(self, moments: np.ndarray) -> np.ndarray:
        """Stamps of the first readings from moments on, `LATER` where there is none."""
        return np.concatenate((self.stamps, (LATER,)))[self.stamps.searchsorted(moments)]

    def last(self, moments: np.ndarray) -> np.ndarray:
        """Last values at moments or before; NaN where they are too long ago. Shape (n,)."""
        if not len(self.stamps):
            return np.full(len(moments), np.nan)
        index = self.stamps.searchsorted(moments, side="right") - 1
        there = np.maximum(index, 0)
        fresh = (index >= 0) & (moments - self.stamps[there] <= self.gaps[there])
        return np.where(fresh, self.values[there], np.nan)

    def at(self, moments: np.ndarray) -> np.ndarray:
        """Values at moments, linear between neighbours; NaN where not measured. Shape (n,)."""
        if not len(self.stamps):
            return np.full(len(moments), np.nan)
        after = self.stamps.searchsorted(moments)
        known = after < len(self.stamps)
        after = np.minimum(after, len(self.stamps) - 1)
        before = np.maximum(after - 1, 0)
        step = self.stamps[after] - self.stamps[before]
        share = (moments - self.stamps[before]) / np.maximum(step, 1)
        value = self.values[before] + share * (self.values[after] - self.values[before])
        exact = self.stamps[after] == moments
        joined = (step > 0) & (step <= self.gaps[after]) & (moments > self.stamps[before])
        value = np.where(exact, self.values[after], np.where(joined, value, np.nan))
        return np.where(known, value, np.nan)

    def covered(self, moments: np.ndarray) -> np.ndarray:
        """Whether readings around and within each step between n moments leave no gap.

        The moments, ns, rise; shape (n - 1,).
        """
        around = self._around(moments)
        stamps = self.stamps[around]
        if not len(stamps):
            return np.zeros(len(moments) - 1, dtype=bool)
        gaps = np.append(0, np.cumsum(np.diff(stamps) > self.gaps[around][1:]))
        first = np.searchsorted(stamps, moments[:-1], side="right") - 1
        last = np.searchsorted(stamps, moments[1:])
        inside = (first >= 0) & (last < len(stamps))
        return np.asarray(inside & (gaps[np.minimum(last, len(gaps) - 1)] == gaps[first]))

    def between(self, moments: np.ndarray) -> np.ndarray:
        """Values at n moments in order, linear between readings on both sides, shape (n,)."""
        around, zero_ns = self._around(moments), moments[0]
        stamps = self.stamps[around] - zero_ns
        return np.asarray(np.interp(moments - zero_ns, stamps, self.values[around]))

    def _around(self, moments: np.ndarray) -> slice:
        """The readings around and within moments in order."""
        first = max(0, int(self.stamps.searchsorted(moments[0], side="right")) - 1)
        return slice(first, int(self.stamps.searchsorted(moments[-1])) + 1)

    def step_around(self, stamp_ns: int) -> float:
        """Median of the latest steps up to the first reading at or after a moment, s."""
        last = int(self.stamps.searchsorted(stamp_ns)) + 1
        latest = self.stamps[max(0, last - RATE_READINGS - 1) : last]
        return float(np.median(np.diff(latest))) / NANOSECONDS if len(latest) > 1 else 0.0

    def within(self, start_ns: int, end_ns: int) -> np.ndarray:
        """Stamps strictly between two moments."""
        first = self.stamps.searchsorted(start_ns, side="right")
        return np.asarray(self.stamps[first : self.stamps.searchsorted(end_ns)])
