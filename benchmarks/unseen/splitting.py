"""Splits a log into its drives, at pauses and charging.

Unlike `evpinn_ros.logs.trips`, a drive continues across a stop of any length, and has at least
1 km: the scores in `docs/project/benchmarks.md` are of drives cut like this (109 of the Leaf,
whose logs have 123 trips).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

import numpy as np

from benchmarks.unseen.lines import DrivePart, battery_power, common, speed_line
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.logs.trips import CHARGING_POWER, LONGEST_PAUSE, stands

EPSILON = 1e-3  # s, so that the first and last moment of charging belong to it
LEAST_DISTANCE = 1000.0  # m; shorter pieces are manoeuvres


def split(readings: Sequence[Reading]) -> Iterator[tuple[Reading, ...]]:
    """The drives of a log, in order; a log of one drive is not cut, however short."""
    spans = _driving(readings)
    if len(spans) == 1:
        yield tuple(readings)
        return
    start_ns = readings[0].stamp_ns
    line = speed_line(readings, start_ns)
    for span in spans:
        if line.over(span) >= LEAST_DISTANCE:
            yield tuple(
                reading
                for reading in readings
                if span.begin <= (reading.stamp_ns - start_ns) / NANOSECONDS <= span.end
            )


def _driving(readings: Sequence[Reading]) -> list[DrivePart]:
    """The spans of a log between pauses and charging."""
    if not readings:
        return []
    start_ns = readings[0].stamp_ns
    speed, power = speed_line(readings, start_ns), battery_power(readings, start_ns)
    if speed.time.size < 2:
        return []
    pauses = np.flatnonzero(np.diff(speed.time) > LONGEST_PAUSE)
    between = [DrivePart(float(speed.time[i]), float(speed.time[i + 1])) for i in pauses]
    for begin, end in stands(speed.time, np.abs(speed.value)):
        known = [part.length for part in common(power.spans(), [DrivePart(begin, end)])]
        if known and -power.over(DrivePart(begin, end)) > CHARGING_POWER * sum(known):
            between.append(DrivePart(begin - EPSILON, end + EPSILON))
    ends = [-math.inf, *(end for span in sorted(between) for end in span), math.inf]
    return [DrivePart(begin, end) for begin, end in zip(ends[::2], ends[1::2], strict=True)]
