"""Tables of the scores for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.unseen.scores import LEAST_COVERED
from evpinn_ros.common.plain_table import PlainTable

ENERGY_COLUMNS = (
    "carried:\nnet %",
    "gross %",
    "in 90 %\nwidth %",
    "1, 10, 60 s means\nRMSE W",
    "200 s:\nRMSE W",
    "gross %",
    "in 90 %\nwidth %",
    "600 s:\ngross %",
    "in 90 %\nwidth %",
)
TRUTH_COLUMNS = {
    "mass_over_eta": "m/eta",
    "regeneration": "eta mu",
    "rolling_over_eta": "C_rr m/eta",
    "drag_area_over_eta": "A C_d/eta",
    "p_aux": "p_aux",
}
AGES = ("0.1", "1", "10", "60", "600")
LEGEND = """
carried       whole drives, each predicted from what the drives before it taught
200 s, 600 s  part of a drive of this length, its battery hidden
net, gross %  error of the energy in percent of net or gross energy: median; mean
CRPS %        mean error of the predicted distribution, percent of gross energy
log           log of the density at the measured energy; larger is better
in 90 %       share of the 90 % intervals that contain the energy; width: their median
RMSE W        of power: every sample, or means over 1, 10 and 60 s
W, %          RMSE of power, error of energy, by the age of the last battery reading
-             no drive is long enough, or the method gives no 1-sigma or too few predictions
"""


def energy_table(methods: Mapping[str, Mapping[str, Any]]) -> PlainTable:
    """Whole drives and dropouts: median and mean of the errors, coverage and width."""
    table = PlainTable("", ("method", *ENERGY_COLUMNS))
    for name, scores in methods.items():
        carried, short, long = (scores[key] for key in ("carried", "withheld", "dropout_600"))
        table.add_row(
            name,
            _pair(carried, "net_median_percent", "net_mean_percent"),
            _pair(carried, "gross_median_percent", "gross_mean_percent"),
            _pair(carried, "inside_90_percent", "width_90_percent", "0f"),
            _means(carried),
            _cell(short, "rmse_w", "0f"),
            _cell(short, "gross_mean_percent"),
            _pair(short, "inside_90_percent", "width_90_percent", "0f"),
            _cell(long, "gross_mean_percent"),
            _pair(long, "inside_90_percent", "width_90_percent", "0f"),
        )
    return table


def score_table(methods: Mapping[str, Mapping[str, Any]]) -> PlainTable:
    """CRPS of energies in percent of gross energy, and log score."""
    headers = [f"{part}:\nCRPS %; log" for part in ("carried", "200 s", "600 s")]
    table = PlainTable("", ("method", *headers))
    for name, scores in methods.items():
        parts = (scores[key] for key in ("carried", "withheld", "dropout_600"))
        table.add_row(name, *(_pair(part, "crps_percent", "log_score", "2f") for part in parts))
    return table


def age_table(methods: Mapping[str, Mapping[str, Any]]) -> PlainTable:
    """RMSE and error of energy by the age of the last battery sample."""
    table = PlainTable("", ("s since the battery", *(f"{age}:\nW, %" for age in AGES)))
    for name, scores in methods.items():
        ages = scores["by_battery_age"]
        cells = (
            f"{_cell(ages[age], 'rmse_w', '0f')}, {_cell(ages[age], 'energy_percent')}"
            for age in AGES
        )
        table.add_row(name, *cells)
    return table


def unscored(methods: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """A line for each method that predicted too little of some drives or dropouts."""
    for name, scores in methods.items():
        counts = (
            f"{len(few)} of {len(parts)} {what}"
            for what, parts in (("drives", scores["drives"]), ("dropouts", scores["cuts"]))
            if (few := [p for p in parts if p["gross_j"] and p["covered"] < LEAST_COVERED])
        )
        if text := " and ".join(counts):
            yield f"{name}: predicted less than {100 * LEAST_COVERED:.0f} % of {text}"


def truth_table(methods: Mapping[str, Mapping[str, Any]]) -> PlainTable:
    """Bias, percent (W for p_aux), and coverage of the 95 % interval."""
    table = PlainTable("", ("bias %; 95 % covers %", *TRUTH_COLUMNS.values()))
    for name, scores in methods.items():
        truth = scores["truth"]
        if truth:
            cells = (_truth_cell(key, truth.get(key)) for key in TRUTH_COLUMNS)
            table.add_row(name, *cells)
    return table


def _truth_cell(name: str, row: Mapping[str, Any] | None) -> str:
    if row is None:
        return "-"
    bias = f"{row['bias']:+.0f} W" if name == "p_aux" else f"{row['bias_percent']:+.1f}"
    return f"{bias}; {row['covered_percent']:.0f}"


def _cell(scores: Mapping[str, Any] | None, key: str, form: str = "1f") -> str:
    value = None if scores is None else scores[key]
    return "-" if value is None else format(value, f".{form}")


def _pair(scores: Mapping[str, Any] | None, first: str, two: str, form: str = "1f") -> str:
    return f"{_cell(scores, first, form)}; {_cell(scores, two, form)}"


def _means(scores: Mapping[str, Any] | None) -> str:
    means = None if scores is None else scores["means_w"]
    return ", ".join(_cell(means, length, "0f") for length in ("1", "10", "60"))
