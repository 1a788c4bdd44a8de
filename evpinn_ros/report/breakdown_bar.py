"""Breakdown of the energy of a drive for the page: words, a row a part, a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.replays.breakdown_text import (
    breakdown_columns,
    breakdown_lines,
    breakdown_notes,
    breakdown_rows,
    breakdown_sentence,
    shown,
)
from evpinn_ros.report.intervals import IntervalRow, interval_rows


def breakdown_values(found: Mapping[str, Any], units: Units) -> dict[str, Any]:
    """Values for `breakdown.html.j2`, from the metrics under `breakdown`, biggest part first."""
    if found["unknown"] is not None:
        return {"sentence": "", "notes": breakdown_lines(found), "rows": [], "parts": []}
    parts = sorted(shown(found), key=lambda one: -one[1]["kwh"])
    digits = 2 if max(abs(part["kwh"]) for _, part in parts) >= 0.5 else 3
    return {
        "sentence": breakdown_sentence(found),
        "notes": breakdown_notes(found, units),
        "columns": breakdown_columns(units),
        "rows": breakdown_rows(found, units),
        "parts": interval_rows([_row(name, part, digits, units) for name, part in parts]),
    }


def _row(name: str, part: Mapping[str, float], digits: int, units: Units) -> IntervalRow:
    """A part: kWh, its interval of 90 % in words, energy over distance."""
    kwh, half = part["kwh"], GAUSSIAN_QUANTILE * part["sigma_kwh"]
    value, low, high = (
        f"{round(each, digits) + 0.0:.{digits}f}" for each in (kwh, kwh - half, kwh + half)
    )
    rate = part["kwh_per_100km"]
    per_distance = ""
    if rate is not None:
        shown_rate = rate * METRIC.rate_joules / units.rate_joules
        per_distance = f"; {shown_rate:.{1 if units is METRIC else 0}f} {units.rate}"
    return IntervalRow(name, f"{value} kWh ({low} to {high}){per_distance}", kwh, half)
