"""Compares breakdowns of recorded drives without heights, or learned alone, with better ones.

A recorded drive is learned twice: as it is, and without its heights. The part with heights should
lie in the interval of the part without. Each drive starts from the vehicle file, like the only log
of an unknown car; the difference of two successive drives (`evpinn compare`) is checked likewise.
Or a drive is learned alone, and compared with a breakdown learned from all drives of its car.
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
LEAST_DISTANCE = 2000.0  # m; shorter drives are left out
HEIGHT_KNOWN = 0.9  # share of the distance; drives with less are left out


def height_checks(data: str, cars: Sequence[str], drives: int) -> Iterator[PartCheck]:
    """Parts of each car's drives without heights, and of differences of successive drives."""
    for key in cars:
        car = load_car(data, key)
        all_intervals = [list(drive.intervals(car.vehicle)) for drive in car.drives[:drives]]
        usable = [intervals for intervals in all_intervals if has_height(intervals)]
        for seed, intervals in enumerate(usable):
            yield from _checks(car, "alone", seed, [intervals])
        for seed, pair in enumerate(pairwise(usable)):
            yield from _checks(car, "difference", seed, pair)


def alone_checks(data: str, cars: Sequence[str], drives: int) -> Iterator[PartCheck]:
    """Parts of each car's drives learned alone, against those learned from all its drives."""
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
    """Whether a drive is long enough, and its height known for nearly all of it."""
    way = _way(intervals)
    known = np.array([interval.height_known for interval in intervals])
    return bool(way.sum() > LEAST_DISTANCE and way[known].sum() > HEIGHT_KNOWN * way.sum())


def _way(intervals: Sequence[Interval]) -> np.ndarray:
    return np.array([abs(interval.distance) for interval in intervals])


def without_height(interval: Interval) -> Interval:
    """The interval as in a log without heights."""
    flat = interval.steps._replace(climb=np.zeros_like(interval.steps.climb))
    return replace(interval, steps=flat, height_known=False)


def learned(vehicle: Vehicle, drives: Sequence[Sequence[Interval]]) -> Breakdowns:
    """Breakdowns of drives by one car model that learned from all of them."""
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
