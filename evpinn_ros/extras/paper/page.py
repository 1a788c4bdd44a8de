"""The page of `evpinn reproduce`: every table and figure of an experiment."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
import io
from pathlib import Path
from typing import Any

import numpy as np

from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.extras.paper.experiment import Outcome
from evpinn_ros.extras.paper.published import POWER_LOSSES, LossRow
from evpinn_ros.extras.paper.tables import all_tables
from evpinn_ros.extras.paper.verdict import CRITERIA, verdict
from evpinn_ros.report.html import write_page

with optional_imports():
    from matplotlib import style
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHORT = 11  # characters of a cell kept on one line: `random 20 %`
# Colours that are readable on white and on black.
MEASURED, NETWORK, PLAIN, PHYSICS = "0.55", "tab:orange", "tab:blue", "tab:green"
LOOKS = ("default", "dark_background")  # of matplotlib, for light pages and for dark ones
LETTERING: Any = {"font.size": 11, "legend.frameon": False, "axes.grid": True, "grid.alpha": 0.3}
WIDTH, DPI = 6.4, 140  # inches: text is readable on a page of 500 px
BEYOND = 0.5  # margin on both sides, in measured ranges

Picture = str  # as a data URL


def write_reproduction(path: Path, outcome: Outcome, command: str, label: str) -> None:
    """Write the report; `label` describes the run, as in the terminal."""
    write_page(
        path,
        "reproduction.html.j2",
        title=f"EV-PINN on {outcome.vehicle.name}",
        command=command,
        label=label,
        findings=verdict(outcome),
        criteria=CRITERIA,
        tables=[table._replace(rows=_whole(table.rows)) for table in all_tables(outcome)],
        pictures=reproduction_pictures(outcome),
    )


def _whole(rows: list[list[str]]) -> list[list[str]]:
    return [
        [x.replace(" ", "\N{NO-BREAK SPACE}") if len(x) <= SHORT else x for x in row]
        for row in rows
    ]


def reproduction_pictures(outcome: Outcome) -> dict[str, tuple[Picture, Picture]]:
    """The figures by title, in the order of the paper, each for a light and a dark page."""
    of_model_s = outcome.vehicle.key == "tesla_model_s"
    figures = {
        f"Fig. {6 if of_model_s else 5}: loss of the power network": _power_losses,
        "Fig. 8: loss of the energy networks": _energy_losses,
        f"Fig. {10 if of_model_s else 9}: battery power and energy": _drive,
        "The same network outside the training": _unseen,
    }
    return {
        title: (_picture(draw, outcome, LOOKS[0]), _picture(draw, outcome, LOOKS[1]))
        for title, draw in figures.items()
    }


def _picture(draw: Callable[[Outcome], Figure], outcome: Outcome, look: str) -> Picture:
    """The figure as PNG with a transparent background."""
    buffer = io.BytesIO()
    with style.context([look, LETTERING]):
        draw(outcome).savefig(buffer, format="png", dpi=DPI, transparent=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _figure(height: float) -> Figure:
    return Figure(figsize=(WIDTH, height), layout="constrained")


def _legend(axes: Axes) -> None:
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)


def _power_losses(outcome: Outcome) -> Figure:
    """Total, data and physics loss over epochs, with the paper's values as points."""
    figure = _figure(6.0)
    sides = figure.subplots(2, 1, sharex=True)
    published = POWER_LOSSES.get(outcome.vehicle.key, ())
    for axes, side in zip(sides, ("training", "validation"), strict=True):
        _draw_losses(axes, outcome.training.rows, side, "-", "")
        if published:
            _draw_losses(axes, published, side, "o", "paper, ")
        axes.set_ylabel(f"loss in {side}")
    _legend(sides[0])
    sides[1].set_xlabel("epoch")
    return figure


def _draw_losses(axes: Axes, rows: Sequence[LossRow], side: str, mark: str, prefix: str) -> None:
    epochs = [row.epoch for row in rows]
    for name, color in (("total", MEASURED), ("data", NETWORK), ("physics", PHYSICS)):
        values = [getattr(getattr(row, side), name) for row in rows]
        axes.loglog(epochs, values, mark, color=color, label=prefix + name)


def _energy_losses(outcome: Outcome) -> Figure:
    figure = _figure(3.8)
    axes = figure.add_subplot()
    rows = np.array(outcome.energy_rows, dtype=float)
    columns = ("RKNN training", "RKNN validation", "DNN training", "DNN validation")
    styles = (("-", PLAIN), ("--", PLAIN), ("-", NETWORK), ("--", NETWORK))
    for index, (label, (line, color)) in enumerate(zip(columns, styles, strict=True), start=1):
        axes.loglog(rows[:, 0], rows[:, index], line, color=color, label=label)
    axes.set_xlabel("epoch")
    axes.set_ylabel("loss")
    _legend(axes)
    return figure


def _drive(outcome: Outcome) -> Figure:
    """Power and energy of the whole drive: a fit, since 80 % of it are training samples."""
    figure = _figure(6.4)
    power, energy = figure.subplots(2, 1, sharex=True)
    log, energies = outcome.log, outcome.energies
    power.plot(log.time, log.power / 1000, color=MEASURED, lw=1.6, label="measured")
    power.plot(log.time, outcome.predicted_power / 1000, color=NETWORK, lw=0.8, label="network")
    power.set_ylabel("battery power, kW")
    lines = (
        ("measured power, exact", energies.measured, MEASURED, "-"),
        ("network's power, exact", energies.predicted, NETWORK, "-"),
        ("measured power, RKNN", energies.rknn, PHYSICS, ":"),
        ("measured power, DNN", energies.dnn, PLAIN, ":"),
    )
    for label, joules, color, line in lines:
        energy.plot(log.time, joules / JOULES_PER_KWH, line, color=color, lw=2, label=label)
    energy.set_ylabel("energy, kWh")
    energy.set_xlabel("time, s")
    for axes in (power, energy):
        _legend(axes)
    return figure


def _unseen(outcome: Outcome) -> Figure:
    """The last fifth under the chronological split, near the range of measured power."""
    figure = _figure(3.8)
    axes = figure.add_subplot()
    log, rows = outcome.log, outcome.chronological.problem.split.validation
    begin = log.time[rows[0]]
    near = log.time > begin - 0.5 * (log.time[-1] - begin)
    measured, network = log.power[near] / 1000, outcome.unseen_power[near] / 1000
    axes.plot(log.time[near], measured, color=MEASURED, lw=1.6, label="measured")
    axes.plot(log.time[near], network, color=NETWORK, lw=0.8, label="network")
    axes.axvline(begin, color=PLAIN, ls=":", label="trained up to here")
    margin = BEYOND * max(float(np.ptp(measured)), 1.0)
    axes.set_ylim(measured.min() - margin, measured.max() + margin)
    axes.set_xlabel("time, s")
    axes.set_ylabel("battery power, kW")
    _legend(axes)
    return figure
