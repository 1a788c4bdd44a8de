"""The curves of a drive over time, as the page's script draws them (`browser/drive.js`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.common.units import JOULES_PER_WH
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.vehicle.parameters import QUANTITIES, Parameters
from evpinn_ros.replays.driven import DrivenSteps
from evpinn_ros.replays.forecasts import ForecastOutcome
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.scoring import measured_at
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
    """One series, time and value in the unit of the axis; coloured by its name."""
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
    measured, is_measured = measured_at(drive, time)
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
    """Energy since the start: measured, predicted with its 90 % band, by the RK network."""
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
    """One parameter with 1-sigma, its truth if known, and its prior share for the legend."""
    time, value, std, share = drive.parameters[name].T
    grid = grid_for(time, drive.duration, points)
    lines = _with_band("estimate", time, value, std, 1.0, grid)
    if truth is not None and len(time):
        lines.append({"label": "truth", "role": "truth", "value": float(getattr(truth, name))})
    lines.append(_line("prior", "share", time, 100 * share, grid))
    return _time_chart(grid, AXES[name], QUANTITIES[name].decimals, lines)


def share_chart(drive: Drive, points: int) -> Chart:
    """Share of the prior in each parameter, percent over time: one strip each."""
    any_time = next(iter(drive.parameters.values()))[:, 0]
    grid = grid_for(any_time, drive.duration, points)
    strips = [
        _line(name, "share", rows[:, 0], 100 * rows[:, 3], grid)
        for name, rows in drive.parameters.items()
    ]
    return {"kind": "strips", **grid.times, "series": strips}


def outcome_chart(parts: Iterable[ForecastOutcome]) -> Chart:
    """Each part of the drive: begin and end, s; energy measured, forecast, and half its band."""
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
    """A line between the edges of its band, which the page fills; divided by the unit."""
    return [
        _line("", "low", time, (middle - half) / unit, grid),
        _line("", "high", time, (middle + half) / unit, grid),
        _line(label, "predicted", time, middle / unit, grid),
    ]
