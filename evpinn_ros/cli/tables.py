"""Tables of a replay for people: scores and parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from evpinn_ros.replay.history import Drive
from evpinn_ros.replay.run import WARM_UP
from evpinn_ros.replay.scoring import Span, null_scores
from evpinn_ros.report.parameter_text import MEANINGS, parameter_number
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES, Parameters


def parameter_table(found: Mapping[str, Any], truth: Parameters | None = None) -> Table:
    """Live value, 1-sigma, prior share and state of each parameter, and the truth if known."""
    table = titled_table("Parameters of the car")
    table.add_column("parameter")
    for name in ("live value", "1-sigma", *(["true value"] if truth else []), "prior"):
        table.add_column(name, justify="right")
    table.add_column("state")
    for name in PARAMETER_NAMES:
        estimate = found["parameters"].get(name)
        if estimate is None:
            continue
        row = [parameter_number(name, estimate["value"]), parameter_number(name, estimate["std"])]
        if truth is not None:
            row.append(parameter_number(name, getattr(truth, name)))
        share = f"{100 * estimate['prior_share']:.0f} %"
        table.add_row(f"{name}  {MEANINGS[name]}", *row, share, estimate["state"])
    return table


def live_table(drive: Drive, truth: Parameters | None) -> Table:
    """Live value, 1-sigma, prior share and truth of a drive recorded from the nodes."""
    table = titled_table("Parameters of the car")
    table.add_column("parameter")
    for name in ("live value", "1-sigma", "true value", "off by", "prior"):
        table.add_column(name, justify="right")
    final = drive.final.parameters if drive.final is not None else {}
    for name, estimate in final.items():
        true = float(getattr(truth, name)) if truth is not None else None
        table.add_row(
            f"{name}  {MEANINGS[name]}",
            parameter_number(name, estimate.value),
            parameter_number(name, estimate.std),
            "-" if true is None else parameter_number(name, true),
            "-" if true is None else f"{(estimate.value - true) / estimate.std:+.1f} sigma",
            f"{100 * estimate.prior_share:.0f} %",
        )
    return table


def score_table(drive: Drive, found: Mapping[str, Any], warm_up: float = WARM_UP) -> Table:
    """Scores of power and energy, with the nulls that say what they are worth."""
    table = titled_table(f"Predict, then update; after {warm_up:.0f} s")
    table.add_column("what")
    for name in ("RMSE", "MAE", "R2", "in 90 % band"):
        table.add_column(name, justify="right")
    lag = found["power"]["lag_s"]
    title = "power/smoothed" if lag is None else f"power/smoothed ({lag:.1f} s later)"
    table.add_row(title, *_scores(found["power"]))
    table.add_row("power/predicted (at once)", *_scores(found["power_now"]))
    withheld = found.get("withheld")
    if withheld is not None:
        title = f"  battery withheld after {withheld['from_s']:.0f} s"
        table.add_row(f"{title}, smoothed", *_scores(withheld["power"]))
        table.add_row(f"{title}, at once", *_scores(withheld["power_now"]))
    nulls = null_scores(drive, Span(warm_up, drive.duration))
    table.add_row("null: last value held", _watts(nulls["last_value"]), "", "", "")
    table.add_row("null: random split, interpolated", _watts(nulls["interpolation"]), "", "", "")
    return table


def energy_lines(found: Mapping[str, Any]) -> list[str]:
    """Energy measured and predicted, a line for the drive and one for its withheld part."""
    lines = [_energy_line("Energy", found["energy"])]
    if "withheld" in found:
        lines.append(_energy_line("Energy while withheld", found["withheld"]["energy"]))
    return lines


def titled_table(title: str) -> Table:
    """An empty table in the style of all."""
    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)


def figures_table(title: str, rows: Iterable[tuple[str, str, str]]) -> Table:
    """What was measured, beside its goal: (name, measured, goal)."""
    table = titled_table(title)
    table.add_column("")
    for column in ("measured", "goal"):
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*row)
    return table


def _energy_line(title: str, score: Mapping[str, float | None]) -> str:
    predicted = f"predicted {_energy(score['predicted_j'])} (RKNN {_energy(score['rknn_j'])})"
    if score["measured_j"] is None:
        return f"{title}: {predicted}, not measured"
    return (
        f"{title}: measured {_energy(score['measured_j'])}, {predicted}, "
        f"error {_percent(score['error_percent'])} "
        f"(RKNN {_percent(score['rknn_error_percent'])})"
    )


def _scores(score: Mapping[str, float | None]) -> list[str]:
    r2, coverage = score["r2"], score["coverage_90"]
    return [
        _watts(score["rmse_w"]),
        _watts(score["mae_w"]),
        "-" if r2 is None else f"{r2:.4f}",
        "-" if coverage is None else f"{100 * coverage:.1f} %",
    ]


def _watts(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f} W"


def _energy(joules: float | None) -> str:
    return "-" if joules is None else f"{joules / 3600:.1f} Wh"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:+.2f} %"
