"""The figures of the paper from an experiment: losses (5, 6, 8), power and energy (9, 10)."""

from __future__ import annotations

import base64
import io

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.report.figure import MEASURED, PREDICTED
from evpinn_ros.reproduction.experiment import Outcome
from evpinn_ros.reproduction.published import POWER_LOSSES, LossRow

UNSEEN = "tab:blue"
FIGURE_SIZE = (11, 4)


def reproduction_figures(outcome: Outcome) -> dict[str, Figure]:
    """The figures by title, in the order of the paper."""
    number = "6" if outcome.vehicle.key == "tesla_model_s" else "5"
    drive = "10" if outcome.vehicle.key == "tesla_model_s" else "9"
    return {
        f"Fig. {number}: loss of the power network": _power_losses(outcome),
        "Fig. 8: loss of the energy networks": _energy_losses(outcome),
        f"Fig. {drive}: battery power and energy": _drive(outcome),
        "The same network on road not yet driven": _unseen(outcome),
    }


def data_uri(figure: Figure) -> str:
    """A picture as an address that a page holds in itself."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _power_losses(outcome: Outcome) -> Figure:
    """Total, data and physics loss over epochs, the paper's values as points."""
    figure = Figure(figsize=FIGURE_SIZE, layout="constrained")
    sides = figure.subplots(1, 2, sharey=True)
    published = POWER_LOSSES.get(outcome.vehicle.key, ())
    for axes, side in zip(sides, ("training", "validation"), strict=True):
        _draw_losses(axes, outcome.power_rows, side, "-", "")
        if published:
            _draw_losses(axes, published, side, "o", "paper, ")
        axes.set_title(side)
    sides[0].set_ylabel("loss")
    sides[1].legend()
    return figure


def _draw_losses(
    axes: Axes, rows: list[LossRow] | tuple[LossRow, ...], side: str, mark: str, prefix: str
) -> None:
    epochs = [row.epoch for row in rows]
    colors = {"total": "k", "data": PREDICTED, "physics": "tab:green"}
    for name, color in colors.items():
        values = [getattr(getattr(row, side), name) for row in rows]
        axes.loglog(epochs, values, mark, color=color, label=prefix + name)
    axes.set_xlabel("epoch")
    axes.grid(alpha=0.3)


def _energy_losses(outcome: Outcome) -> Figure:
    figure = Figure(figsize=FIGURE_SIZE, layout="constrained")
    axes = figure.add_subplot()
    rows = np.array(outcome.energy_rows, dtype=float)
    columns = ("RKNN training", "RKNN validation", "DNN training", "DNN validation")
    styles = (("-", "tab:blue"), ("--", "tab:blue"), ("-", PREDICTED), ("--", PREDICTED))
    for index, (label, (line, color)) in enumerate(zip(columns, styles, strict=True), start=1):
        axes.loglog(rows[:, 0], rows[:, index], line, color=color, label=label)
    axes.set_xlabel("epoch")
    axes.set_ylabel("loss")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def _drive(outcome: Outcome) -> Figure:
    """Power and energy of the whole drive: a fit, 80 % of these samples were trained on."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    power, energy = figure.subplots(2, 1, sharex=True)
    log, energies = outcome.log, outcome.energies
    power.plot(log.time, log.power / 1000, color=MEASURED, lw=1, label="measured")
    power.plot(log.time, outcome.predicted_power / 1000, color=PREDICTED, lw=0.8, label="network")
    power.set_ylabel("battery power, kW")
    power.legend(loc="upper right", ncols=2)
    lines = (
        ("measured power, exact", energies.measured, MEASURED, "-"),
        ("network's power, exact", energies.predicted, PREDICTED, "-"),
        ("measured power, RKNN", energies.rknn, "k", ":"),
        ("measured power, DNN", energies.dnn, "tab:blue", ":"),
    )
    for label, joules, color, line in lines:
        energy.plot(log.time, joules / JOULES_PER_KWH, line, color=color, label=label)
    energy.set_ylabel("energy, kWh")
    energy.set_xlabel("time, s")
    energy.legend(loc="upper left")
    for axes in (power, energy):
        axes.grid(alpha=0.3)
    return figure


def _unseen(outcome: Outcome) -> Figure:
    """The last fifth under the chronological split."""
    figure = Figure(figsize=FIGURE_SIZE, layout="constrained")
    axes = figure.add_subplot()
    log, rows = outcome.log, outcome.chronological.problem.split.validation
    begin = log.time[rows[0]]
    near = log.time > begin - 0.5 * (log.time[-1] - begin)
    axes.plot(log.time[near], log.power[near] / 1000, color=MEASURED, lw=1, label="measured")
    axes.plot(
        log.time[near],
        outcome.unseen_power[near] / 1000,
        color=UNSEEN,
        lw=0.8,
        label="network, trained up to the line",
    )
    axes.axvline(begin, color="tab:red", ls=":")
    axes.set_xlabel("time, s")
    axes.set_ylabel("battery power, kW")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left")
    return figure
