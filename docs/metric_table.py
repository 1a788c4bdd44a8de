"""The keys of `evpinn replay --metrics`: unit and meaning of each, for people and tests."""

from __future__ import annotations

from typing import NamedTuple

from evpinn_ros.common.saved_fields import figures
from evpinn_ros.core.estimation.breakdown import Amount
from evpinn_ros.core.estimation.estimate import FIGURES
from evpinn_ros.replays.scoring import GAP_STEPS, MAX_MEASURED_STEP


class Metric(NamedTuple):
    """One key of the JSON.

    Attributes:
        key: path with dots; a part in <> stands for any name.
        unit: SI unit, empty for text and plain numbers.
        meaning: one sentence for people.
    """

    key: str
    unit: str
    meaning: str


_POWER = (
    ("rmse_w", "W", "root mean square of predicted minus measured power"),
    ("mae_w", "W", "mean of its size"),
    ("r2", "", "1 - (mean square of the error) / (variance of measured power); 0 is the mean's"),
    ("coverage_90", "", "share of samples within 1.645 sigma: 0.9 where sigma is right"),
)
_SMOOTHED = (
    ("lag_s", "s", "by which `power/smoothed` comes after its moment, median"),
    *_POWER,
)
_ENERGY = (
    (
        "measured_j",
        "J",
        "voltage x current without a charger, integrated where gaps are up to "
        f"{MAX_MEASURED_STEP} s or {GAP_STEPS:.0f} usual steps",
    ),
    ("predicted_j", "J", "predicted power, integrated over the same stretches"),
    ("rknn_j", "J", "the same by the Runge-Kutta network"),
    ("error_percent", "%", "of `predicted_j`, of the size of `measured_j`; positive: too much"),
    ("rknn_error_percent", "%", "of `rknn_j`, of the size of `measured_j`; positive: too much"),
)
_PARAMETER = tuple((name, *figure) for name, figure in FIGURES.items())
_AMOUNT = tuple((name, *figure) for name, figure in figures(Amount).items())


def _under(prefix: str, rows: tuple[tuple[str, str, str], ...]) -> tuple[Metric, ...]:
    return tuple(Metric(f"{prefix}.{key}", unit, meaning) for key, unit, meaning in rows)


METRICS: tuple[Metric, ...] = (
    Metric("input.path", "", "the recording, as given"),
    Metric("input.duration_s", "s", "first reading to last"),
    Metric("input.samples", "", "predictions of `power/smoothed`"),
    Metric("input.dropped.<reason>", "", "readings and samples not used, by reason"),
    Metric("vehicle", "", "key of the vehicle file"),
    Metric("mode", "", "`hybrid` or `paper`"),
    *_under("power", _SMOOTHED),
    Metric(
        "power.floor_w",
        "W",
        "of mode `paper`: least `rmse_w` of any fixed function of speed, chosen with hindsight",
    ),
    *_under("power_now", _POWER),
    *_under("energy", _ENERGY),
    Metric("withheld.from_s", "s", "from here on the battery was hidden"),
    *_under("withheld.power", _SMOOTHED),
    *_under("withheld.power_now", _POWER),
    *_under("withheld.energy", _ENERGY),
    *_under("parameters.<name>", _PARAMETER),
    Metric(
        "by_battery_age.<seconds>.rmse_w",
        "W",
        "of `power/smoothed` about so long after the last battery reading: 0.1, 1, 10, 60, 600 s",
    ),
    Metric("by_battery_age.<seconds>.bias_w", "W", "mean error so long after it"),
    Metric("by_battery_age.<seconds>.last_value_rmse_w", "W", "RMSE of the last value held"),
    *_under("breakdown.<part>", _AMOUNT),
    Metric("breakdown.together", "", "groups of parts not separated: `parts` and their sum"),
    Metric("breakdown.distance_m", "m", "of the intervals in it, whose battery was measured"),
    Metric("breakdown.duration_s", "s", "duration of these intervals"),
    Metric("breakdown.without_height_m", "m", "part of the distance where no height is known"),
    Metric(
        "breakdown.left_out_kwh",
        "kWh",
        "`totals.energy_kwh` less `breakdown.measured.kwh`: outside of these intervals",
    ),
    Metric("breakdown.unknown", "", "why there is none, else null"),
    Metric(
        "totals.start", "", "first reading, ISO 8601; null without a date, local without a zone"
    ),
    Metric("totals.distance_m", "m", "way of the drive, or of all, as every text gives it"),
    Metric("totals.duration_s", "s", "without the stops between short drives"),
    Metric("totals.energy_kwh", "kWh", "net from the battery, without a charger"),
    Metric("totals.measured_m", "m", "the part of the way over which that was measured"),
    Metric("totals.kwh_per_100km", "kWh/100 km", "energy over this part, null below 100 m"),
    Metric("totals.charged_kwh", "kWh", "what a charger gave the car while it stood in a drive"),
    Metric("totals.charge_first_percent", "%", "first state of charge"),
    Metric("totals.charge_last_percent", "%", "last state of charge"),
    Metric("health.percent", "%", "state of health of the battery; null where clearly above 100"),
    Metric("health.sigma_percent", "%", "its 1-sigma"),
    Metric("health.capacity_kwh", "kWh", "energy of the full battery"),
    Metric("health.capacity_sigma_kwh", "kWh", "its 1-sigma"),
    Metric("updates.count", "", "updates of the car's states, one a second with new intervals"),
    Metric("updates.accepted", "", "of them finite, so used"),
    Metric("updates.rejected.<reason>", "", "the others, by reason"),
    Metric("updates.p50_ms", "ms", "time of one of the latest hour, median"),
    Metric("updates.p99_ms", "ms", "99th percentile"),
    Metric("replay.wall_s", "s", "time of the replay, without loading"),
    Metric("replay.realtime_factor", "", "`duration_s` over `wall_s`"),
    Metric("replay.peak_rss_mb", "MB", "most memory of the process so far, of 2^20 bytes"),
)
