"""Finds stretches without measurements while the car moves, though each row has values.

If an adapter is lost, speed and battery freeze together. If an exporter fills the gap, both lie on
straight lines from the last row before it to the first one after it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from evpinn_ros.logs.quantities import PLACES
from evpinn_ros.logs.signal import LEAST_EVENTS, LONGEST_STEP, FloatArray, Signal

LEAST_LOST = 15.0  # s: an even road under cruise control looks the same for shorter times
LEAST_REPEATS = 10  # readings
ALONE = 2.0  # times a stretch: if speed or battery alone is constant for longer, it is steady
ALIVE = ("odometer", "elevation", "charge", *PLACES)  # change while the car is measured
MOST_LOST, USUALLY = 2, 0.5  # stretches, and share of moving readings: above, all repeats
WINDOW, HOP = 10.0, 5.0  # s: a stretch of `LEAST_LOST` contains a whole window
# Least change of a straight signal, in resolutions: real ones made a line of 9 for 13 s.
LEAST_STEPS = 20
ROUNDED = 1.0  # resolutions off a fitted line: half by rounding, half by the fit
FINEST = 1e-6  # of a value in SI units
SHORTEST_STEP = 0.01  # s

Points = tuple[FloatArray, FloatArray]


class Stand(NamedTuple):
    """A stretch in which a signal has one value, from its first point to its last."""

    first: int
    last: int
    begin: float  # s
    seconds: float
    value: float

    def holds(self, signal: Signal) -> Signal:
        """The part of another signal within the stretch."""
        inside = (signal.time >= self.begin) & (signal.time <= self.begin + self.seconds)
        return Signal(signal.time[inside], signal.value[inside])


def standing_together(signals: Mapping[str, Signal]) -> list[Stand]:
    """Stretches in which speed and battery are both constant while the car moves.

    Empty if that is usual for the drive.
    """
    points = _speed_and_battery(signals)
    if not points:
        return []
    time, speed = points[0]
    alive = (signals[name].points() for name in ALIVE if name in signals)
    changes = [at[1:][np.diff(value) != 0.0] for at, value in (*points, *alive)]
    gaps = np.flatnonzero(np.diff(time, append=np.inf) > LONGEST_STEP)
    ends = (time[:1], np.nextafter(time[gaps], np.inf), time[gaps[:-1] + 1])
    edges = np.unique(np.concatenate((*ends, *changes)))
    speed_changes, battery_changes = (
        np.unique(np.concatenate((edges[[0, -1]], *ends, *times)))
        for times in (changes[:1], changes[1 : len(points)])
    )
    stands: dict[tuple[float, ...], list[Stand]] = {}
    for at in np.flatnonzero(np.diff(edges) >= LEAST_LOST).tolist():
        begin, end = edges[at], edges[at + 1]
        firsts, lasts = zip(*(at.searchsorted((begin, end)) for at, _ in points), strict=True)
        inside = time[firsts[0] : lasts[0]]
        if min(np.subtract(lasts, firsts)) >= LEAST_REPEATS and speed[firsts[0]] != 0.0:
            key = tuple(
                float(value[first]) for first, (_, value) in zip(firsts, points, strict=True)
            )
            stand = Stand(firsts[0], lasts[0] - 1, begin, inside[-1] - begin, key[0])
            stands.setdefault(key, []).append(stand)
    # Values that recur to the last digit come from a simulated car.
    once = [alike[0] for alike in stands.values() if len(alike) == 1]
    lost = [
        stand
        for stand in once
        if max(_run(speed_changes, stand.begin), _run(battery_changes, stand.begin))
        <= ALONE * stand.seconds
    ]
    return lost if _are_unusual(lost, chain(*stands.values()), speed) else []


def straight_together(signals: Mapping[str, Signal]) -> list[Stand]:
    """Stretches in which speed and battery follow straight lines; empty if that is usual.

    A stretch ends before the first row that is measured again.
    """
    points = _speed_and_battery(signals)
    if not points:
        return []
    time, speed = points[0]
    lines = [Line.of(time, value) for time, value in points]
    filled, straight = [], []
    for begin, end in _straight_spans(lines):
        first, last = (int(row) for row in time.searchsorted((begin, end)) - (0, 2))
        if not speed[first : last + 1].any():
            continue
        stand = Stand(first, last, time[first], time[last] - time[first], speed[first])
        straight.append(stand)
        changes = min(lines[0].steps(begin, end), lines[-1].steps(begin, end)) >= LEAST_STEPS
        if changes and stand.seconds >= LEAST_LOST:
            filled.append(stand)
    return filled if _are_unusual(filled, straight, speed) else []


def measured_on(signals: Mapping[str, Signal], stand: Stand) -> set[str]:
    """Names of the `ALIVE` signals that a stretch does not replace by a straight line."""
    begin, end = stand.begin, stand.begin + stand.seconds
    alive = {name: signals[name].points() for name in ALIVE if name in signals}
    return {
        name
        for name, points in alive.items()
        if points[0].size and not Line.of(*points).holds(begin, end)
    }


class Line(NamedTuple):
    """A signal that may follow a straight line: its points and resolution."""

    time: FloatArray
    value: FloatArray
    resolution: float

    @classmethod
    def of(cls, time: FloatArray, value: FloatArray) -> Line:
        """The line of points in order of time, shape (n,) each."""
        apart = np.diff(np.unique(value))
        return cls(time, value, float(min(apart[apart > FINEST], default=FINEST)))

    def holds(self, begin: float, end: float) -> bool:
        """True if all points from `begin` to before `end` are on a line, without a gap."""
        first, last = self.time.searchsorted((begin, end))
        time, value = self.time[first:last], self.value[first:last]
        if time.size < LEAST_REPEATS or np.diff(time).max() > LONGEST_STEP:
            return False
        time, value = time - time.mean(), value - value.mean()
        spread = float(time @ time)
        slope = float(time @ value) / spread if spread else 0.0
        return bool(np.abs(value - slope * time).max() <= ROUNDED * self.resolution)

    def steps(self, begin: float, end: float) -> float:
        """Change between two moments, in resolutions."""
        first, last = self.time.searchsorted((begin, end))
        return float(np.ptp(self.value[first:last])) / self.resolution


def _straight_spans(lines: Sequence[Line]) -> Iterator[tuple[float, float]]:
    """Longest spans [begin, end), s, in which every signal follows a straight line."""
    time = lines[0].time
    step = max(SHORTEST_STEP, *(float(np.median(np.diff(line.time))) for line in lines))
    window = max(WINDOW, (LEAST_REPEATS + 1) * step)  # one cell may be missing
    row = 0
    while row < time.size and time[row] + window <= time[-1]:
        begin, end = time[row], time[row] + window
        following = begin + HOP
        if all(line.holds(begin, end) for line in lines):
            end = _extended(lines, begin, end, step, ahead=True)
            yield _extended(lines, begin, end, step, ahead=False), end
            following = end
        row = int(time.searchsorted(following))


def _extended(
    lines: Sequence[Line], begin: float, end: float, step: float, *, ahead: bool
) -> float:
    """The end of the longest span on lines that contains one; its start, unless `ahead`."""
    time, reach = lines[0].time, end - begin
    while reach > step / 4.0:
        wider = (begin, end + reach) if ahead else (begin - reach, end)
        is_in_drive = time[0] <= wider[0] and wider[1] <= time[-1] + step
        if is_in_drive and all(line.holds(*wider) for line in lines):
            begin, end = wider
        else:
            reach /= 2.0
    return end if ahead else begin


def _speed_and_battery(signals: Mapping[str, Signal]) -> list[Points]:
    """Points of speed, voltage and current, or speed and power; empty if any has too few."""
    pair = ("voltage", "current")
    names = ["speed", *(pair if signals.keys() >= set(pair) else signals.keys() & {"power"})]
    points = [signals[name].points() for name in names]
    enough = len(names) > 1 and min(at.size for at, _ in points) >= LEAST_REPEATS
    return points if enough else []


def _are_unusual(stands: Sequence[Stand], alike: Iterable[Stand], speed: FloatArray) -> bool:
    """True unless stands like these are most of a drive; `alike` contains all of them."""
    moving = np.count_nonzero(speed)
    still = sum(stand.last + 1 - stand.first for stand in alike)
    usual = len(stands) > MOST_LOST and still > USUALLY * moving
    return bool(not usual and moving - still >= LEAST_EVENTS)


def _run(changes: FloatArray, begin: float) -> float:
    """Length, s, of the stretch without a change that contains a moment."""
    after = int(changes.searchsorted(begin, side="right"))
    return float(changes[after] - changes[after - 1])
