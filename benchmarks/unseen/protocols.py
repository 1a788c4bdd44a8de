"""Scoring of a method without the battery: one pass over a car's drives.

At the start of each drive a copy of the method predicts it whole without a battery reading
("carried"). The method itself then goes through the drive with the battery; at each cut a copy of
it goes on without ("withheld"). No copy ever gets a battery reading.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import copy
from dataclasses import dataclass

import numpy as np

from benchmarks.unseen.drives import UnseenCar, UnseenDrive
from benchmarks.unseen.lines import DrivePart
from benchmarks.unseen.method import Estimate, Factory, Method, Prediction
from benchmarks.unseen.scores import PartScore, Track, score_part
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

FIRST_CUT, CUT_STEP, DROPOUT, LONG_DROPOUT = 250.0, 50.0, 200.0, 600.0  # s
SPARSE_STEP, MANY_HOURS = 200.0, 0.5  # s between cuts of a car with more driving than this, h
SHORT_DRIVE = 100.0  # s; a drive too short for a dropout of 200 s is cut once, in the middle
WARM_UP = 120.0  # s of a drive whose online predictions are not scored
AFTER_END = 10.0  # s that a copy reads after the end, for predictions that lag
LEAST_DISTANCE = 100.0  # m; shorter drives are learned from, but not scored as carried


@dataclass(frozen=True)
class Cut:
    """Cut of the battery: its begin and its length, s."""

    begin: float
    length: float

    @property
    def span(self) -> DrivePart:
        """The part that is predicted."""
        return DrivePart(self.begin, self.begin + self.length)


@dataclass(frozen=True)
class ScoredPart:
    """A part of a drive that was predicted."""

    drive: str
    span: DrivePart
    score: PartScore


@dataclass(frozen=True)
class CarRun:
    """Results of a method on one car."""

    carried: list[ScoredPart]  # each drive whole, from what the drives before it taught
    online: list[ScoredPart]  # each drive with the battery, except for the first `WARM_UP` s
    withheld: list[ScoredPart]  # dropouts of 200 s (shorter in short drives)
    long: list[ScoredPart]  # dropouts of 600 s
    combinations: dict[str, Estimate]  # what is known of the car at the end


def cuts(drive: UnseenDrive, step: float) -> list[Cut]:
    """Dropouts of 200 s every `step` s from 250 s on, and of 600 s one after the other."""
    last = drive.duration - DROPOUT
    if last < FIRST_CUT:
        half = drive.duration / 2
        return [Cut(half, min(half, DROPOUT))] if drive.duration >= SHORT_DRIVE else []
    begins = list(np.arange(FIRST_CUT, last + 1e-6, step))
    if last - begins[-1] < step / 2 and len(begins) > 1:
        begins[-1] = np.floor(last)
    short = [Cut(float(begin), DROPOUT) for begin in begins]
    apart = np.arange(FIRST_CUT, drive.duration - LONG_DROPOUT, LONG_DROPOUT)
    return [*short, *(Cut(float(begin), LONG_DROPOUT) for begin in apart)]


def run_car(car: UnseenCar, factory: Factory, tell: Callable[[float], None]) -> CarRun:
    """Predict and learn all drives of a car in order; `tell` takes the share that is done."""
    method = factory(car.vehicle)
    run = CarRun([], [], [], [], {})
    step = SPARSE_STEP if car.hours > MANY_HOURS else CUT_STEP
    for number, drive in enumerate(car.drives):
        if number:
            method.begin_next_drive()
        if drive.distance >= LEAST_DISTANCE:
            whole = DrivePart(0.0, drive.duration)
            track = predicted(copy.deepcopy(method), drive, 0, whole, [])
            run.carried.append(ScoredPart(drive.name, whole, score_part(drive, track, whole)))
        planned = cuts(drive, step)
        for count, (part, scored) in enumerate(_through(method, drive, planned), start=1):
            getattr(run, part).append(scored)
            tell((number + count / (len(planned) + 1)) / len(car.drives))
    run.combinations.update(method.combinations())
    return run


def _through(
    method: Method, drive: UnseenDrive, planned: Sequence[Cut]
) -> Iterator[tuple[str, ScoredPart]]:
    """Run a drive with the battery; yields (field of `CarRun`, part) for dropouts and online."""
    waiting = sorted(planned, key=lambda cut: (cut.begin, -cut.length))
    rows: list[Prediction] = []
    track, begin = Track(drive, rows), -1.0
    readings = drive.readings if getattr(method, "pairs", False) else drive.paired
    seconds = np.maximum.accumulate([drive.seconds(r.stamp_ns) for r in drive.readings])
    first = 0
    for cut in waiting:
        index = int(np.searchsorted(seconds, cut.begin, side="right"))
        if index == len(seconds):
            break
        rows.extend(_predictions(method, readings[first:index]))
        first = index
        if cut.begin != begin:  # else the longer dropout from there includes the shorter
            track = predicted(copy.deepcopy(method), drive, index, cut.span, rows[-1:])
            begin = cut.begin
        part = "long" if cut.length == LONG_DROPOUT else "withheld"
        yield part, ScoredPart(drive.name, cut.span, score_part(drive, track, cut.span))
    rows.extend(_predictions(method, readings[first:]))
    rows.extend(_rest(method))
    if drive.duration > WARM_UP:
        span = DrivePart(WARM_UP, drive.duration)
        yield "online", ScoredPart(drive.name, span, score_part(drive, Track(drive, rows), span))


def predicted(
    method: Method, drive: UnseenDrive, index: int, span: DrivePart, before: Sequence[Prediction]
) -> Track:
    """Predict `span` from reading `index` on without any battery reading.

    `method` is a copy that this call changes; `index` is the first reading that it has not seen.
    `before` is the last prediction made with the battery, so that the start is covered.
    """
    rows = list(before)
    end_ns = drive.start_ns + int((span.end + AFTER_END) * NANOSECONDS)
    given: list[Reading] = []
    for reading in drive.readings[index:]:
        if isinstance(reading, SpeedReading) and reading.stamp_ns > end_ns:
            break
        if not isinstance(reading, BatteryReading):
            given.append(reading)
    rows.extend(_predictions(method, given))
    rows.extend(_rest(method))
    return Track(drive, rows)


def _rest(method: Method) -> Iterator[Prediction]:
    """The remaining predictions of a method that has `finish`."""
    finish = getattr(method, "finish", None)
    return iter(()) if finish is None else finish()


def _predictions(method: Method, readings: Sequence[Reading]) -> Iterator[Prediction]:
    """Predictions that readings complete; a method may return tuples or None.

    A method that has `add_readings` gets all readings at once.
    """
    at_once = getattr(method, "add_readings", None)
    if at_once is not None:
        yield from at_once(readings)
        return
    for reading in readings:
        for row in method.add_reading(reading) or ():
            yield row if isinstance(row, Prediction) else Prediction(*row)
