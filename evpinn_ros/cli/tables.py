"""Tables of a replay for people: scores and parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.core.vehicle.parameters import QUANTITIES, Parameters
from evpinn_ros.replays.drive_names import short_names
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.run import WARM_UP
from evpinn_ros.report.breakdown_text import breakdown_columns, breakdown_rows
from evpinn_ros.report.owner_text import drives_columns, drives_rows
from evpinn_ros.report.tables import (
    SCORE_COLUMNS,
    parameter_columns,
    parameter_rows,
    score_rows,
)


def parameter_table(metrics: Mapping[str, Any], truth: Parameters | None = None) -> PlainTable:
    """Live value, 1-sigma, prior share and state of each parameter, and the truth if known."""
    columns = parameter_columns(truth)
    rows = parameter_rows(metrics, truth)
    return PlainTable("Parameters of the car", columns, rows, words=("state",))


def live_table(drive: Drive, truth: Parameters | None) -> PlainTable:
    """Live value, 1-sigma, prior share and truth of a drive recorded from the nodes."""
    columns = ("parameter", "live value", "1-sigma", "true value", "off by", "prior")
    table = PlainTable("Parameters of the car", columns)
    final = drive.final.parameters if drive.final is not None else {}
    for name, estimate in final.items():
        true = float(getattr(truth, name)) if truth is not None else None
        table.add_row(
            f"{name}  {QUANTITIES[name].word}",
            QUANTITIES[name].text(estimate.value),
            QUANTITIES[name].text(estimate.std),
            "-" if true is None else QUANTITIES[name].text(true),
            "-" if true is None else f"{(estimate.value - true) / estimate.std:+.1f} sigma",
            f"{100 * estimate.prior_share:.0f} %",
        )
    return table


def breakdown_table(
    breakdown: Mapping[str, Any], units: Units = METRIC, of: str = "the energy"
) -> PlainTable:
    """Breakdown of the energy: kWh, 1-sigma, energy over distance and share of each part."""
    rows = breakdown_rows(breakdown, units)
    return PlainTable(f"Where {of} went", breakdown_columns(units), rows)


def score_table(drive: Drive, metrics: Mapping[str, Any], warm_up: float = WARM_UP) -> PlainTable:
    """Scores of power and energy, with the baselines that say what they are worth."""
    title = f"Power, predicted before it was learned from; the first {warm_up:.0f} s not scored"
    return PlainTable(title, SCORE_COLUMNS, score_rows(drive, metrics, warm_up))


def drives_table(
    drives: Sequence[tuple[Drive, Mapping[str, Any]]],
    breakdown: Mapping[str, Any],
    units: Units = METRIC,
) -> PlainTable:
    """Drives of one car with their metrics, a row each, and one of all with their breakdown."""
    names = short_names([Path(metrics["input"]["path"]) for _, metrics in drives])
    named = [(name, *drive) for name, drive in zip(names, drives, strict=True)]
    rows = drives_rows(named, breakdown, units)
    return PlainTable("Drives", drives_columns(units), rows, words=("took most",))
