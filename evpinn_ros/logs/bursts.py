"""Joins rows that an app writes in a burst, one for each part of a message, to one reading.

Only tables need this: they are stamped when written, messages of a topic when measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.logs.signal import FloatArray, Signal

LONGEST = 0.1  # s, from the first row of a burst to the last
APART = 5.0  # times `LONGEST`, from one burst to the next
LEAST_BURSTS, SHARE = 20, 0.3  # bursts of two rows or more, and their share of all
MOST_TWICE = 0.2  # share of bursts that change a signal twice; above it, rows are readings

Places = NDArray[np.intp]


class _Bursts(NamedTuple):
    """Indices of the first and the last row of each burst, shape (n,) each."""

    firsts: Places
    lasts: Places

    @classmethod
    def of(cls, times: FloatArray) -> _Bursts:
        """The bursts of rows with these times, s, in order, shape (m,)."""
        breaks = np.flatnonzero(np.diff(times) > LONGEST)
        return cls(np.append(0, breaks + 1), np.append(breaks, times.size - 1))

    def last_known(self, values: FloatArray) -> FloatArray:
        """Last known value in each burst, shape (n,); NaN if none is known."""
        places = np.where(np.isfinite(values), np.arange(values.size), -1)
        place = np.maximum.accumulate(places)[self.lasts]
        return np.where(place >= self.firsts, values[place], np.nan)


def join(stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: Places) -> Places:
    """Indices of the last row of each burst of `rows`, in time order; it gets the last values."""
    if not rows.size:
        return rows
    bursts = _Bursts.of((stamps[rows] - stamps[rows[0]]) / NANOSECONDS)
    kept = rows[bursts.lasts]
    for column in values.values():
        column[kept] = bursts.last_known(column[rows])
    return kept


def joined(signal: Signal) -> Signal:
    """The signal with one value per burst."""
    there = np.isfinite(signal.time)
    time = signal.time[there]
    bursts = _Bursts.of(time)
    return Signal(time[bursts.lasts], bursts.last_known(signal.value[there]))


def come_in_bursts(signals: Mapping[str, Signal]) -> bool:
    """True if rows of one table come in distant bursts with one value per signal at most."""
    times = next(iter(signals.values())).time
    there = np.isfinite(times)
    times = times[there]
    if times.size < LEAST_BURSTS:
        return False
    bursts = _Bursts.of(times)
    several = bursts.lasts > bursts.firsts
    if several.sum() < LEAST_BURSTS or several.mean() < SHARE:
        return False
    longest = float(np.quantile(times[bursts.lasts] - times[bursts.firsts], 0.95))
    if longest > LONGEST or np.median(np.diff(times[bursts.firsts])) < APART * longest:
        return False
    number = np.repeat(np.arange(several.size), bursts.lasts - bursts.firsts + 1)
    return not any(
        _often_twice(number, signal.value[there], several) for signal in signals.values()
    )


def _often_twice(number: Places, values: FloatArray, several: NDArray[np.bool_]) -> bool:
    """True if a signal changes more than once in many bursts of several rows."""
    known = np.isfinite(values)
    number, values = number[known], values[known]
    changes = np.bincount(number[1:][np.diff(values) != 0.0], minlength=several.size)[several]
    return bool((changes > 1).sum() > MOST_TWICE * (changes > 0).sum())
