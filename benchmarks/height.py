"""Breakdowns of recorded drives: without their heights, or learned alone, against more.

A recorded drive is learned from twice: as it is, and with its heights taken out. Every part of the
second breakdown has an interval, and the part that was found with height should lie in it. Each
drive begins at the vehicle file, as a stranger's only log does; the difference of two drives in a
row (`evpinn compare`) is checked in the same way. Or it is learned alone, and then with all drives
of its car, from which every part is known better.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from benchmarks.breakdown import PartCheck
from benchmarks.unseen.drives import UnseenCar, load_car
from evpinn_ros.core.estimation.breakdown import Breakdown, Breakdowns
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.terms import WHOLE, Part, equation_of
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.vehicle.files import Vehicle

CARS = ("i3", "leaf2013", "changchun")  # of `benchmarks.unseen.drives` those with heights
LEAST_DISTANCE = 2000.0  # m; of less no part is worth knowing
HEIGHT_KNOWN = 0.9  # of the way, of a drive that counts


def height_checks(data: str, cars: Sequence[str], drives: int) -> Iterator[PartCheck]:
    """Each part of drives of each car without heights, and of the differences of two in a row."""
    for key in cars:
        car = load_car(data, key)
        all_intervals = [list(drive.intervals(car.vehicle)) for drive in car.drives[:drives]]
        usable = [intervals for intervals in all_intervals if has_height(intervals)]
        for seed, intervals in enumerate(usable):
            yield from _checks(car, "alone", seed, [intervals])
        for seed, pair in enumerate(pairwise(usable)):
            yield from _checks(car, "difference", seed, pair)


def alone_checks(data: str, cars: Sequence[str], drives: int) -> Iterator[PartCheck]:
    """Each part of drives of each car, learned alone, against all of its drives."""
    for key in cars:
        car = load_car(data, key)
        all_intervals = [list(drive.intervals(car.vehicle)) for drive in car.drives[:drives]]
        usable = [
            intervals for intervals in all_intervals if _way(intervals).sum() > LEAST_DISTANCE
        ]
        whole = learned(car.vehicle, usable)
        for seed, intervals in enumerate(usable):
            true, alone = whole.of(seed), learned(car.vehicle, [intervals]).of(0)
            if true is not None and alone is not None:
                for part in Part:
                    yield _check(car.key, car.key, seed, part, true, alone)


def has_height(intervals: Sequence[Interval]) -> bool:
    """True if a drive is long enough, and its height known nearly all the way."""
    way = _way(intervals)
    known = np.array([interval.height_known for interval in intervals])
    return bool(way.sum() > LEAST_DISTANCE and way[known].sum() > HEIGHT_KNOWN * way.sum())


def _way(intervals: Sequence[Interval]) -> np.ndarray:
    return np.array([abs(interval.distance) for interval in intervals])


def without_height(interval: Interval) -> Interval:
    """Interval as of a log that has no heights."""
    flat = interval.steps._replace(climb=np.zeros_like(interval.steps.climb))
    return replace(interval, steps=flat, height_known=False)


def learned(vehicle: Vehicle, drives: Sequence[Sequence[Interval]]) -> Breakdowns:
    """Breakdowns of drives that one car learned from, to be compared."""
    car = LearnedCar.new(equation_of(vehicle))
    for number, intervals in enumerate(drives):
        car = car.begin_drive(compare=True) if number else car
        car = car.after(intervals)
    return car.breakdowns()


def _checks(
    car: UnseenCar, kind: str, seed: int, drives: Sequence[Sequence[Interval]]
) -> Iterator[PartCheck]:
    flat = [[without_height(interval) for interval in intervals] for intervals in drives]
    pair = [learned(car.vehicle, side) for side in (drives, flat)]
    if len(drives) == 1:
        true, without = (breakdowns.of(0) for breakdowns in pair)
    else:
        true, without = (breakdowns.difference(1, 0) for breakdowns in pair)
    if true is None or without is None:
        return
    for part in list(Part)[WHOLE]:
        yield _check(car.key, kind, seed, part, true, without)


def _check(
    car: str, kind: str, seed: int, part: Part, true: Breakdown, without: Breakdown
) -> PartCheck:
    amount = without.of(part)
    values = amount.kwh, amount.sigma_kwh, true.of(part).kwh, abs(without.total().kwh)
    return PartCheck(car, kind, seed, f"{kind}: {part.name.lower()}", *values)
