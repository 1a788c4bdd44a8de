"""Scores the distance to empty on driven roads.

All drives of a car are one road, in pieces of a kilometre. After each piece, the battery is
assumed to hold the energy that the next 10, 20 or 40 km took, and the distance to empty is
compared with that distance. The baselines divide that energy by the consumption of the last 10 and
100 km. The distance to empty along a route uses the rest of the drive as a plan, as planners send
it: points every 500 m with mean speeds between them, from the car's speed, at the mean
temperature, with loads unknown. It is scored only within a drive: no plan knows of a night's stop.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np

from benchmarks.plans import intervals_of, plan_of, weather_of
from benchmarks.unseen.drives import UnseenCar, load_car
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Plan, PlanError, points_of
from evpinn_ros.core.energy.power_model import PowerModel
from evpinn_ros.core.energy.remaining import (
    Cost,
    Route,
    RouteAhead,
    cost_spread,
    remaining,
    usual_cost,
)
from evpinn_ros.core.energy.trip import Stretch, TripLog
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.interval import Interval

HORIZONS = (10e3, 20e3, 40e3)  # m
PIECE = 1e3  # m
LAST_10, LAST_100 = 1, 2  # windows of a `TripLog`


class Kilometre(NamedTuple):
    """A kilometre of a drive, and what was known at its end."""

    drive: int
    driven: Stretch
    intervals: tuple[Interval, ...]
    model: CarModel
    cost: Cost | None  # None before 10 km
    recent: float  # J/m of the last 10 km
    long: float  # J/m of the last 100 km


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
    routes: int
    along_route: float
    without_route: float
    route_covered: float


EMPTY_COLUMNS = (
    ("car", "{0.car}"),
    ("road, km", "{0.horizon:.0f}"),
    ("roads", "{0.roads}"),
    ("median %", "{0.median:.1f}"),
    ("by the last 10 km", "{0.by_last_10:.1f}"),
    ("by the last 100 km", "{0.by_last_100:.1f}"),
    ("in 90 %", "{0.covered:.0f}"),
    ("roads in one drive", "{0.routes}"),
    ("along a route; without", "{0.along_route:.1f}; {0.without_route:.1f}"),
    ("in its 90 %", "{0.route_covered:.0f}"),
)


def empty_scores(data: str, key: str, seed: int = 0) -> list[EmptyScore]:
    """Score the distance to empty after every kilometre of a car's drives."""
    pieces = list(_pieces(load_car(data, key), seed))
    ahead = [_along_route(pieces, index) for index in range(len(pieces))]
    scores = []
    for horizon in HORIZONS:
        errors = list(_errors(pieces, ahead, horizon))
        if errors:
            ours, by_10, by_100, covered, route, on_it = 100.0 * np.array(errors, float).T
            known = np.isfinite(route)
            score = EmptyScore(
                car=key,
                horizon=horizon / 1e3,
                roads=len(errors),
                median=_median(ours),
                by_last_10=_median(by_10),
                by_last_100=_median(by_100),
                covered=float(covered.mean()),
                routes=int(known.sum()),
                along_route=_median(route[known]),
                without_route=_median(ours[known]),
                route_covered=float(on_it[known].mean()) if known.any() else math.nan,
            )
            scores.append(score)
    return scores


def _median(errors: np.ndarray) -> float:
    """Median of the sizes of errors; NaN without any."""
    return float(np.median(np.abs(errors))) if errors.size else math.nan


def _pieces(car: UnseenCar, seed: int) -> Iterator[Kilometre]:
    learned, log = LearnedCar.new(equation_of(car.vehicle, seed)), TripLog()
    for number, drive in enumerate(car.drives):
        if number:
            learned = learned.begin_drive()
        measured_intervals: list[Interval] = []
        for interval in intervals_of(car, drive):
            learned = learned.after([interval])
            if math.isnan(interval.energy):
                continue
            measured_intervals.append(interval)
            distance = sum(abs(step.distance) for step in measured_intervals)
            if distance >= PIECE:
                driven = Stretch(distance, sum(step.energy for step in measured_intervals))
                yield _piece(number, driven, tuple(measured_intervals), log, learned.model())
                measured_intervals = []


def _piece(
    drive: int, driven: Stretch, intervals: tuple[Interval, ...], log: TripLog, model: CarModel
) -> Kilometre:
    for window in log.windows:
        window.extend(*(np.array([part]) for part in driven))
    if not log.windows[LAST_10].known:
        return Kilometre(drive, driven, intervals, model, None, math.nan, math.nan)
    recent, long = (
        stretch.energy / stretch.distance
        for stretch in (log.windows[LAST_10].total, log.windows[LAST_100].total)
    )
    spread = cost_spread(log.windows[LAST_100].whole)
    cost = Cost.ahead(recent, long, usual_cost(model), spread)
    return Kilometre(drive, driven, intervals, model, cost, recent, long)


def _along_route(pieces: list[Kilometre], index: int) -> RouteAhead | None:
    """The rest of the drive after a piece as a route; None at its end, and without a cost."""
    here, after = pieces[index], pieces[index + 1 :]
    measured_intervals = [
        interval for piece in after if piece.drive == here.drive for interval in piece.intervals
    ]
    if here.cost is None or not measured_intervals:
        return None
    try:
        route, start = (
            points_of(plan_of(measured_intervals, "500 m")),
            plan_of(measured_intervals, "1 s"),
        )
    except PlanError:
        return None
    assert isinstance(start, Plan), "its speeds are those driven"
    route = replace(route, speed=np.append(start.speed[:1], route.speed[1:]))
    forecast = forecast_plan(route, PowerModel(here.model), weather_of(measured_intervals))
    assert forecast.curve is not None, "it is one trip"
    return Route.from_here(forecast.curve, 0.0, 0).ahead(0.0, here.cost)


def _errors(
    pieces: list[Kilometre], ahead: list[RouteAhead | None], horizon: float
) -> Iterator[tuple[float, float, float, bool, float, bool]]:
    """Yields, after each piece, relative errors of the distance and whether bands cover it.

    The errors are ours, by the last 10 km and by the last 100 km; then whether our band covers
    the distance; the error along the route, NaN if the road ends in another drive; and whether
    the route's band covers it.
    """
    distances = np.cumsum([piece.driven.distance for piece in pieces])
    energies = np.cumsum([piece.driven.energy for piece in pieces])
    for index, (piece, route) in enumerate(zip(pieces, ahead, strict=True)):
        end = int(np.searchsorted(distances, distances[index] + horizon))
        if piece.cost is None or end >= len(pieces):
            continue
        driven = float(distances[end] - distances[index])
        left = float(energies[end] - energies[index])
        span, by_route, on_it = remaining(Uncertain(left, 0.0), piece.cost), math.nan, False
        if span is None or left <= 0.0:
            continue
        by_10, by_100 = (left / cost / driven - 1.0 for cost in (piece.recent, piece.long))
        if route is not None and pieces[end].drive == piece.drive:
            along = remaining(Uncertain(left, 0.0), route)
            if along is not None:
                by_route = along.distance / driven - 1.0
                on_it = along.lower <= driven <= along.upper
        inside = span.lower <= driven <= span.upper
        yield span.distance / driven - 1.0, by_10, by_100, inside, by_route, on_it
