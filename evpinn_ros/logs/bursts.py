"""Rows that an app writes at once, each time a part of a message arrives: one reading.

Stamps of a table are of the moment of writing; those of a topic are of the measurement, so this
is no rule of `core`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.logs.signal import FloatArray, Signal

LONGEST = 0.1  # s, from the first row to the last
APART = 5.0  # times that: from one burst to the next
LEAST_BURSTS, SHARE = 20, 0.3  # of two rows or more, and of all
MOST_TWICE = 0.2  # of the bursts: where a signal is told more often, rows are readings

Places = NDArray[np.intp]


class _Bursts(NamedTuple):
    """Places of the first and of the last row of each, shape (n,) each."""

    firsts: Places
    lasts: Places

    @classmethod
    def of(cls, times: FloatArray) -> _Bursts:
        """The bursts of rows with these times, s, in order, shape (m,)."""
        breaks = np.flatnonzero(np.diff(times) > LONGEST)
        return cls(np.append(0, breaks + 1), np.append(breaks, times.size - 1))

    def told_last(self, values: FloatArray) -> FloatArray:
        """The last value in each; NaN where none is told."""
        places = np.where(np.isfinite(values), np.arange(values.size), -1)
        told = np.maximum.accumulate(places)[self.lasts]
        return np.where(told >= self.firsts, values[told], np.nan)


def join(stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: Places) -> Places:
    """The last row of each burst, of `rows` in order of time, ns; it gets what the others tell."""
    if not rows.size:
        return rows
    bursts = _Bursts.of((stamps[rows] - stamps[rows[0]]) / NANOSECONDS)
    kept = rows[bursts.lasts]
    for column in values.values():
        column[kept] = bursts.told_last(column[rows])
    return kept


def joined(signal: Signal) -> Signal:
    """A signal with one value of each burst."""
    there = np.isfinite(signal.time)
    time = signal.time[there]
    bursts = _Bursts.of(time)
    return Signal(time[bursts.lasts], bursts.told_last(signal.value[there]))


def come_in_bursts(signals: Mapping[str, Signal]) -> bool:
    """True if rows of one table come in bursts far apart, which tell each signal once at most."""
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
    told = np.isfinite(values)
    number, values = number[told], values[told]
    changes = np.bincount(number[1:][np.diff(values) != 0.0], minlength=several.size)[several]
    return bool((changes > 1).sum() > MOST_TWICE * (changes > 0).sum())
