"""Charts of a drive's road, and of its data coverage and errors by speed and acceleration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.common.units import Units
from evpinn_ros.replays.driven import DrivenSteps, rising
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.scoring import Span, known_at, longest_step, scored
from evpinn_ros.report.drive_charts import KILO, Chart
from evpinn_ros.report.thinning import packed

HALF_SPAN = 0.5  # s on each side over which acceleration is a difference of speeds
ACCELERATION_CELL, ACCELERATION_AXIS = 0.25, "acceleration, m/s²"
LARGEST_SPEED, LARGEST_ACCELERATION = 300.0 / 3.6, 5.0  # m/s, m/s^2; larger ones are clipped
LEAST = 1.0  # s in a cell or bin from which on its error is shown
DEGREE = 111_195.0  # m per degree of latitude
ROUTE_POINTS = 500  # at most, evenly along the road
POINTS = 2500  # most moments that `spread_chart` shows
HARD = 0.5  # m/s^2, above which inertia outweighs road load and auxiliaries
FAST_SPEED, SLOW_SPEED = 80.0 / 3.6, 5.0 / 3.6  # m/s: drag shows above, auxiliary power below


class MeasuredMoments(NamedTuple):
    """Moments whose power was measured; arrays of shape (n,)."""

    time: np.ndarray  # s
    speed: np.ndarray  # m/s
    acceleration: np.ndarray  # m/s^2
    seconds: np.ndarray  # that each moment represents
    error: np.ndarray  # predicted minus measured power, kW


def moments(drive: Drive) -> MeasuredMoments:
    """The moments of `power/smoothed` at which the battery was measured."""
    series = drive.smoothed
    measured, is_measured = known_at(drive.measured, series.time)
    time, speed = rising(drive.speed).T
    if not len(time):
        return MeasuredMoments(*(np.empty(0) for _ in MeasuredMoments._fields))
    before, after = (np.interp(series.time + s, time, speed) for s in (-HALF_SPAN, HALF_SPAN))
    steps = np.clip(np.diff(series.time, append=np.nan), 0.0, longest_step(series.time))
    all_moments = MeasuredMoments(
        series.time,
        np.clip(np.interp(series.time, time, speed), -LARGEST_SPEED, LARGEST_SPEED),
        np.clip((after - before) / (2 * HALF_SPAN), -LARGEST_ACCELERATION, LARGEST_ACCELERATION),
        np.nan_to_num(steps),
        (series.power - measured) / KILO,
    )
    return chosen_rows(all_moments, is_measured & np.isfinite(all_moments.error))


def scored_moments(drive: Drive, driven: MeasuredMoments, warm_up: float) -> MeasuredMoments:
    """The moments that are scored."""
    counted = drive.smoothed.time[scored(drive, drive.smoothed, Span(warm_up, drive.duration))]
    return chosen_rows(driven, np.isin(driven.time, counted))


def driven_minutes(driven: MeasuredMoments) -> dict[str, float]:
    """Minutes of the driving that determines each identifiable combination."""
    hard = np.abs(driven.acceleration) > HARD
    kinds = {
        "mass_over_eta": hard,
        "drag_area_over_eta": driven.speed > FAST_SPEED,
        "c_rr": (driven.speed > SLOW_SPEED) & (driven.speed <= FAST_SPEED) & ~hard,
        "regeneration": driven.acceleration < -HARD,
        "p_aux": np.abs(driven.speed) <= SLOW_SPEED,
    }
    return {name: float(driven.seconds[kind].sum()) / 60 for name, kind in kinds.items()}


def route_map(drive: Drive, steps: DrivenSteps, units: Units) -> Chart:
    """Map of the road, from its start, with mean measured power, kW."""
    rows = rising(drive.position)
    lengths = np.array([np.cos(np.radians(rows[:, 1].mean())), 1.0]) * DEGREE / units.metres
    road = (rows[:, [2, 1]] - rows[0, [2, 1]]) * lengths
    along = np.cumsum(np.hypot(*np.diff(road, axis=0, prepend=road[:1]).T))
    chosen = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], ROUTE_POINTS)))
    time, (east, north) = rows[chosen, 0], road[chosen].T
    spent, measured = (
        np.diff(np.interp(time, steps.end, np.cumsum(amounts)), prepend=np.nan)
        if len(steps.end)
        else np.full(len(time), np.nan)
        for amounts in (steps.energy, steps.seconds)
    )
    power = np.divide(spent / KILO, measured, out=np.full(len(time), np.nan), where=measured > 0)
    return {
        "kind": "route",
        "axes": [f"east, {units.distance}", f"north, {units.distance}"],
        "full": _full(power, 0.95),
        "time": packed(time),
        "east": packed(east),
        "north": packed(north),
        "power": packed(power),
    }


def coverage_map(driven: MeasuredMoments, units: Units) -> Chart:
    """Seconds in each cell of speed and acceleration."""
    cells, shape = _cells(driven, units)
    seconds = np.bincount(cells, driven.seconds, minlength=shape[0] * shape[1])
    return _map_chart("seconds", np.where(seconds > 0, seconds, np.nan), shape, 1.0, units)


def error_map(driven: MeasuredMoments, units: Units) -> Chart:
    """Mean error of predicted power in each cell, kW."""
    cells, shape = _cells(driven, units)
    count = shape[0] * shape[1]
    seconds = np.bincount(cells, driven.seconds, minlength=count)
    error = np.bincount(cells, driven.seconds * driven.error, minlength=count)
    enough = seconds >= LEAST
    mean = np.divide(error, seconds, out=np.full(count, np.nan), where=enough)
    return _map_chart("error", mean, shape, 0.95, units)


def spread_chart(driven: MeasuredMoments, against: str, units: Units) -> Chart:
    """Errors over `speed` or `acceleration`: quantiles of each bin, and single moments."""
    if against == "speed":
        at, cell, axis = driven.speed * units.speeds, units.speed_step / 2, f"speed, {units.speed}"
    else:
        at, cell, axis = driven.acceleration, ACCELERATION_CELL, ACCELERATION_AXIS
    bins = np.round(at / cell).astype(np.int64)
    rows = []
    for index in np.unique(bins):
        inside = bins == index
        if driven.seconds[inside].sum() >= LEAST:
            rows.append([index * cell, *np.quantile(driven.error[inside], (0.05, 0.5, 0.95))])
    chosen = np.unique(np.linspace(0, len(at) - 1, min(POINTS, len(at))).astype(int))
    return {
        "kind": "spread",
        "axes": [axis, "error, kW"],
        "bins": np.array(rows).reshape(-1, 4).round(4).tolist(),
        "x": packed(at[chosen]),
        "y": packed(driven.error[chosen]),
    }


def _cells(driven: MeasuredMoments, units: Units) -> tuple[np.ndarray, tuple[int, int]]:
    half = round(LARGEST_ACCELERATION / ACCELERATION_CELL)
    speed = driven.speed * units.speeds / (units.speed_step / 2)
    i = np.maximum(np.floor(speed), 0).astype(np.int64)
    j = np.floor(driven.acceleration / ACCELERATION_CELL + 0.5).astype(np.int64) + half
    shape = (int(i.max(initial=0)) + 1, 2 * half + 1)
    return i * shape[1] + j, shape


def _map_chart(
    of: str, values: np.ndarray, shape: tuple[int, int], share: float, units: Units
) -> Chart:
    """A map whose colour is full from the quantile `share` of the absolute values on."""
    return {
        "kind": "cells",
        "of": of,
        "full": _full(values, share),
        "axes": [f"speed, {units.speed}", ACCELERATION_AXIS],
        "cell": [units.speed_step / 2, ACCELERATION_CELL],
        "first": [0.0, -LARGEST_ACCELERATION - ACCELERATION_CELL / 2],
        "shape": list(shape),
        "values": packed(values),
    }


def _full(values: np.ndarray, share: float) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return max(float(np.quantile(finite, share)), 1e-9) if len(finite) else 1.0
