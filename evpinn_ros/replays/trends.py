"""Trends over drives of one car by week and by temperature, weighted by distance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timedelta, timezone
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.replays.driven import measured_steps
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.vehicle_fit import capacity_by_charge

Group: TypeAlias = tuple[Any, str]  # sort key and name
LEAST_DISTANCE = 1000.0  # m, shortest drive that counts
LEAST_DRIVES = 3
BIN = 5.0  # degrees C
CAPACITY, ROLLING = "capacity of the battery, kWh", "rolling resistance, C_rr"


class TrendRow(NamedTuple):
    """Drives of a week or a temperature: mean, weighted by distance, and spread."""

    name: str  # of the group
    drives: int  # number of drives
    distance: float  # of all drives, m
    mean: float  # of the quantity
    spread: float  # of single drives, 1-sigma; 0 for one drive


class Trend(NamedTuple):
    """A quantity by groups of drives: title, digits after the point, and one row per group."""

    title: str
    digits: int
    rows: tuple[TrendRow, ...]


class DrivePoint(NamedTuple):
    """Quantities of one drive for trends; None if unknown."""

    week: str | None  # date of its Monday
    ambient_c: float | None  # mean temperature outside, degrees C
    distance_m: float  # driven with the battery measured, m
    distance_energy_j: float  # energy over that distance, J
    rolling: float | None  # C_rr, if the drive determines it
    capacity_j: float | None  # of the battery, from charge and energy, J

    def quantities(self, units: Units) -> dict[str, float]:
        """Known quantities by the titles of their trends."""
        consumption = self.distance_energy_j / self.distance_m / units.rate_joules
        values = {f"consumption, {units.rate}": consumption}
        if self.rolling is not None:
            values[ROLLING] = self.rolling
        if self.capacity_j is not None:
            values[CAPACITY] = self.capacity_j / JOULES_PER_KWH
        return values


def trends(points: Sequence[DrivePoint], units: Units = METRIC) -> list[Trend]:
    """Trends with at least two groups; empty below `LEAST_DRIVES` drives."""
    if len(points) < LEAST_DRIVES:
        return []
    ways: list[tuple[str, Callable[[DrivePoint], Group | None]]] = [
        ("by week", lambda point: (point.week, f"week of {point.week}") if point.week else None),
        ("by outside temperature", lambda point: _warmth(point, units)),
    ]
    quantities = ((f"consumption, {units.rate}", 1), (ROLLING, 4), (CAPACITY, 1))
    candidates = (
        Trend(f"{title} {way}", digits, tuple(_rows(points, title, group, units)))
        for title, digits in quantities
        for way, group in ways
    )
    return [trend for trend in candidates if len(trend.rows) > 1]


def trend_metrics(drives: Iterable[Drive]) -> list[dict[str, Any]]:
    """Values of `--metrics` of several drives under `trends`: a row for each group."""
    points = [point for drive in drives if (point := drive_point(drive)) is not None]
    return [
        {
            "trend": trend.title,
            "group": row.name,
            "drives": row.drives,
            "distance_m": row.distance,
            "mean": row.mean,
            "spread": row.spread,
        }
        for trend in trends(points)
        for row in trend.rows
    ]


def drive_point(drive: Drive) -> DrivePoint | None:
    """The point of a drive; None if shorter than `LEAST_DISTANCE`."""
    steps = measured_steps(drive)
    distance = float(steps.distance.sum())
    if distance < LEAST_DISTANCE:
        return None
    rolling = drive.final.parameters["c_rr"] if drive.final else None
    shown = rolling is not None and rolling.progress > 0.0 and rolling.possible
    return DrivePoint(
        week=_monday(drive) if drive.dated else None,
        ambient_c=float(np.mean(drive.temperature[:, 1])) if len(drive.temperature) else None,
        distance_m=distance,
        distance_energy_j=float(steps.energy.sum()),
        rolling=rolling.value if rolling is not None and shown else None,
        capacity_j=capacity_by_charge(drive),
    )


def _monday(drive: Drive) -> str:
    day = datetime.fromtimestamp(drive.start_ns // NANOSECONDS, tz=timezone.utc)
    return f"{day - timedelta(days=day.weekday()):%Y-%m-%d}"


def _warmth(point: DrivePoint, units: Units) -> Group | None:
    if point.ambient_c is None:
        return None
    low = BIN * math.floor(point.ambient_c / BIN)
    ends = (units.degrees * celsius + units.zero for celsius in (low, low + BIN))
    return low, " to ".join(f"{degrees:.0f}" for degrees in ends) + f" {units.temperature}"


def _rows(
    points: Iterable[DrivePoint],
    title: str,
    group: Callable[[DrivePoint], Group | None],
    units: Units,
) -> list[TrendRow]:
    groups: dict[Group, list[tuple[float, float]]] = {}
    for point in points:
        key, value = group(point), point.quantities(units).get(title)
        if key and value is not None:
            groups.setdefault(key, []).append((point.distance_m, value))
    return [_row(key[1], groups[key]) for key in sorted(groups, key=lambda key: key[0])]


def _row(name: str, values: Sequence[tuple[float, float]]) -> TrendRow:
    weight, value = np.array(values).T
    mean = float(weight @ value / weight.sum())
    spread = math.sqrt(float(weight @ (value - mean) ** 2 / weight.sum()))
    return TrendRow(name, len(values), float(weight.sum()), mean, spread)
