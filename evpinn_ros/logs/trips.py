"""Joins logs split into several files, and splits the logs of a day into trips.

A file that begins within `LONGEST_PAUSE` of the end of another continues it. A trip ends if speed
is missing or the car stands for that time, and at charging: a stop of `LEAST_CHARGING` that takes
over `CHARGING_POWER`. Consecutive drives shorter than `LEAST_DISTANCE` form one trip; if their sum
is shorter too, they belong to the trip before or after them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import groupby, pairwise
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
EDGE = 30.0  # s of standing before and after a trip that belong to it
LEAST_DISTANCE = 500.0  # m; shorter ones are manoeuvres
MANOEUVRE = 50.0  # m, for a log without a longer drive


class Span(NamedTuple):
    """Start and end of a drive between two stops, ns, and its length, m."""

    begin_ns: float
    end_ns: float
    distance: float


class Trip(NamedTuple):
    """Drives of a trip: one of at least `LEAST_DISTANCE`, or several short ones."""

    spans: tuple[Span, ...]

    @property
    def distance(self) -> float:
        """Length of all drives, m."""
        return sum(span.distance for span in self.spans)

    @property
    def note(self) -> str:
        """Sentence on short drives that form one trip; empty for a single drive."""
        if max(span.distance for span in self.spans) >= LEAST_DISTANCE:
            return ""
        return (
            f"{len(self.spans)} drives of less than {LEAST_DISTANCE:.0f} m, "
            f"{self.distance / 1e3:.1f} km together, are one trip"
        )


class Axis(NamedTuple):
    """Continuous time where the stamps of a log go back: a clock was set, or restarted.

    Attributes:
        begins: indices of the readings before which stamps go back, shape (n,).
        offsets: ns to add to stamps before the first of these, and after each, shape (n + 1,).
    """

    begins: np.ndarray
    offsets: np.ndarray

    def moments(self, block: Block, first: int) -> np.ndarray:
        """Continuous stamps, ns, of a block; `first` is the index of its first reading."""
        parts = np.searchsorted(self.begins, first + np.arange(block.length), side="right")
        return np.asarray(block.stamps() + self.offsets[parts])


class Trips(NamedTuple):
    """Trips of a log, in order."""

    trips: tuple[Trip, ...]
    axis: Axis  # time axis of their spans
    charged: float = 0.0  # J charged into the battery between trips
    distance: float = 0.0  # m, of the whole log


class JoinedLog(Source):
    """Files of one drive, in order."""

    def __init__(self, files: Sequence[Source]) -> None:
        super().__init__(files[0].path, files[0])
        self._files = files

    @property
    def seconds(self) -> float | None:
        """Total length of the files, without the pauses between them, s."""
        lengths = [file.seconds for file in self._files]
        return sum(filter(None, lengths)) if all(lengths) else None

    @property
    def problem(self) -> str | None:
        """Damage of the files."""
        return "; ".join(file.problem for file in self._files if file.problem) or None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on all files, each once."""
        return tuple(dict.fromkeys(note for file in self._files for note in file.notes))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Doubts about all files, each once."""
        return tuple(dict.fromkeys(doubt for file in self._files for doubt in file.doubts))

    def read(self) -> Iterator[Block]:
        """The readings of all files in order."""
        for file in self._files:
            yield from file.blocks()
        self.dropped.clear()
        for file in self._files:
            self.dropped.update(file.dropped)


def joined(logs: Sequence[Source]) -> list[Source]:
    """The logs, joined if both dates are known and the pause between them ends no trip."""
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
    """First and last stamp of a table with a known day, ns; None for other logs."""
    seconds = log.seconds
    if not log.rules or not log.dated or seconds is None:
        return None
    with suppress(InputError):
        if (first := next(log.blocks(), None)) is not None:
            begin_ns = int(first.stamps()[0])
            return begin_ns, begin_ns + round(seconds * NANOSECONDS)
    return None


class TripSource(Source):
    """One trip of a log with several."""

    def __init__(self, log: Source, number: int, trips: Trips) -> None:
        name = f"{log.path.name.partition('.')[0]}:{number}"
        super().__init__(log.path.with_name(name), log)
        self._log, self._trip, self._axis = log, trips.trips[number - 1], trips.axis
        self._last = number == len(trips.trips)
        stops = (after.begin_ns - span.end_ns for span, after in pairwise(self._trip.spans))
        self.stops_s = sum(stops) / NANOSECONDS

    @property
    def seconds(self) -> float | None:
        """Length of its drives, without the stops between them, s."""
        length_ns = sum(span.end_ns - span.begin_ns for span in self._trip.spans)
        return length_ns / NANOSECONDS if math.isfinite(length_ns) else None

    @property
    def problem(self) -> str | None:
        """Damage of the log, which follows its last trip; only that trip reports it."""
        return self._log.problem if self._last else None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on short drives; the last trip adds the log's, which is then fully read."""
        of_log = self._log.notes if self._last else ()
        return (self._trip.note, *of_log) if self._trip.note else of_log

    @property
    def doubts(self) -> tuple[str, ...]:
        """Doubts of the log, which hold for each of its trips."""
        return self._log.doubts

    def read(self) -> Iterator[Block]:
        """Readings of the trip in recorded order; losses of the log count with its last trip."""
        until = math.inf if self._last else self._trip.spans[-1].end_ns + STRAGGLING_NS
        first = 0
        for block in self._log.blocks():
            moments = self._axis.moments(block, first)
            first += block.length
            beyond = moments > until
            read = int(beyond.argmax()) if beyond.any() else block.length
            part = block.part(0, read)
            held = np.zeros(read, dtype=bool)
            for begin_ns, end_ns, _ in self._trip.spans:
                held |= (moments[:read] >= begin_ns) & (moments[:read] <= end_ns)
            inside = {kind: held[rows.order] for kind, rows in part.rows.items()}
            if len(trip := part.only(inside)):
                yield trip
            if read < block.length:
                break
        if self._last:
            self.dropped.update(self._log.dropped)


def split(
    log: Source, *, whole: bool = False, ahead: bool = True
) -> tuple[Sequence[Source], float]:
    """The trips of a log (one if `whole`), and J charged between; InputError: only charging.

    With `ahead`, the log keeps the blocks read so far for its next `blocks`.
    """
    trips = trips_of(log.read_ahead() if ahead else log.blocks())
    if trips.charged and trips.distance < MANOEUVRE:
        kwh = trips.charged / JOULES_PER_KWH
        raise InputError(f"{log.path}: no drive: the car stood and was charged with {kwh:.2f} kWh")
    if whole or len(trips.trips) < 2:
        return [log], 0.0
    count = len(trips.trips)
    return [TripSource(log, 1 + i, trips) for i in range(count)], trips.charged


def trips_of(blocks: Iterable[Block]) -> Trips:
    """Find the trips in readings in recorded order."""
    whole = joined_blocks(list(blocks))
    axis = _axis_of(whole)
    moments = axis.moments(whole, 0)
    speeds, battery = whole.of_kind(SpeedReading), whole.of_kind(BatteryReading)
    speeds = speeds.where(np.isfinite(speeds.values[0]))
    if len(speeds.stamps) < 2:
        return Trips((), axis)
    start_ns = int(moments[speeds.order[0]])
    time, fast = _series(moments[speeds.order] - start_ns, np.abs(speeds.values[0]))
    voltage, current = battery.values[:2]
    power = drawn_power(last_known(voltage), current)
    breaks, charged = _breaks(time, fast, *_series(moments[battery.order] - start_ns, power))
    way = np.concatenate(([0.0], np.cumsum((fast[1:] + fast[:-1]) / 2 * _steps(time))))
    spans = []
    for (_, begin), (end, _) in pairwise(breaks):
        inside = (time >= begin) & (time <= end)
        # Replay drops a lone speed after a pause, as its stamp is uncertain.
        if inside.sum() > 1 and (fast[inside] >= STANDING).any():
            far = float(np.interp(end, time, way) - np.interp(begin, time, way))
            begin_ns, end_ns = (start_ns + seconds * NANOSECONDS for seconds in (begin, end))
            spans.append(Span(begin_ns, end_ns, far))
    return Trips(tuple(_joined_spans(spans)), axis, charged, float(way[-1]))


def _axis_of(whole: Block) -> Axis:
    """Time axis of a log; stamps go back where two speeds are before both previous ones."""
    order, stamps, _ = whole.of_kind(SpeedReading)
    before = np.minimum(stamps[:-1], np.append(stamps[:1], stamps)[:-2])
    following = np.maximum(stamps, np.append(stamps[1:], stamps[-1:]))[1:]
    back = np.flatnonzero(following < before - STRAGGLING_NS) + 1
    steps = stamps[back - 1] - stamps[back] + STRAGGLING_NS
    return Axis(order[back], np.concatenate(([0], np.cumsum(steps))))


def _breaks(
    time: np.ndarray, fast: np.ndarray, battery_time: np.ndarray, power: np.ndarray
) -> tuple[list[tuple[float, float]], float]:
    """Intervals without a trip, s, and J charged into the battery in them."""
    breaks, charged = [(-math.inf, -math.inf)], 0.0
    pauses = np.flatnonzero(np.diff(time) > LONGEST_PAUSE)
    stops = zip(time[pauses].tolist(), time[pauses + 1].tolist(), strict=True)
    for begin, end in sorted([*stops, *stands(time, fast)]):
        taken = _charged(battery_time, power, begin, end)
        if taken > CHARGING_POWER * (end - begin) and end - begin >= LEAST_CHARGING:
            charged += taken
        elif end - begin < LONGEST_PAUSE:
            continue
        edge = min(EDGE, (end - begin) / 2)
        breaks.append((begin + edge, end - edge))
    return [*breaks, (math.inf, math.inf)], charged


def _joined_spans(spans: Iterable[Span]) -> list[Trip]:
    """Trips of all drives, each of `LEAST_DISTANCE` if any drives together are that long."""
    trips: list[Trip] = []
    waiting: tuple[Span, ...] = ()  # short drives, not assigned yet
    for is_short, group in groupby(spans, lambda span: span.distance < LEAST_DISTANCE):
        for drives in (tuple(group),) if is_short else ((span,) for span in group):
            if sum(span.distance for span in drives) >= LEAST_DISTANCE:
                trips.append(Trip((*waiting, *drives)))
                waiting = ()
            elif trips:
                trips[-1] = Trip((*trips[-1].spans, *drives))
            else:
                waiting = drives
    return trips


def _series(after_ns: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(after_ns, kind="stable")
    return after_ns[order] / NANOSECONDS, values[order]


def _steps(time: np.ndarray) -> np.ndarray:
    """Steps of time, without pauses."""
    steps = np.diff(time)
    return np.where(steps > LONGEST_PAUSE, 0.0, steps)


def stands(time: np.ndarray, speed: np.ndarray) -> Iterator[tuple[float, float]]:
    """Intervals, s, in which the car stands for `LEAST_CHARGING` or longer, without a pause."""
    still = speed < STANDING
    ends = np.flatnonzero((still[1:] != still[:-1]) | (np.diff(time) > LONGEST_PAUSE))
    begins = np.concatenate(([0], ends + 1))
    for begin, end in zip(begins, np.concatenate((ends, [time.size - 1])), strict=True):
        if still[begin] and time[end] - time[begin] >= LEAST_CHARGING:
            yield float(time[begin]), float(time[end])


def _charged(time: np.ndarray, power: np.ndarray, begin: float, end: float) -> float:
    """Energy into the battery between two times, where its power is known, J."""
    inside = (time >= begin) & (time <= end) & np.isfinite(power)
    if inside.sum() < 2:
        return 0.0
    time, power = time[inside], power[inside]
    return -float((power[1:] + power[:-1]) @ _steps(time)) / 2
