"""Charts, running totals and breakdown of a drive, as values for its page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.common.units import JOULES_PER_WH, METRIC, Units, fixed
from evpinn_ros.core.energy.power_model import PowerModel, Weather, even_steps
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.terms import WARM
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import QUANTITIES, Parameters
from evpinn_ros.replays.driven import DrivenSteps
from evpinn_ros.replays.forecasts import ForecastOutcome, known_model
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.scoring import known_at
from evpinn_ros.report.breakdown_text import (
    breakdown_columns,
    breakdown_lines,
    breakdown_notes,
    breakdown_rows,
    breakdown_sentence,
    least_of,
    shown,
)
from evpinn_ros.report.shapes import IntervalRow, interval_rows, with_interval
from evpinn_ros.report.thinning import Grid, grid_for, packed, thinned

KILO = 1000.0
TITLES = {
    "eta": "Motor efficiency η",
    "mu": "Regeneration efficiency μ",
    "mass": "Mass",
    "c_rr": "Rolling resistance C_rr",
    "c_d": "Drag coefficient C_d",
    "p_aux": "Auxiliary power",
}
AXES = {
    "eta": "η",
    "mu": "μ",
    "mass": "mass, kg",
    "c_rr": "C_rr",
    "c_d": "C_d",
    "p_aux": "power, W",
}

Chart = dict[str, Any]


def line_chart(drive: Drive, name: str, axis: str, rows: np.ndarray, points: int) -> Chart:
    """One series; `rows`, shape (n, 2), are time and value in the unit of `axis`."""
    time, values = rows.T
    grid = grid_for(time, drive.duration, points)
    return _time_chart(grid, axis, 1, [_line(name, name, time, values, grid)])


def power_chart(drive: Drive, points: int) -> Chart:
    """Power measured, and predicted with its 90 % band."""
    time, predicted, sigma, _ = drive.smoothed
    grid = grid_for(time if len(time) else drive.speed[:, 0], drive.duration, points)
    measured_time, measured = drive.measured.T
    lines = [
        _line("measured", "measured", measured_time, measured / KILO, grid),
        *_with_band("predicted", time, predicted, GAUSSIAN_QUANTILE * sigma, KILO, grid),
    ]
    return _time_chart(grid, "battery power, kW", 1, lines)


def error_chart(drive: Drive, points: int) -> Chart:
    """Predicted minus measured power, and the predicted 90 % band around zero."""
    time, predicted, sigma, _ = drive.smoothed
    measured, is_measured = known_at(drive.measured, time)
    grid = grid_for(time if len(time) else drive.speed[:, 0], drive.duration, points)
    error = np.where(is_measured, predicted - measured, np.nan) / KILO
    half = GAUSSIAN_QUANTILE * sigma / KILO
    lines = [
        _line("", "low", time, -half, grid),
        _line("", "high", time, half, grid),
        _line("error", "error", time, error, grid),
    ]
    return _time_chart(grid, "error, kW", 2, lines)


def energy_chart(drive: Drive, steps: DrivenSteps, points: int) -> Chart:
    """Energy since the start: measured, predicted with its 90 % band, and the RKNN's."""
    time, predicted, rknn, sigma = drive.energy.T
    grid = grid_for(time if len(time) else drive.speed[:, 0], drive.duration, points)
    half = GAUSSIAN_QUANTILE * sigma
    steps = chosen_rows(steps, steps.end > (time[0] if len(time) else 0.0))
    lines = [
        _line("measured", "measured", steps.end, np.cumsum(steps.energy) / JOULES_PER_WH, grid),
        *_with_band("predicted", time, predicted, half, JOULES_PER_WH, grid),
        _line("Runge-Kutta network", "other", time, rknn / JOULES_PER_WH, grid),
    ]
    return _time_chart(grid, "energy, Wh", 1, lines)


def parameter_chart(drive: Drive, name: str, truth: Parameters | None, points: int) -> Chart:
    """One parameter with 1-sigma, its truth if known, and its prior share."""
    time, value, std, share = drive.parameters[name].T
    grid = grid_for(time, drive.duration, points)
    lines = _with_band("estimate", time, value, std, 1.0, grid)
    if truth is not None and len(time):
        lines.append({"label": "truth", "role": "truth", "value": float(getattr(truth, name))})
    lines.append(_line("prior", "share", time, 100 * share, grid))
    return _time_chart(grid, AXES[name], QUANTITIES[name].decimals, lines)


def share_chart(drive: Drive, points: int) -> Chart:
    """Prior share of each parameter over time, percent: a strip per parameter."""
    any_time = next(iter(drive.parameters.values()))[:, 0]
    grid = grid_for(any_time, drive.duration, points)
    strips = [
        _line(name, "share", rows[:, 0], 100 * rows[:, 3], grid)
        for name, rows in drive.parameters.items()
    ]
    return {"kind": "strips", **grid.times, "series": strips}


def outcome_chart(parts: Iterable[ForecastOutcome]) -> Chart:
    """Begin, end, s, and measured energy, forecast and half of its 90 % band, Wh, of each part."""
    rows = [
        [
            *part.span,
            part.measured / JOULES_PER_WH,
            part.forecast / JOULES_PER_WH,
            GAUSSIAN_QUANTILE * part.sigma / JOULES_PER_WH,
        ]
        for part in parts
    ]
    return {"kind": "outcome", "axis": "energy of the part, Wh", "parts": rows}


def _time_chart(grid: Grid, axis: str, decimals: int, series: list[Chart]) -> Chart:
    return {"kind": "time", **grid.times, "axis": axis, "decimals": decimals, "series": series}


def _line(label: str, role: str, time: np.ndarray, values: np.ndarray, grid: Grid) -> Chart:
    return {"label": label, "role": role, "values": packed(thinned(time, values, grid))}


def _with_band(
    label: str, time: np.ndarray, middle: np.ndarray, half: np.ndarray, unit: float, grid: Grid
) -> list[Chart]:
    return [
        _line("", "low", time, (middle - half) / unit, grid),
        _line("", "high", time, (middle + half) / unit, grid),
        _line(label, "predicted", time, middle / unit, grid),
    ]


LEAST_DISTANCE = 100.0  # m in a bin of speed from which on its energy is shown
LEAST_SHARE = 0.02  # of the drive's distance, likewise: less only passes through a speed
SHOWN_SPEED = 36.0  # m/s, up to which steady speeds are shown at least


def speed_energy_chart(drive: Drive, vehicle: Vehicle, steps: DrivenSteps, units: Units) -> Chart:
    """Energy over distance by speed: measured in bins, and predicted at steady speeds.

    The lowest bin is left out, because it shows little but the standing load.
    """
    width = units.speed_step
    speeds = steps.speed * units.speeds
    bins = np.minimum(speeds / width, 300.0 / width).astype(np.int64)
    energy = np.bincount(bins, steps.energy / JOULES_PER_WH)
    distance = np.bincount(bins, steps.distance / units.metres)
    enough = distance >= max(LEAST_DISTANCE / units.metres, LEAST_SHARE * distance.sum())
    shown = [i for i in np.flatnonzero(enough).tolist() if i > 0]
    last = max([*((i + 1) * width for i in shown), SHOWN_SPEED * units.speeds])
    grid = np.arange(width, last + 1.0)
    car = known_model(drive.model, drive.final, vehicle)
    middle, sigma = _steady_power(car, grid / units.speeds)
    middle, half = (joules / JOULES_PER_WH / (grid / 3600.0) for joules in (middle, sigma))
    half *= GAUSSIAN_QUANTILE
    return {
        "kind": "bySpeed",
        "axes": [f"speed, {units.speed}", f"Wh/{units.distance}"],
        "width": width,
        "driven": float(speeds.max(initial=0.0)),
        "bars": [[i * width, energy[i] / distance[i], distance[i]] for i in shown],
        "start": float(grid[0]),
        "middle": packed(middle),
        "low": packed(middle - half),
        "high": packed(middle + half),
    }


def running_totals(
    travelled: DrivenSteps, measured: DrivenSteps, duration: float, points: int
) -> Chart:
    """Running totals over time: distance, m, driving time, s, and measured distance and energy."""
    time = np.linspace(0.0, max(duration, 1.0), points)

    def total(steps: DrivenSteps, values: np.ndarray) -> dict[str, object]:
        if not len(values):
            return packed(np.zeros(points))
        return packed(np.interp(time, steps.end, np.cumsum(values), left=0.0))

    return {
        "step": float(time[1]),
        "distance": total(travelled, travelled.distance),
        "seconds": total(travelled, travelled.seconds),
        "known": total(measured, measured.distance),
        "energy": total(measured, measured.energy),
    }


def _steady_power(car: PowerModel, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power, W, at steady speeds on a flat road without wind, and its 1-sigma; shape (n,) each."""
    steps = even_steps(np.ones_like(speed), speed, 0.0 * speed)
    rows = car.rows(steps, Weather(car.density(), start=WARM))
    variance = car.car.trust * ((rows @ car.car.covariance) * rows).sum(-1)
    return rows @ car.car.mean, np.sqrt(variance)


def breakdown_values(breakdown: Mapping[str, Any], units: Units) -> dict[str, Any]:
    """Values for `breakdown.html.j2`, from the metrics under `breakdown`, largest part first."""
    if breakdown["unknown"] is not None:
        return {"sentence": "", "notes": breakdown_lines(breakdown), "rows": [], "parts": []}
    parts = sorted(shown(breakdown), key=lambda part: -part[1]["kwh"])
    digits = 2 if max(abs(part["kwh"]) for _, part in parts) >= 0.5 else 3
    return {
        "sentence": breakdown_sentence(breakdown),
        "notes": breakdown_notes(breakdown, units),
        "columns": breakdown_columns(units),
        "rows": breakdown_rows(breakdown, units),
        "parts": interval_rows([_row(name, part, digits, units) for name, part in parts]),
    }


def _row(name: str, part: Mapping[str, float], digits: int, units: Units) -> IntervalRow:
    """A part with its 90 % interval; the text also has the energy over distance."""
    kwh, half = part["kwh"], GAUSSIAN_QUANTILE * part["sigma_kwh"]
    least = least_of(name)
    rate = part["kwh_per_100km"]
    per_distance = ""
    if rate is not None:
        shown_rate = rate * METRIC.rate_joules / units.rate_joules
        per_distance = f"; {fixed(shown_rate, 1 if units is METRIC else 0)} {units.rate}"
    return IntervalRow(
        name, with_interval(kwh, half, digits, least) + per_distance, kwh, half, least
    )
