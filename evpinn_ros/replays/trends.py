"""Trends over many drives of one car: consumption, rolling resistance and capacity.

Drives are grouped by week and by outside temperature, and weighted by their distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timedelta, timezone
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units
from evpinn_ros.replays.driven import measured_steps
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.vehicle_fit import capacity_by_charge
from evpinn_ros.signals.readings import NANOSECONDS

Group: TypeAlias = tuple[Any, str]  # what it is sorted by, and its name
LEAST_DISTANCE = 1000.0  # m of a drive that counts
LEAST_DRIVES = 3
BIN = 5.0  # degrees C
CAPACITY, ROLLING = "capacity of the battery, kWh", "rolling resistance, C_rr"


class TrendRow(NamedTuple):
    """Drives of a week or a temperature: their mean, weighted by distance, and its spread.

    Attributes:
        name: of the group.
        drives: how many.
        distance: of all, m.
        mean: of the quantity.
        spread: of single drives, 1-sigma; 0 of one.
    """

    name: str
    drives: int
    distance: float
    mean: float
    spread: float


class Trend(NamedTuple):
    """A quantity by groups of drives: its title, digits after the point, and a row a group."""

    title: str
    digits: int
    rows: tuple[TrendRow, ...]


class _Point(NamedTuple):
    """One drive: its week, its temperature, its distance, and quantities by their titles."""

    week: str | None
    celsius: float
    distance: float
    values: dict[str, float]


def trends(drives: Sequence[Drive], units: Units = METRIC) -> list[Trend]:
    """Trends with at least two groups, of at least `LEAST_DRIVES` drives; else none."""
    points = [point for drive in drives if (point := _point(drive, units))]
    if len(points) < LEAST_DRIVES:
        return []
    ways: list[tuple[str, Callable[[_Point], Group | None]]] = [
        ("by week", _week), ("by outside temperature", lambda one: _warmth(one, units)),
    ]  # fmt: skip
    quantities = ((f"consumption, {units.rate}", 1), (ROLLING, 4), (CAPACITY, 1))
    found = (
        Trend(f"{title} {way}", digits, tuple(_rows(points, title, group)))
        for title, digits in quantities
        for way, group in ways
    )
    return [trend for trend in found if len(trend.rows) > 1]


def _point(drive: Drive, units: Units) -> _Point | None:
    steps = measured_steps(drive)
    distance = float(steps.distance.sum())
    if distance < LEAST_DISTANCE:
        return None
    values = {
        f"consumption, {units.rate}": float(steps.energy.sum()) / distance / units.rate_joules
    }
    rolling = drive.final.parameters["c_rr"] if drive.final else None
    if rolling is not None and rolling.progress > 0.0 and rolling.possible:
        values[ROLLING] = rolling.value
    if (capacity := capacity_by_charge(drive)) is not None:
        values[CAPACITY] = capacity / JOULES_PER_KWH
    warm = float(np.mean(drive.temperature[:, 1])) if len(drive.temperature) else math.nan
    return _Point(_monday(drive) if drive.dated else None, warm, distance, values)


def _monday(drive: Drive) -> str:
    """Date of the Monday before."""
    day = datetime.fromtimestamp(drive.start_ns // NANOSECONDS, tz=timezone.utc)
    return f"{day - timedelta(days=day.weekday()):%Y-%m-%d}"


def _week(point: _Point) -> Group | None:
    return None if point.week is None else (point.week, f"week of {point.week}")


def _warmth(point: _Point, units: Units) -> Group | None:
    if math.isnan(point.celsius):
        return None
    low = BIN * math.floor(point.celsius / BIN)
    ends = (units.degrees * each + units.zero for each in (low, low + BIN))
    return low, " to ".join(f"{each:.0f}" for each in ends) + f" {units.temperature}"


def _rows(
    points: Iterable[_Point], title: str, group: Callable[[_Point], Group | None]
) -> list[TrendRow]:
    groups: dict[Group, list[_Point]] = {}
    for point in points:
        key = group(point)
        if key and title in point.values:
            groups.setdefault(key, []).append(point)
    return [_row(key[1], groups[key], title) for key in sorted(groups, key=lambda key: key[0])]


def _row(name: str, points: Sequence[_Point], title: str) -> TrendRow:
    weight = np.array([point.distance for point in points])
    value = np.array([point.values[title] for point in points])
    mean = float(weight @ value / weight.sum())
    spread = math.sqrt(float(weight @ (value - mean) ** 2 / weight.sum()))
    return TrendRow(name, len(points), float(weight.sum()), mean, spread)
