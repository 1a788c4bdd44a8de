"""The page of `evpinn forecast --report`: energy of each plan, its parts, and variations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units, fixed
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import UNEVEN, Change, PlannedEnergy, plan_parts
from evpinn_ros.core.energy.plan import Legs
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.terms import Part
from evpinn_ros.replays.energy_metrics import MEANINGS
from evpinn_ros.report.breakdown_text import least_of
from evpinn_ros.report.html import write_page
from evpinn_ros.report.shapes import Curve, IntervalRow, curve, interval_rows, with_interval

POINTS = 400  # of a curve: more than a narrow page has pixels
SMALL_PLAN = 0.5  # kWh; below, energies have a third digit, as in the report of a drive


class PlannedTrip(NamedTuple):
    """A plan to show, with the changes of its energy by variations (`what_if`)."""

    name: str
    planned: PlannedEnergy
    changes: Sequence[Change]


def write_forecasts(
    path: Path,
    trips: Sequence[PlannedTrip],
    assumed: Sequence[str],
    command: str,
    units: Units = METRIC,
) -> None:
    """Write the page, with the sentences `assumed` on car and conditions; OSError if it fails."""
    names = " and ".join(trip.name for trip in trips)
    shown = [_trip(trip, units) for trip in trips]
    title = f"Forecast of {names}"
    write_page(path, "forecast.html.j2", title=title, command=command, trips=shown,
               assumed=assumed, distance=units.distance)  # fmt: skip


def _trip(trip: PlannedTrip, units: Units) -> dict[str, Any]:
    return {
        "name": trip.name,
        "sentence": _sentence(trip.planned, units),
        "curves": list(_curves(trip.planned, units)),
        "parts": _parts(trip.planned),
        "changes": [
            (
                change.words,
                _later(change.seconds),
                _kwh(change.energy, _digits(trip.planned), sign="+", unit=""),
            )
            for change in trip.changes
        ],
    }


def _sentence(planned: PlannedEnergy, units: Units) -> str:
    trip, energies = planned.trip, planned.energies
    kwh, sigma = energies.energy[-1] / JOULES_PER_KWH, energies.sigma[-1] / JOULES_PER_KWH
    low, high = kwh - GAUSSIAN_QUANTILE * sigma, kwh + GAUSSIAN_QUANTILE * sigma
    minutes = np.ptp(trip.time) / 60
    text = (
        f"{np.ptp(trip.distance) / units.metres:.1f} {units.distance} in {minutes:.0f} minutes "
        f"take {kwh:.2f} kWh: 9 times in 10 between {low:.2f} and {high:.2f}."
    )
    left, half = (100 * planned.charge[:, -1]).tolist()
    if planned.empty_at is not None:
        text += (
            f" The battery is empty after {planned.empty_at / units.metres:.1f} {units.distance}."
        )
    elif np.isfinite(left):
        half *= GAUSSIAN_QUANTILE
        least, most = max(left - half, 0.0), min(left + half, 100.0)
        text += f" The battery then has {left:.0f} % left, between {least:.0f} and {most:.0f} %."
    for note in (planned.uneven_part, planned.no_heights(units), planned.beyond_driven):
        text += f" {note[0].upper()}{note[1:]}." if note else ""
    return text


def _curves(planned: PlannedEnergy, units: Units) -> Any:
    trip = planned.trip
    shown = np.unique(np.linspace(0, len(trip.time) - 1, POINTS).round().astype(int))
    along = (trip.distance - trip.distance[0])[shown] / units.metres
    speed = Curve(*speed_along(planned, shown, units))
    height = Curve(along, trip.elevation[shown] / units.height_metres)
    lines = [_battery_along(planned, units), (f"Speed, {units.speed}", speed, True)]
    if np.ptp(height.up):
        lines.append((f"Height, {units.height}", height, False))
    for title, line, from_zero in lines:
        if (drawn := curve(title, [line], from_zero=from_zero)) is not None:
            yield drawn


def _battery_along(planned: PlannedEnergy, units: Units) -> tuple[str, Curve, bool]:
    """(title, curve, from_zero) of the charge along the way, or of the energy if it is unknown."""
    energies = planned.energies
    course = energies.on_curve
    shown = np.unique(np.linspace(0, len(course.time) - 1, POINTS).round().astype(int))
    distance = planned.trip.distance if energies.curve is None else energies.curve.distance
    along = (distance - distance[0])[shown] / units.metres
    charge, half = 100 * planned.course[:, shown]
    if np.isfinite(charge).any():
        line = Curve(along, charge, GAUSSIAN_QUANTILE * half, (0.0, 100.0))
        return "Charge of the battery, %", line, False
    half = GAUSSIAN_QUANTILE * course.sigma[shown] / JOULES_PER_KWH
    return (
        "Energy since the start, kWh",
        Curve(along, course.energy[shown] / JOULES_PER_KWH, half),
        True,
    )


def speed_along(
    planned: PlannedEnergy, shown: np.ndarray, units: Units = METRIC
) -> tuple[np.ndarray, np.ndarray]:
    """(distances, speeds) at the points with indices `shown`; steps of mean speed for legs."""
    trip = planned.trip
    along = (trip.distance - trip.distance[0]) / units.metres
    if not isinstance(planned.given, Legs):
        return along[shown], units.speeds * trip.speed[shown]
    legs = np.minimum(shown[:-1], len(planned.given.length) - 1)
    mean = units.speeds * (planned.given.length / planned.given.duration)[legs]
    return np.repeat(along[shown], 2)[1:-1], np.repeat(mean, 2)


def _parts(planned: PlannedEnergy) -> list[dict[str, Any]]:
    """Values for the macro `intervals`, the largest part first, with 90 % intervals."""
    parts = plan_parts(planned.given, planned.energies, *planned.basis)
    names = [MEANINGS[part.name.lower()] for part in Part] + [UNEVEN]
    least_shown = 0.5 * 10.0 ** -_digits(planned) * JOULES_PER_KWH
    rows = [
        (name, Uncertain(energy, sigma))
        for part, (name, energy, sigma) in enumerate(zip(names, *parts, strict=True))
        if part != Part.REGAINED and max(abs(energy), sigma) > least_shown
    ]
    rows.sort(key=lambda row: -row[1].value)
    return interval_rows(
        [
            IntervalRow(
                name,
                _kwh(amount, _digits(planned), least=least_of(name)),
                amount.value,
                GAUSSIAN_QUANTILE * amount.sigma,
                least_of(name),
            )
            for name, amount in rows
        ]
    )


def _digits(planned: PlannedEnergy) -> int:
    return 2 if abs(planned.energies.energy[-1]) >= SMALL_PLAN * JOULES_PER_KWH else 3


def _kwh(energy: Uncertain, digits: int, **shape: Any) -> str:
    value, sigma = energy.value / JOULES_PER_KWH, energy.sigma / JOULES_PER_KWH
    return with_interval(value, GAUSSIAN_QUANTILE * sigma, digits, **shape)


def _later(seconds: float) -> str:
    minutes = fixed(seconds / 60, 1, "+")
    return "the same" if minutes == "+0.0" else f"{minutes} min"
