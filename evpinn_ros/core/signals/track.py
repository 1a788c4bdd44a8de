"""The latest readings of one quantity, and the rate at which they come.

A block of readings is taken at once, but nothing may rest on a reading before it has come: so each
reading keeps its place in the order of arrival, and whatever is asked is asked `by` such a place.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS

TRACK_NS = 90 * NANOSECONDS  # of readings kept at least
RATE_READINGS = 15  # steps whose median is the rate of a signal
GAP_STEPS = 6.0  # median steps across which readings are still joined
BEFORE = -1  # the place of a reading that came before the present block
LATER = 2**62  # a place, and a moment in ns, that is never reached
AFTER_ALL = np.array([LATER])
NEVER = -LATER  # ns, of what did not come yet


def medians(steps: np.ndarray, new: int) -> np.ndarray:
    """Median of the latest `RATE_READINGS` steps up to each of the last `new`, shape (new,).

    Of an even number of steps the larger of the two in the middle.
    """
    if new == 1:
        latest = np.sort(steps[-RATE_READINGS:])
        return latest[len(latest) // 2 :][:1]
    count = np.minimum(np.arange(len(steps) - new, len(steps)) + 1, RATE_READINGS)
    padded = np.concatenate((np.full(RATE_READINGS, np.inf), steps))
    windows = np.lib.stride_tricks.sliding_window_view(padded, RATE_READINGS)[-new:]
    return np.asarray(np.sort(windows, axis=1)[np.arange(new), count // 2])


class SignalTrack:
    """The latest readings of one quantity in order of stamps, shape (n,) each.

    Attributes:
        stamps: ns, increasing.
        values: of the same length.
        orders: places in the order of arrival, `BEFORE` for those of earlier blocks.
        periods: usual step once each had come, s; 0 before the second reading.
        gaps: ns between readings beyond which nothing is joined, once each had come.
    """

    def __init__(self, max_gap: float) -> None:
        """Join readings up to max_gap, s, apart, and slow ones up to `GAP_STEPS` usual steps."""
        self._max_gap = max_gap
        self._steps = np.empty(0)
        self._period, self._gap_ns = 0.0, int(max_gap * NANOSECONDS)
        self._forget()

    def _forget(self) -> None:
        self.stamps, self.orders = np.empty(0, np.int64), np.empty(0, np.int64)
        self.gaps, self.values, self.periods = np.empty(0, np.int64), np.empty(0), np.empty(0)

    def __len__(self) -> int:
        return len(self.stamps)

    def in_order(self, stamps: np.ndarray) -> int:
        """How many of these stamps, from the first on, each come after the one before."""
        before = np.concatenate((self.stamps[-1:], stamps))
        rises = before[1:] > before[:-1]
        return len(stamps) if rises.all() else int(rises.argmin()) + (not len(self.stamps))

    def rates(self, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Latest steps, s, and usual step, s, and gap, ns, once each of more readings has come."""
        moments = np.concatenate((self.stamps[-1:], stamps))
        new = (moments[1:] - moments[:-1]) / NANOSECONDS
        steps, periods = np.concatenate((self._steps, new)), np.full(len(stamps), self._period)
        if len(new):
            periods[-len(new) :] = medians(steps, len(new))
        return steps[-RATE_READINGS:], periods, self._gaps(periods)

    def _gaps(self, periods: np.ndarray) -> np.ndarray:
        gaps = np.maximum(self._max_gap, GAP_STEPS * periods) * NANOSECONDS
        return np.asarray(np.minimum(gaps, LATER).astype(np.int64))

    def extend(self, orders: np.ndarray, stamps: np.ndarray, values: np.ndarray) -> None:
        """Take readings that come in order of stamps, after all before."""
        if not len(stamps):
            return
        self._steps, periods, gaps = self.rates(stamps)
        self._period, self._gap_ns = float(periods[-1]), int(gaps[-1])
        self.stamps = np.concatenate((self.stamps, stamps))
        self.values = np.concatenate((self.values, values))
        self.orders = np.concatenate((self.orders, orders))
        self.periods = np.concatenate((self.periods, periods))
        self.gaps = np.concatenate((self.gaps, gaps))

    def insert(self, stamp_ns: int, value: float) -> bool:
        """Take one reading of any stamp between blocks; False when this stamp is already there."""
        place = int(self.stamps.searchsorted(stamp_ns))
        if place == len(self.stamps):
            self.extend(np.array([BEFORE]), np.array([stamp_ns]), np.array([value]))
            return True
        if self.stamps[place] == stamp_ns:
            return False
        self.stamps = np.insert(self.stamps, place, stamp_ns)
        self.values = np.insert(self.values, place, value)
        self.orders = np.insert(self.orders, place, BEFORE)
        self.periods = np.insert(self.periods, place, self._period)
        self.gaps = np.insert(self.gaps, place, self._gap_ns)
        return True

    def settle(self, needed_ns: int) -> None:
        """Take all as come before; drop what no moment from `needed_ns` on can rest on."""
        if not len(self.stamps) or self.orders[-1] == BEFORE:
            return
        oldest = min(needed_ns, int(self.stamps[-1]) - TRACK_NS)
        first = max(0, int(self.stamps.searchsorted(oldest)) - RATE_READINGS - 1)
        kept = slice(first, None)
        self.stamps, self.values = self.stamps[kept], self.values[kept]
        self.orders = np.full(len(self.stamps), BEFORE)
        self.periods, self.gaps = self.periods[kept], self.gaps[kept]

    def restart(self, gap: float) -> None:
        """Forget the readings before a gap, s; of a slow signal it is a step like others."""
        self._steps = np.append(self._steps, gap)[-RATE_READINGS:]
        self._period = float(medians(self._steps, 1)[0])
        self._gap_ns = int(self._gaps(np.array([self._period]))[0])
        self._forget()

    def count(self, by: Any) -> Any:
        """How many had come by places in the order of arrival, of the same shape."""
        return self.orders.searchsorted(by, side="right")

    def period(self, by: Any = LATER) -> Any:
        """Usual step by places in the order of arrival, s."""
        return self._by(self.periods, self._period, by)

    def gap_ns(self, by: Any = LATER) -> Any:
        """Nanoseconds beyond which nothing is joined, by places in the order of arrival."""
        return self._by(self.gaps, self._gap_ns, by)

    def _by(self, column: np.ndarray, without: float, by: Any) -> Any:
        if not len(column):
            return np.full(np.shape(by), without)[()]
        return column[np.maximum(self.count(by) - 1, 0)]

    def first_after(self, moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stamps and places of the first readings from moments on, `LATER` where there is none."""
        index = self.stamps.searchsorted(moments)
        stamps, orders = (np.concatenate((c, AFTER_ALL)) for c in (self.stamps, self.orders))
        return stamps[index], orders[index]

    def last(self, moments: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Last values at moments or before; NaN where they are too long ago. Shape (n,)."""
        index = np.minimum(self.stamps.searchsorted(moments, side="right"), self.count(by)) - 1
        if not len(self.stamps):
            return np.full(len(moments), np.nan)
        there = np.maximum(index, 0)
        fresh = (index >= 0) & (moments - self.stamps[there] <= self.gap_ns(by))
        return np.where(fresh, self.values[there], np.nan)

    def at(self, moments: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Values at moments, linear between neighbours; NaN where not measured. Shape (n,)."""
        if not len(self.stamps):
            return np.full(len(moments), np.nan)
        after = self.stamps.searchsorted(moments)
        known = after < self.count(by)
        after = np.minimum(after, len(self.stamps) - 1)
        before = np.maximum(after - 1, 0)
        step = self.stamps[after] - self.stamps[before]
        share = (moments - self.stamps[before]) / np.maximum(step, 1)
        value = self.values[before] + share * (self.values[after] - self.values[before])
        exact = self.stamps[after] == moments
        joined = (step > 0) & (step <= self.gap_ns(by)) & (moments > self.stamps[before])
        value = np.where(exact, self.values[after], np.where(joined, value, np.nan))
        return np.where(known, value, np.nan)

    def covered(self, moments: np.ndarray, by: int = LATER) -> np.ndarray:
        """Whether readings around and within each step between n moments leave no gap.

        The moments, ns, rise; shape (n - 1,).
        """
        stamps = self._around(moments, by)[0]
        if not len(stamps):
            return np.zeros(len(moments) - 1, dtype=bool)
        gaps = np.append(0, np.cumsum(np.diff(stamps) > self.gap_ns(by)))
        first = np.searchsorted(stamps, moments[:-1], side="right") - 1
        last = np.searchsorted(stamps, moments[1:])
        inside = (first >= 0) & (last < len(stamps))
        return np.asarray(inside & (gaps[np.minimum(last, len(gaps) - 1)] == gaps[first]))

    def between(self, moments: np.ndarray, by: int = LATER) -> np.ndarray:
        """Values at n moments in order, linear between readings on both sides, shape (n,)."""
        stamps, values = self._around(moments, by)
        zero_ns = moments[0]
        return np.asarray(np.interp(moments - zero_ns, stamps - zero_ns, values))

    def _around(self, moments: np.ndarray, by: int) -> tuple[np.ndarray, np.ndarray]:
        """Stamps, ns, and values of the readings around and within moments in order."""
        come = self.count(by)
        first = max(0, int(np.searchsorted(self.stamps[:come], moments[0], side="right")) - 1)
        last = int(np.searchsorted(self.stamps[:come], moments[-1])) + 1
        chosen = slice(first, min(last, come))
        return self.stamps[chosen], self.values[chosen]

    def step_around(self, stamp_ns: int, by: int = LATER) -> float:
        """Usual step between the readings up to a moment, s, whatever their order of arrival."""
        last = min(int(self.stamps.searchsorted(stamp_ns)) + 1, int(self.count(by)))
        latest = self.stamps[max(0, last - RATE_READINGS - 1) : last]
        return float(np.median(np.diff(latest))) / NANOSECONDS if len(latest) > 1 else 0.0

    def within(self, start_ns: int, end_ns: int, by: int = LATER) -> np.ndarray:
        """Stamps strictly between two moments."""
        stamps = self.stamps[: self.count(by)]
        first = np.searchsorted(stamps, start_ns, side="right")
        return np.asarray(stamps[first : np.searchsorted(stamps, end_ns)])
