"""A log that holds several drives, and charging between them, into its drives.

A drive ends where no speed comes for `LONGEST_PAUSE`, and where the car charges: it
stands for `LEAST_CHARGING` or longer and takes on average more than `CHARGING_POWER`. What was
logged while charging is left out. Pieces shorter than `LEAST_DISTANCE` are manoeuvres, left out
too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

import numpy as np

from benchmarks.unseen.lines import DrivePart, battery_power, common, speed_line
from evpinn_ros.signals.readings import NANOSECONDS, Reading

LONGEST_PAUSE = 600.0  # s
LEAST_CHARGING, CHARGING_POWER = 120.0, 300.0  # s, W
EPSILON = 1e-3  # s, so that the first and last moment of charging belong to it
STANDING = 0.3  # m/s
LEAST_DISTANCE = 1000.0  # m


def split(readings: Sequence[Reading]) -> Iterator[tuple[Reading, ...]]:
    """The drives of a log, in order; one that is short as a whole is given as it is."""
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
    for stand in _standing(speed.time, speed.value):
        known = [part.length for part in common(power.spans(), [stand])]
        if known and -power.over(stand) > CHARGING_POWER * sum(known):
            between.append(DrivePart(stand.begin - EPSILON, stand.end + EPSILON))
    ends = [-math.inf, *(end for span in sorted(between) for end in span), math.inf]
    return [DrivePart(begin, end) for begin, end in zip(ends[::2], ends[1::2], strict=True)]


def _standing(time: np.ndarray, speed: np.ndarray) -> Iterator[DrivePart]:
    """Stands of `LEAST_CHARGING` or longer, not across pauses."""
    still = np.abs(speed) < STANDING
    ends = np.flatnonzero((still[1:] != still[:-1]) | (np.diff(time) > LONGEST_PAUSE))
    begins = np.concatenate(([0], ends + 1))
    for begin, end in zip(begins, np.concatenate((ends, [time.size - 1])), strict=True):
        if still[begin] and time[end] - time[begin] >= LEAST_CHARGING:
            yield DrivePart(float(time[begin]), float(time[end]))
