"""Piecewise linear signals with gaps: battery power from its own stamps, and exact integrals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
    drawn_power,
)

LEAST_GAP_S = 2.5  # shorter gaps are bridged by a straight line at any sampling
GAP_PERIODS = 4.0  # of polled logs, gaps up to so many median periods


class DrivePart(NamedTuple):
    """A part of a drive, s since its start."""

    begin: float
    end: float

    @property
    def length(self) -> float:
        """Duration, s."""
        return self.end - self.begin


class Line:
    """A signal that runs straight between its samples, and is unknown across longer gaps.

    Attributes:
        time: stamps, s, increasing, shape (n,).
        value: shape (n,).
        gap: longest step that is bridged, s.
    """

    def __init__(self, time: np.ndarray, value: np.ndarray, gap: float | None = None) -> None:
        """Keep the finite samples, in order of time; the gap follows from their period if None."""
        time, value = np.asarray(time, dtype=float), np.asarray(value, dtype=float)
        known = np.isfinite(value)
        self.time, first = np.unique(time[known], return_index=True)
        self.value = value[known][first]
        steps = np.diff(self.time)
        period = float(np.median(steps)) if steps.size else 0.0
        self.gap = max(LEAST_GAP_S, GAP_PERIODS * period) if gap is None else gap
        inside = np.where(steps <= self.gap, steps, 0.0)
        self._net = _running(inside * (self.value[1:] + self.value[:-1]) / 2)
        size = np.abs(self.value)
        self._gross = _running(inside * (size[1:] + size[:-1]) / 2)

    def at(self, time: np.ndarray) -> np.ndarray:
        """Values at times, NaN where unknown; shape of `time`."""
        time = np.asarray(time, dtype=float)
        if self.time.size < 2:
            return np.full(time.shape, np.nan)
        after = np.clip(np.searchsorted(self.time, time), 1, self.time.size - 1)
        begin, end = self.time[after - 1], self.time[after]
        known = (time >= self.time[0]) & (time <= self.time[-1])
        known &= (end - begin <= self.gap) | (time == begin) | (time == end)
        return np.where(known, np.interp(time, self.time, self.value), np.nan)

    def spans(self) -> list[DrivePart]:
        """The parts without a gap."""
        if self.time.size < 2:
            return []
        breaks = np.flatnonzero(np.diff(self.time) > self.gap)
        begins = np.concatenate(([0], breaks + 1))
        ends = np.concatenate((breaks, [self.time.size - 1]))
        spans = [
            DrivePart(float(self.time[i]), float(self.time[j]))
            for i, j in zip(begins, ends, strict=True)
        ]
        return [span for span in spans if span.length > 0]

    def integral(self, time: np.ndarray) -> np.ndarray:
        """Integral from the first sample to times, gaps left out; exact for a straight line."""
        time = np.clip(np.asarray(time, dtype=float), self.time[0], self.time[-1])
        before = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, None)
        after = np.minimum(before + 1, self.time.size - 1)
        into = np.where(self.time[after] - self.time[before] <= self.gap, time, 0.0)
        into = np.where(into > 0, into - self.time[before], 0.0)
        value = np.interp(time, self.time, self.value)
        return np.asarray(self._net[before] + into * (self.value[before] + value) / 2)

    def gross(self, span: DrivePart) -> float:
        """Integral of the size of the signal over a span, gaps left out."""
        return float(np.diff(np.interp(span, self.time, self._gross))[0])

    def over(self, span: DrivePart) -> float:
        """Integral over a span, gaps left out."""
        return float(np.diff(self.integral(np.array(span)))[0])


def battery_power(readings: Iterable[Reading], start_ns: int) -> Line:
    """Battery power, W, positive when drawn, from voltage and current of any stamps.

    Both are interpolated between their own samples, so logs that poll them in turn need no pairs.
    """
    rows = [
        ((reading.stamp_ns - start_ns) / NANOSECONDS, reading.voltage, reading.current)
        for reading in readings
        if isinstance(reading, BatteryReading)
    ]
    time, voltage, current = np.array(rows, dtype=float).reshape(-1, 3).T
    volts, amperes = Line(time, voltage), Line(time, current)
    both = np.unique(np.concatenate((volts.time, amperes.time)))
    power = drawn_power(volts.at(both), amperes.at(both))
    return Line(both, power, max(volts.gap, amperes.gap))


def speed_line(readings: Iterable[Reading], start_ns: int) -> Line:
    """Speed, m/s."""
    rows = [
        ((reading.stamp_ns - start_ns) / NANOSECONDS, reading.speed)
        for reading in readings
        if isinstance(reading, SpeedReading)
    ]
    return Line(*np.array(rows, dtype=float).reshape(-1, 2).T)


def common(some: Sequence[DrivePart], others: Sequence[DrivePart]) -> list[DrivePart]:
    """Spans in which both are known."""
    both = [DrivePart(max(a.begin, b.begin), min(a.end, b.end)) for a in some for b in others]
    return [span for span in both if span.length > 0]


def _running(steps: np.ndarray) -> np.ndarray:
    return np.concatenate(([0.0], np.cumsum(steps)))
