"""The picture of a drive: power, energy and parameters over time, with bands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from evpinn_ros.common.fsync import replaced
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.scoring import longest_step, running_total
from evpinn_ros.vehicle.parameters import Parameters

MEASURED, PREDICTED, TRUTH = "0.35", "tab:orange", "tab:green"
LABELS = {
    "eta": "motor efficiency \u03b7",
    "mu": "regeneration efficiency \u03bc",
    "mass": "mass, kg",
    "c_rr": "rolling resistance $C_{rr}$",
    "c_d": "drag coefficient $C_d$",
}


def drive_figure(drive: Drive, title: str, truth: Parameters | None = None) -> Figure:
    """Draw a drive.

    Args:
        drive: what was replayed.
        title: of the picture.
        truth: true parameters of a simulated car, drawn as lines.
    """
    figure = Figure(figsize=(12, 11), layout="constrained")
    figure.suptitle(title, parse_math=False)  # it may be the name of a file
    grid = figure.add_gridspec(5, 2, height_ratios=(0.7, 1.2, 1, 1, 1))
    _draw_speed(figure.add_subplot(grid[0, :]), drive)
    _draw_power(figure.add_subplot(grid[1, :]), drive)
    cells = [grid[row, column] for row in (2, 3, 4) for column in (0, 1)]
    names = list(LABELS)
    _draw_energy(figure.add_subplot(cells[0]), drive)
    for cell, name in zip(cells[1:], names, strict=True):
        true_value = None if truth is None else float(getattr(truth, name))
        _draw_parameter(figure.add_subplot(cell), drive.parameters, name, true_value)
    for axes in figure.axes:
        axes.set_xlim(0, max(drive.duration, 1.0))
        axes.grid(alpha=0.3)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write the picture as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as draft:
        figure.savefig(draft, dpi=110, format="png")


def _draw_speed(axes: Axes, drive: Drive) -> None:
    axes.plot(drive.speed[:, 0], drive.speed[:, 1] * 3.6, color="tab:blue", lw=1)
    axes.set_ylabel("speed, km/h")


def _draw_power(axes: Axes, drive: Drive) -> None:
    time, power = _with_breaks(drive.measured[:, 0], drive.measured[:, 1] / 1000)
    axes.plot(time, power, color=MEASURED, lw=1, label="measured")
    series = drive.smoothed
    half = GAUSSIAN_QUANTILE * series.sigma / 1000
    middle = series.power / 1000
    axes.fill_between(series.time, middle - half, middle + half, color=PREDICTED, alpha=0.3, lw=0)
    axes.plot(series.time, middle, color=PREDICTED, lw=0.8, label="predicted, 90 % band")
    axes.set_ylabel("battery power, kW")
    axes.legend(loc="upper right", ncols=2)


def _draw_energy(axes: Axes, drive: Drive) -> None:
    """Cumulative energy; the measured one is drawn to start where the predicted one does."""
    energy = drive.energy
    if len(energy) and len(drive.measured) > 1:
        time, power = drive.measured.T
        power = np.where(time >= energy[0, 0], power, 0.0)
        total = running_total(time, power) / JOULES_PER_KWH
        axes.plot(time, total, color=MEASURED, label="measured")
    if len(energy):
        axes.plot(energy[:, 0], energy[:, 1] / JOULES_PER_KWH, color=PREDICTED, label="predicted")
        axes.plot(energy[:, 0], energy[:, 2] / JOULES_PER_KWH, "k:", lw=1, label="RKNN")
        axes.legend(loc="upper left")
    axes.set_ylabel("energy, kWh")


def _draw_parameter(
    axes: Axes, parameters: Mapping[str, np.ndarray], name: str, truth: float | None
) -> None:
    rows = parameters[name]
    label = LABELS[name]
    if len(rows):
        time, value, std = rows[:, 0], rows[:, 1], rows[:, 2]
        axes.fill_between(time, value - std, value + std, color=PREDICTED, alpha=0.3, lw=0)
        axes.plot(time, value, color=PREDICTED, label="estimate, 1-sigma")
    if truth is not None:
        axes.axhline(truth, color=TRUTH, ls="--", label="truth")
    axes.set_ylabel(label)
    axes.set_xlabel("time, s")
    if truth is not None and len(rows):
        axes.legend(loc="best")


def _with_breaks(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The series with NaN where readings are too far apart to be joined by a line."""
    breaks = np.flatnonzero(np.diff(time) > longest_step(time)) + 1
    return np.insert(time, breaks, np.nan), np.insert(values, breaks, np.nan)
