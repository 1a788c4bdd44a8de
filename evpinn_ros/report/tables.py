"""Rows of text on the scores and parameters of a replay, for terminal and report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evpinn_ros.common.units import fixed
from evpinn_ros.core.vehicle.parameters import QUANTITIES, Parameters
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.scoring import Span, baseline_scores, held_scores

SCORE_COLUMNS = ("what", "RMSE", "MAE", "R2", "in 90 % band")
BLANK = ("", "", "")  # cells of a row that has only an RMSE


def parameter_columns(truth: Parameters | None) -> tuple[str, ...]:
    """Titles of `parameter_rows`."""
    true = () if truth is None else ("true value",)
    return ("parameter", "live value", "1-sigma", *true, "prior", "state")


def parameter_rows(metrics: Mapping[str, Any], truth: Parameters | None) -> list[tuple[str, ...]]:
    """Rows under `parameter_columns`, from the metrics under `parameters`."""
    rows = []
    for name, quantity in QUANTITIES.items():
        estimate = metrics["parameters"].get(name)
        if estimate is None:
            continue
        row = [quantity.text(estimate["value"]), quantity.text(estimate["std"])]
        if truth is not None:
            row.append(quantity.text(getattr(truth, name)))
        share = f"{100 * estimate['prior_share']:.0f} %"
        rows.append((f"{name}  {quantity.word}", *row, share, estimate["state"]))
    return rows


def score_rows(drive: Drive, metrics: Mapping[str, Any], warm_up: float) -> list[tuple[str, ...]]:
    """Scores of predicted power and of baselines, rows under `SCORE_COLUMNS`."""
    lag = metrics["power"]["lag_s"]
    title = "power/smoothed" if lag is None else f"power/smoothed ({lag:.1f} s later)"
    rows = [
        (title, *_scores(metrics["power"])),
        ("power/predicted (at once)", *_scores(metrics["power_now"])),
    ]
    withheld = metrics.get("withheld")
    if withheld is not None:
        title = f"  battery withheld after {withheld['from_s']:.0f} s"
        rows.append((f"{title}, smoothed", *_scores(withheld["power"])))
        rows.append((f"{title}, at once", *_scores(withheld["power_now"])))
    if metrics["power"].get("floor_w") is not None:
        floor = watts(metrics["power"]["floor_w"])
        rows.append(("floor: best function of speed, in hindsight", floor, *BLANK))
    for age, score in metrics.get("by_battery_age", {}).items():
        if score["rmse_w"] is not None and float(age) >= 1.0:
            rows.append(
                (f"  battery silent for {age} s, smoothed", watts(score["rmse_w"]), *BLANK)
            )
    span = Span(warm_up, drive.duration)
    baselines = baseline_scores(drive, span)
    for age, rmse in held_scores(drive, span).items():
        rows.append((f"baseline: last value held {round(age, 1):g} s", watts(rmse), *BLANK))
    split = watts(baselines["interpolation"])
    rows.append(("baseline: random split, interpolated", split, *BLANK))
    return rows


def energy_lines(metrics: Mapping[str, Any]) -> list[str]:
    """Measured and predicted energy: a line for the drive, and one for a withheld part."""
    lines = [_energy_line("Energy", metrics["energy"])]
    if "withheld" in metrics:
        lines.append(_energy_line("Energy while withheld", metrics["withheld"]["energy"]))
    return lines


def watts(value: float | None) -> str:
    """A power, W, as text; "-" for None."""
    return "-" if value is None else f"{value:.0f} W"


def watt_hours(joules: float | None) -> str:
    """An energy, J, as text in Wh; "-" for None."""
    return "-" if joules is None else f"{joules / 3600:.1f} Wh"


def signed_percent(value: float | None) -> str:
    """An error in percent as text; "-" for None."""
    return "-" if value is None else f"{fixed(value, 2, '+')} %"


def _energy_line(title: str, score: Mapping[str, float | None]) -> str:
    predicted = (
        f"predicted {watt_hours(score['predicted_j'])} (RKNN {watt_hours(score['rknn_j'])})"
    )
    if score["measured_j"] is None:
        return f"{title}: {predicted}, not measured"
    return (
        f"{title}: measured {watt_hours(score['measured_j'])}, {predicted}, "
        f"error {signed_percent(score['error_percent'])} "
        f"(RKNN {signed_percent(score['rknn_error_percent'])})"
    )


def _scores(score: Mapping[str, float | None]) -> list[str]:
    r2, coverage = score["r2"], score["coverage_90"]
    return [
        watts(score["rmse_w"]),
        watts(score["mae_w"]),
        "-" if r2 is None else f"{r2:.4f}",
        "-" if coverage is None else f"{100 * coverage:.1f} %",
    ]
