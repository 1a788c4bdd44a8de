"""Distance to empty over driven roads: how far would the energy of the next kilometres have led?

All drives of a car are one road, in pieces of a kilometre. After each, the energy that the next
10, 20 and 40 km took is what is left in the battery; the answer is compared with the road driven.
Beside it stand that energy over what the last 10 km cost, and over what the last 100 km cost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from benchmarks.plans import intervals_of
from benchmarks.unseen.drives import UnseenCar, load_car
from evpinn_ros.energy.charge import Uncertain
from evpinn_ros.energy.remaining import Cost, cost_spread, remaining
from evpinn_ros.energy.trip import Stretch, TripLog
from evpinn_ros.energy.usual import usual_cost
from evpinn_ros.estimation.car import LearnedCar
from evpinn_ros.estimation.terms import equation_of

HORIZONS = (10e3, 20e3, 40e3)  # m
PIECE = 1e3  # m
LAST_10, LAST_100 = 1, 2  # windows of a `TripLog`


class Kilometre(NamedTuple):
    """A kilometre, and what a summary knew at its end; the cost None before 10 km."""

    driven: Stretch
    cost: Cost | None
    recent: float
    long: float


@dataclass(frozen=True, slots=True)
class EmptyScore:
    """Errors of the distance to empty over one horizon, percent."""

    car: str
    horizon: float
    roads: int
    median: float
    by_last_10: float
    by_last_100: float
    covered: float


EMPTY_COLUMNS = (
    ("car", "{0.car}"),
    ("road, km", "{0.horizon:.0f}"),
    ("roads", "{0.roads}"),
    ("median %", "{0.median:.1f}"),
    ("by the last 10 km", "{0.by_last_10:.1f}"),
    ("by the last 100 km", "{0.by_last_100:.1f}"),
    ("in 90 %", "{0.covered:.0f}"),
)


def empty_scores(data: str, key: str, seed: int = 0) -> list[EmptyScore]:
    """Every kilometre of a car's drives, as if its battery lasted for the next ones."""
    pieces = list(_pieces(load_car(data, key), seed))
    found = []
    for horizon in HORIZONS:
        errors = list(_errors(pieces, horizon))
        if errors:
            ours, by_10, by_100, covered = 100.0 * np.array(errors, float).T
            medians = (float(np.median(np.abs(each))) for each in (ours, by_10, by_100))
            scores = *medians, float(covered.mean())
            found.append(EmptyScore(key, horizon / 1e3, len(errors), *scores))
    return found


def _pieces(car: UnseenCar, seed: int) -> Iterator[Kilometre]:
    learned, log = LearnedCar.new(equation_of(car.vehicle, seed)), TripLog()
    for number, drive in enumerate(car.drives):
        if number:
            learned = learned.begin_drive()
        distance = energy = 0.0
        for interval in intervals_of(car, drive):
            learned = learned.after([interval])
            if math.isnan(interval.energy):
                continue
            distance, energy = distance + abs(interval.distance), energy + interval.energy
            if distance >= PIECE:
                yield _piece(Stretch(distance, energy), log, learned)
                distance = energy = 0.0


def _piece(driven: Stretch, log: TripLog, learned: LearnedCar) -> Kilometre:
    for window in log.windows:
        window.add(driven)
    if not log.windows[LAST_10].known:
        return Kilometre(driven, None, math.nan, math.nan)
    recent, long = (
        each.energy / each.distance
        for each in (log.windows[LAST_10].total, log.windows[LAST_100].total)
    )
    spread = cost_spread(log.windows[LAST_100].whole)
    cost = Cost.ahead(recent, long, usual_cost(learned.model()), spread)
    return Kilometre(driven, cost, recent, long)


def _errors(pieces: list[Kilometre], horizon: float) -> Iterator[tuple[float, float, float, bool]]:
    """Relative errors after each piece: ours, by the last 10 km, by 100; is it in our band?"""
    distances = np.cumsum([piece.driven.distance for piece in pieces])
    energies = np.cumsum([piece.driven.energy for piece in pieces])
    for index, piece in enumerate(pieces):
        end = int(np.searchsorted(distances, distances[index] + horizon))
        if piece.cost is None or end >= len(pieces):
            continue
        driven = float(distances[end] - distances[index])
        left = float(energies[end] - energies[index])
        found = remaining(Uncertain(left, 0.0), piece.cost)
        if found is not None and left > 0.0:
            by_10, by_100 = (left / cost / driven - 1.0 for cost in (piece.recent, piece.long))
            inside = found.lower <= driven <= found.upper
            yield found.distance / driven - 1.0, by_10, by_100, inside
