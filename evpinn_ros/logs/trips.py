"""Joins logs torn into several files, and splits those of a day into trips.

A file that begins within `LONGEST_PAUSE` of the end of another continues it. A trip ends where no
speed comes or the car stands for so long, and where it charges: stands for `LEAST_CHARGING` and
takes over `CHARGING_POWER`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.block import joined as joined_blocks
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    SpeedReading,
    drawn_power,
)
from evpinn_ros.logs.signal import last_known
from evpinn_ros.logs.source import STRAGGLING_NS, Source

LONGEST_PAUSE = 600.0  # s
LEAST_CHARGING, CHARGING_POWER = 120.0, 300.0  # s, W
STANDING = 0.3  # m/s
EDGE = 30.0  # s that the car stands before and after a trip and that belong to it
LEAST_DISTANCE = 500.0  # m; shorter ones are manoeuvres
MANOEUVRE = 50.0  # m, of a log without a drive


class Trip(NamedTuple):
    """Begin and end of a trip, ns, and its length, m."""

    begin_ns: float
    end_ns: float
    distance: float


class Trips(NamedTuple):
    """Trips of a log, in order."""

    trips: tuple[Trip, ...]  # of at least `LEAST_DISTANCE`
    charged: float = 0.0  # energy that the battery was charged with outside of them, J
    distance: float = 0.0  # of all the log, m


class JoinedLog(Source):
    """Files that an app wrote of one drive, one after another."""

    def __init__(self, files: Sequence[Source]) -> None:
        super().__init__(files[0].path, files[0])
        self._files = files

    @property
    def seconds(self) -> float | None:
        """Length of all files together, without the pauses between them, s."""
        lengths = [file.seconds for file in self._files]
        return sum(filter(None, lengths)) if all(lengths) else None

    @property
    def problem(self) -> str | None:
        """Unreadable parts of the files."""
        return "; ".join(file.problem for file in self._files if file.problem) or None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of all files, each once."""
        return tuple(dict.fromkeys(note for file in self._files for note in file.notes))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Doubts of all files, each once."""
        return tuple(dict.fromkeys(doubt for file in self._files for doubt in file.doubts))

    def read(self) -> Iterator[Block]:
        """The readings of all files in order."""
        for file in self._files:
            yield from file.blocks()
        self.dropped.clear()
        for file in self._files:
            self.dropped.update(file.dropped)


def joined(logs: Sequence[Source]) -> list[Source]:
    """The logs, joined where both dates are known and the pause between them ends no trip."""
    groups: list[list[Source]] = []
    end_ns = None
    for log in logs:
        span = _span(log)
        pause = (span[0] - end_ns) / NANOSECONDS if span and end_ns is not None else math.inf
        if groups and 0.0 <= pause <= LONGEST_PAUSE:
            groups[-1].append(log)
        else:
            groups.append([log])
        end_ns = span[1] if span else None
    return [group[0] if len(group) == 1 else JoinedLog(group) for group in groups]


def _span(log: Source) -> tuple[int, int] | None:
    """First and last stamp of a table whose day is known, ns; None of any other log."""
    seconds = log.seconds
    if not log.rules or not log.dated or seconds is None:
        return None
    with suppress(InputError):
        if (first := next(log.blocks(), None)) is not None:
            begin_ns = int(first.stamps()[0])
            return begin_ns, begin_ns + round(seconds * NANOSECONDS)
    return None


class TripSource(Source):
    """One trip of a log that holds several."""

    def __init__(self, log: Source, number: int, trips: Sequence[Trip]) -> None:
        name = f"{log.path.name.partition('.')[0]}:{number}"
        super().__init__(log.path.with_name(name), log)
        self._log, self._trip = log, trips[number - 1]
        self._last = number == len(trips)

    @property
    def seconds(self) -> float | None:
        """Length of the trip, s."""
        span = self._trip.end_ns - self._trip.begin_ns
        return span / NANOSECONDS if math.isfinite(span) else None

    @property
    def problem(self) -> str | None:
        """Unreadable part of the log; it lies behind the last trip, which names it."""
        return self._log.problem if self._last else None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on how the log was read; the last trip has them, for then it was read whole."""
        return self._log.notes if self._last else ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Doubts of the log, which hold for each of its trips."""
        return self._log.doubts

    def read(self) -> Iterator[Block]:
        """Readings of the trip in recorded order; what the log lost counts with its last trip."""
        begin, end = self._trip.begin_ns, self._trip.end_ns
        until = math.inf if self._last else end + STRAGGLING_NS
        for block in self._log.blocks():
            beyond = block.stamps() > until
            read = int(beyond.argmax()) if beyond.any() else block.length
            part = block.part(0, read)
            inside = {
                kind: (rows.stamps >= begin) & (rows.stamps <= end)
                for kind, rows in part.rows.items()
            }
            if len(trip := part.only(inside)):
                yield trip
            if read < block.length:
                break
        if self._last:
            self.dropped.update(self._log.dropped)


def split(
    log: Source, *, whole: bool = False, ahead: bool = True
) -> tuple[Sequence[Source], float]:
    """The trips of a log (one if `whole`), and J charged between; InputError if only charged.

    With `ahead` the log keeps what was read for its next `blocks`.
    """
    trips = trips_of(log.read_ahead() if ahead else log.blocks())
    if trips.charged and trips.distance < MANOEUVRE:
        kwh = trips.charged / JOULES_PER_KWH
        raise InputError(f"{log.path}: no drive: the car stood and was charged with {kwh:.2f} kWh")
    if whole or len(trips.trips) < 2:
        return [log], 0.0
    count = len(trips.trips)
    return [TripSource(log, 1 + i, trips.trips) for i in range(count)], trips.charged


def trips_of(blocks: Iterable[Block]) -> Trips:
    """Find the trips among readings in recorded order."""
    whole = joined_blocks(list(blocks))
    speeds, battery = whole.of_kind(SpeedReading), whole.of_kind(BatteryReading)
    speeds = speeds.where(np.isfinite(speeds.values[0]))
    if len(speeds.stamps) < 2:
        return Trips(())
    start_ns = int(speeds.stamps[0])
    time, fast = _series(speeds.stamps - start_ns, np.abs(speeds.values[0]))
    voltage, current = battery.values[:2]
    drawn = _series(battery.stamps - start_ns, drawn_power(last_known(voltage), current))
    breaks, charged = [(-math.inf, -math.inf)], 0.0
    pauses = np.flatnonzero(np.diff(time) > LONGEST_PAUSE)
    spans = zip(time[pauses].tolist(), time[pauses + 1].tolist(), strict=True)
    for begin, end in sorted([*spans, *stands(time, fast)]):
        taken = _charged(*drawn, begin, end)
        if taken > CHARGING_POWER * (end - begin) and end - begin >= LEAST_CHARGING:
            charged += taken
        elif end - begin < LONGEST_PAUSE:
            continue
        edge = min(EDGE, (end - begin) / 2)
        breaks.append((begin + edge, end - edge))
    breaks.append((math.inf, math.inf))
    way = np.concatenate(([0.0], np.cumsum((fast[1:] + fast[:-1]) / 2 * _steps(time))))
    trips = []
    for (_, begin), (end, _) in pairwise(breaks):
        far = float(np.interp(end, time, way) - np.interp(begin, time, way))
        if far >= LEAST_DISTANCE:
            begin_ns, end_ns = (start_ns + seconds * NANOSECONDS for seconds in (begin, end))
            trips.append(Trip(begin_ns, end_ns, far))
    return Trips(tuple(trips), charged, float(way[-1]))


def _series(after_ns: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(after_ns, kind="stable")
    return after_ns[order] / NANOSECONDS, values[order]


def _steps(time: np.ndarray) -> np.ndarray:
    """Steps of time, none across a pause."""
    steps = np.diff(time)
    return np.where(steps > LONGEST_PAUSE, 0.0, steps)


def stands(time: np.ndarray, speed: np.ndarray) -> Iterator[tuple[float, float]]:
    """Times in which the car stands for `LEAST_CHARGING` or longer, none across a pause."""
    still = speed < STANDING
    ends = np.flatnonzero((still[1:] != still[:-1]) | (np.diff(time) > LONGEST_PAUSE))
    begins = np.concatenate(([0], ends + 1))
    for begin, end in zip(begins, np.concatenate((ends, [time.size - 1])), strict=True):
        if still[begin] and time[end] - time[begin] >= LEAST_CHARGING:
            yield float(time[begin]), float(time[end])


def _charged(time: np.ndarray, power: np.ndarray, begin: float, end: float) -> float:
    """Energy into the battery between two times where its power is known, J."""
    inside = (time >= begin) & (time <= end) & np.isfinite(power)
    if inside.sum() < 2:
        return 0.0
    time, power = time[inside], power[inside]
    return -float((power[1:] + power[:-1]) @ _steps(time)) / 2
