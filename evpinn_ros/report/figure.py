"""Picture of a drive: breakdown, speed, power, energy and identifiable combinations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.common.writer import replaced
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.vehicle.identifiable import Identifiable
from evpinn_ros.replays.energy_metrics import MEANINGS
from evpinn_ros.replays.history import Drive, History
from evpinn_ros.replays.scoring import longest_step, running_total
from evpinn_ros.topics import topic_of
from evpinn_ros.topics.energies import read_energy
from evpinn_ros.topics.estimates import (
    POWER_KINDS,
    read_breakdown,
    read_parameters,
    read_power,
)
from evpinn_ros.topics.messages import BadMessage
from evpinn_ros.topics.readings import ChargeScale, to_reading

with optional_imports():
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def recorded_drive(bag: Path) -> Drive:
    """The series of a bag that the nodes or a replay wrote."""
    history, charge = History(), ChargeScale()
    parameters: Any = None
    combined: Any = None
    newest_ns = 0
    with BagReader(bag) as reader:
        names = {topic_of(name) for name in reader.topics}
        speed = next((topic for topic in topics.SPEEDS if topic in names), topics.SPEED)
        for record in reader.records():
            topic = topic_of(record.topic)
            try:
                if topic in (speed, topics.BATTERY):
                    reading = to_reading(record.type_name, record.message)
                    newest_ns = max(newest_ns, reading.stamp_ns)
                    history.add_reading(charge.reading(reading))
                elif topic is topics.PARAMETERS:
                    parameters = record.message
                elif topic is topics.IDENTIFIABLE:
                    combined = record.message
                elif topic is topics.BOUNDS and parameters is not None and combined is not None:
                    history.add_output(0, read_parameters(parameters, combined, record.message))
                elif topic is topics.ENERGY_BREAKDOWN:
                    history.add_breakdown(read_breakdown(record.message))
                elif topic is topics.ENERGY_STATE:
                    history.add_output(0, read_energy(record.message))
                elif topic is not None and topic in POWER_KINDS:
                    history.add_output(newest_ns, read_power(topic, record.message))
            except BadMessage:
                continue  # a message of another package
    return history.drive()


MEASURED, PREDICTED, TRUTH = "0.35", "tab:orange", "tab:green"
# Wide and pale, to be seen under the predicted curve.
BELOW: Mapping[str, Any] = {"color": "0.7", "lw": 3.5}
BAND: Mapping[str, Any] = {"color": PREDICTED, "lw": 0}
INTERVAL = 1.96  # sigmas to both sides that hold 95 %
BESIDE_BARS = 0.3  # margin to both sides of the bars, over their width
TITLES = {
    "mass_over_eta": "mass / \u03b7, kg",
    "drag_area_over_eta": "drag area / \u03b7, m\u00b2",
    "c_rr": "rolling resistance $C_{rr}$",
    "regeneration": "regeneration \u03b7 \u03bc",
    "p_aux": "auxiliary power, W",
}
OUTSIDE: Mapping[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "borderaxespad": 0.2,
    "frameon": False,
    "fontsize": "small",
}


def drive_figure(drive: Drive, title: str, truth: Identifiable | None = None) -> Figure:
    """Draw a drive; `truth`, known for a simulated car, is drawn as dashed lines."""
    figure = Figure(figsize=(12, 11.5), layout="constrained")
    figure.suptitle(title, parse_math=False)  # the title may be the name of a file
    grid = figure.add_gridspec(5, 6, height_ratios=(1.35, 0.7, 1.2, 1, 1))
    _draw_breakdown(figure.add_subplot(grid[0, :]), drive.breakdown)
    over_time = [figure.add_subplot(grid[row, :]) for row in (1, 2)]
    cells = [grid[row, 2 * third : 2 * third + 2] for row in (3, 4) for third in range(3)]
    over_time += [figure.add_subplot(cell) for cell in cells]
    speed, power, energy, *combinations = over_time
    speed.plot(drive.speed[:, 0], drive.speed[:, 1] * 3.6, color="tab:blue", lw=1)
    speed.set_title("speed, km/h", loc="left", fontsize="medium")
    _draw_power(power, drive)
    _draw_energy(energy, drive)
    for axes, name in zip(combinations, TITLES, strict=True):
        true_value = None if truth is None else float(getattr(truth, name))
        _draw_combination(axes, drive.combinations[name], true_value)
        axes.set_title(TITLES[name], loc="left", fontsize="medium")
    figure.legend(
        *combinations[0].get_legend_handles_labels(), loc="outside lower center", ncols=3
    )
    for axes in over_time:
        axes.set_xlim(0, max(drive.duration, 1.0))
        axes.grid(alpha=0.3)
    for axes in over_time[-3:]:
        axes.set_xlabel("time, s")
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write the picture as PNG; makes its folder if missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as draft:
        figure.savefig(draft, dpi=110, format="png")


def _draw_breakdown(axes: Axes, amounts: Mapping[str, tuple[float, float]]) -> None:
    names = [name for name in MEANINGS if any(amounts.get(name, ()))]
    for row, name in enumerate(names):
        kwh, sigma = amounts[name]
        axes.barh(row, kwh, color=PREDICTED, alpha=0.45, height=0.7)
        axes.errorbar(kwh, row, xerr=INTERVAL * sigma, color=PREDICTED, elinewidth=2)
        text = f"{kwh:.3f} \u00b1 {sigma:.3f}"
        beside = ("axes fraction", "data")
        axes.annotate(text, (1.01, row), xycoords=beside, va="center", annotation_clip=False)
    axes.set_yticks(range(len(names)), [MEANINGS[name] for name in names])
    axes.set_title("Where the energy went, kWh \u00b1 1-sigma", loc="left", fontsize="medium")
    axes.axvline(0.0, color="k", lw=0.8)
    # Without heights, the interval of a climb exceeds the energy of the drive. It is cut at the
    # edge, so that the other parts can be seen.
    drawn = [0.0, *(amounts[name][0] for name in names)]
    if beside := BESIDE_BARS * np.ptp(drawn):
        axes.set_xlim(min(drawn) - beside, max(drawn) + beside)
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.3)
    axes.errorbar([], [], xerr=[], color=PREDICTED, elinewidth=2, label="estimate, 95 % interval")
    axes.legend(**OUTSIDE, ncols=2)


def _draw_power(axes: Axes, drive: Drive) -> None:
    time, power = _with_breaks(drive.measured[:, 0], drive.measured[:, 1] / 1000)
    axes.plot(time, power, **BELOW, label="measured")
    series = drive.smoothed
    half = GAUSSIAN_QUANTILE * series.sigma / 1000
    middle = series.power / 1000
    low, high = middle - half, middle + half
    axes.fill_between(series.time, low, high, **BAND, alpha=0.3, label="its 90 % band")
    axes.plot(series.time, middle, color=PREDICTED, lw=0.8, label="predicted")
    axes.set_title("battery power, kW", loc="left", fontsize="medium")
    axes.legend(**OUTSIDE, ncols=3)


def _draw_energy(axes: Axes, drive: Drive) -> None:
    """Cumulative energy, measured and predicted; both start where the prediction starts."""
    energy = drive.energy
    if len(energy) and len(drive.measured) > 1:
        time, power = drive.measured.T
        power = np.where(time >= energy[0, 0], power, 0.0)
        axes.plot(time, running_total(time, power) / JOULES_PER_KWH, **BELOW)
    if len(energy):
        axes.plot(energy[:, 0], energy[:, 1] / JOULES_PER_KWH, color=PREDICTED, lw=1.2)
    axes.set_title("energy, kWh: measured, predicted", loc="left", fontsize="medium")


def _draw_combination(axes: Axes, rows: np.ndarray, truth: float | None) -> None:
    if len(rows):
        time, value, std = rows.T
        low, high = value - INTERVAL * std, value + INTERVAL * std
        axes.fill_between(time, low, high, **BAND, alpha=0.25, label="95 % interval")
        axes.plot(time, value, color=PREDICTED, label="estimate")
    if truth is not None:
        axes.axhline(truth, color=TRUTH, lw=2, ls="--", label="truth")


def _with_breaks(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    breaks = np.flatnonzero(np.diff(time) > longest_step(time)) + 1
    return np.insert(time, breaks, np.nan), np.insert(values, breaks, np.nan)
