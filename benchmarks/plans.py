"""Scores forecasts of plans that are made of driven trips.

Each drive of a car becomes plans of several resolutions with exact mean speeds, times and climbs.
Each plan is forecast from what the drives before it taught, at the mean temperature of the drive
and with its loads unknown; if the car reports heating and cooling, again with their mean given.
The baselines are the vehicle file alone, the energy per kilometre of the drives before, the same
by mean speed, and a forecast with even speed between two points. Drives are also scored by class
of mean speed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, product
import math

import numpy as np

from benchmarks.unseen.drives import UnseenCar, UnseenDrive, load_car
from benchmarks.unseen.scores import QUANTILE_90, crps
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Legs, Plan, PlanError, plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel, Weather
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.learner import gate_interval
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.signals.interval import Interval

CARS = ("i3", "i3_speed", "e208", "leaf2013", "changchun", "three_wheeler")
RESOLUTIONS = ("1 s", "10 s", "60 s", "200 m", "500 m", "2000 m", "trip")
METHODS = (
    *("forecast", "loads given", "vehicle file", "even speed"),
    *("per km", "per km by speed"),
)
CLASSES = {
    "all": (0.0, math.inf),
    "< 30": (0.0, 30.0),
    "30-50": (30.0, 50.0),
    "50-70": (50.0, 70.0),
    "> 70": (70.0, math.inf),
}  # limits of a drive's mean speed, km/h
LEAST_DISTANCE = 1000.0  # m of a drive that is a plan
SPEED_CLASS = 5.0  # m/s, of consumption by mean speed


@dataclass(frozen=True, slots=True)
class PlannedDrive:
    """A drive as a plan by one method: km/h and J; sigma NaN where the method has none."""

    resolution: str
    method: str
    speed: float
    forecast: float
    sigma: float
    measured: float
    gross: float


@dataclass(frozen=True, slots=True)
class PlanScore:
    """Scores of a car's drives of one class of speed, `CLASSES`, in percent."""

    car: str
    speeds: str
    resolution: str
    method: str
    drives: int
    bias: float
    median: float
    mean: float
    crps: float
    covered: float
    width: float


PLAN_COLUMNS = (
    ("car", "{0.car}"),
    ("km/h", "{0.speeds}"),
    ("plan", "{0.resolution}"),
    ("method", "{0.method}"),
    ("drives", "{0.drives}"),
    ("bias %", "{0.bias:+.1f}"),
    ("median; mean %", "{0.median:.1f}; {0.mean:.1f}"),
    ("CRPS, % of gross", "{0.crps:.2f}"),
    ("in 90 %", "{0.covered:.0f}"),
    ("width %", "{0.width:.0f}"),
)


def plan_scores(data: str, key: str, seed: int = 0) -> list[PlanScore]:
    """Score every drive of a car as plans, forecast from what the drives before it taught."""
    car = load_car(data, key)
    rows = list(_planned(car, seed))
    scores = []
    for speeds, resolution, method in product(CLASSES, RESOLUTIONS, METHODS):
        forecasts = [
            row
            for row in rows
            if (row.resolution, row.method) == (resolution, method)
            and CLASSES[speeds][0] <= row.speed < CLASSES[speeds][1]
        ]
        if forecasts:
            scores.append(_score(key, speeds, forecasts))
    return scores


def _planned(car: UnseenCar, seed: int) -> Iterator[PlannedDrive]:
    learned = LearnedCar.new(Equation(car.vehicle, seed))
    new = learned.model()
    before: list[tuple[float, float, float]] = []  # energy J, distance m, duration s
    for drive in car.drives:
        all_intervals = list(intervals_of(car, drive))
        if before:
            learned = learned.begin_drive()
        intervals = [interval for interval in all_intervals if not math.isnan(interval.energy)]
        driven = np.array([(e.energy, abs(e.distance), e.duration) for e in intervals])
        if not len(driven):
            continue
        totals = tuple(driven.sum(0).tolist())
        if before and totals[1] >= LEAST_DISTANCE:
            yield from forecasts(learned.model(), new, intervals, before)
        learned = learned.after(all_intervals)
        before.append((totals[0], totals[1], totals[2]))


def intervals_of(car: UnseenCar, drive: UnseenDrive) -> Iterator[Interval]:
    """Intervals of a drive that a car learns from."""
    return (
        interval for interval in drive.intervals(car.vehicle) if gate_interval(interval) is None
    )


def forecasts(
    model: CarModel,
    new: CarModel,
    intervals: list[Interval],
    before: list[tuple[float, float, float]],
) -> Iterator[PlannedDrive]:
    """A drive as plans of all resolutions, by all methods.

    Args:
        model: what the drives before taught.
        new: what the vehicle file says.
        intervals: intervals of the drive whose energy was measured.
        before: energy, J, distance, m, and duration, s, of each drive before.
    """
    measured = sum(interval.energy for interval in intervals)
    gross = sum(abs(interval.energy) for interval in intervals)
    speed = 3.6 * sum(abs(e.distance) for e in intervals) / sum(e.duration for e in intervals)
    weather, loaded = weather_of(intervals), weather_of(intervals, loads=True)
    ways: dict[str, tuple[CarModel, Weather, bool | None]]
    ways = {"forecast": (model, weather, None), "vehicle file": (new, weather, None)}
    if loaded.heating is not None:
        ways["loads given"] = model, loaded, None
    ways["even speed"] = model, weather, True
    for resolution in RESOLUTIONS:
        try:
            plan = plan_of(intervals, resolution)
        except PlanError:
            continue
        for method, (car, around, steady) in ways.items():
            forecast = forecast_plan(plan, PowerModel(car), around, steady=steady)
            energy, sigma = float(forecast.energy[-1]), float(forecast.sigma[-1])
            yield PlannedDrive(resolution, method, speed, energy, sigma, measured, gross)
    for method, energy in _by_distance(before, intervals):
        yield PlannedDrive("trip", method, speed, energy, math.nan, measured, gross)


def weather_of(intervals: list[Interval], *, loads: bool = False) -> Weather:
    """Mean temperature of a drive and, with `loads`, mean of its reported loads."""
    known = [interval for interval in intervals if interval.conditions.celsius is not None]
    celsius = _mean(known, "celsius") if known else None
    reported = loads and any(interval.conditions.load > 0.0 for interval in intervals)
    return Weather(
        _mean(intervals, "air_density"), celsius, _mean(intervals, "load") if reported else None
    )


def plan_of(intervals: list[Interval], resolution: str) -> Plan | Legs:
    """A drive as a plan: of points each second, else of legs.

    Raises:
        PlanError: it cannot be driven.
    """
    return _Steps.of(intervals).plan(resolution)


def _mean(intervals: list[Interval], name: str) -> float:
    """Mean of a condition over time."""
    values = [getattr(interval.conditions, name) for interval in intervals]
    return float(np.average(values, weights=[interval.duration for interval in intervals]))


def _by_distance(
    before: list[tuple[float, float, float]], intervals: list[Interval]
) -> Iterator[tuple[str, float]]:
    energy, distance, duration = np.array(before).T
    length = sum(abs(interval.distance) for interval in intervals)
    yield "per km", float(length * energy.sum() / distance.sum())
    speed = length / sum(interval.duration for interval in intervals)
    alike = np.abs(distance / duration - speed) <= SPEED_CLASS
    if not alike.any():
        alike[:] = True
    yield "per km by speed", float(length * energy[alike].sum() / distance[alike].sum())


@dataclass(frozen=True, slots=True)
class _Steps:
    """Steps of a drive as columns: s, m, m^2/s^2, m; whether height is known, 0 where not.

    `piece` numbers the pieces of the drive without a gap.
    """

    duration: np.ndarray
    distance: np.ndarray
    kinetic: np.ndarray
    climb: np.ndarray
    known: np.ndarray
    piece: np.ndarray

    @classmethod
    def of(cls, intervals: list[Interval]) -> _Steps:
        duration, distance, kinetic, climb = (
            np.concatenate([getattr(interval.steps, name) for interval in intervals])
            for name in ("duration", "distance", "kinetic", "climb")
        )
        counts = [len(interval.steps.duration) for interval in intervals]
        known = np.repeat([float(interval.height_known) for interval in intervals], counts)
        gaps = [before.end_ns != after.start_ns for before, after in pairwise(intervals)]
        piece = np.repeat(np.cumsum([0, *gaps]), counts)
        return cls(duration, np.abs(distance), kinetic, climb, known, piece)

    def plan(self, resolution: str) -> Plan | Legs:
        """The plan of one of `RESOLUTIONS`."""
        if resolution == "1 s":
            return self._dense()
        owner = np.zeros(len(self.duration), np.int64)
        if resolution != "trip":
            size, unit = resolution.split()
            along = np.cumsum(self.duration if unit == "s" else self.distance)
            owner = np.maximum((along - 1e-9) // float(size), 0.0).astype(np.int64)
        count = int(owner[-1]) + 1
        sums = [
            np.bincount(owner, column, count)
            for column in (self.duration, self.distance, self.climb, self.distance * self.known)
        ]
        duration, length, climb, seen = (total[sums[0] > 0.0] for total in sums)
        climb = np.clip(climb, -length, length)
        return Legs(length, duration, climb, seen > length / 2.0)

    def _dense(self) -> Plan:
        """Points at the ends of the steps, speeds by their kinetic energy."""
        time, distance, height = (
            np.concatenate(([0.0], np.cumsum(column)))
            for column in (self.duration, self.distance, self.climb)
        )
        speed = self._speeds(self.piece == 0)
        for number in range(1, int(self.piece[-1]) + 1):
            after = self._speeds(self.piece == number)
            speed = np.concatenate((speed[:-1], (speed[-1:] + after[:1]) / 2.0, after[1:]))
        steep = np.clip(np.diff(height), -self.distance, self.distance)
        height = np.concatenate(([0.0], np.cumsum(steep)))
        heights = height if self.known.any() else None
        plan = plan_from_speed_profile(time, distance, speed, heights)
        return replace(plan, commanded=True)  # it was driven so

    def _speeds(self, own: np.ndarray) -> np.ndarray:
        """Speeds at the ends of the steps of a piece, by their kinetic energy and mean speeds."""
        square = np.concatenate(([0.0], 2.0 * np.cumsum(self.kinetic[own])))
        mean = self.distance[own] / self.duration[own]
        start = max(float(np.mean(mean**2 - (square[1:] + square[:-1]) / 2.0)), -square.min())
        return np.asarray(np.sqrt(np.maximum(start + square, 0.0)))


def _score(car: str, speeds: str, rows: list[PlannedDrive]) -> PlanScore:
    error = np.array([row.forecast - row.measured for row in rows])
    measured, gross = (np.array([getattr(row, n) for row in rows]) for n in ("measured", "gross"))
    sigma = np.array([row.sigma for row in rows])
    share = 100.0 * np.abs(error / measured)
    scores = [crps(e, 0.0 if math.isnan(s) else s) for e, s in zip(error, sigma, strict=True)]
    return PlanScore(
        car=car,
        speeds=speeds,
        resolution=rows[0].resolution,
        method=rows[0].method,
        drives=len(rows),
        bias=float(100.0 * error.sum() / measured.sum()),
        median=float(np.median(share)),
        mean=float(np.mean(share)),
        crps=float(np.mean(100.0 * np.array(scores) / gross)),
        covered=float(100.0 * np.mean(np.abs(error) <= QUANTILE_90 * sigma)),
        width=float(np.median(200.0 * QUANTILE_90 * sigma / gross)),
    )
