"""Metrics of energy: breakdown of a drive, account of a car; in kWh, kWh/100 km and km."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.energy.account import AccountSummary
from evpinn_ros.core.estimation.breakdown import REGAINED, UNEXPLAINED, Amount, Breakdown
from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.estimation.estimator import Mode

KWH_PER_100KM = JOULES_PER_KWH / 1e5  # J/m
MEANINGS: Mapping[str, str] = {
    "air": "air and wind",
    "tyres": "tyres",
    "slope": "net climb",
    "speed": "net speeding up",
    "brakes": "lost while braking",
    "drivetrain": "motor and drivetrain",
    "climate": "heating and cooling",
    "standing": "other standing load",
    UNEXPLAINED: "unexplained",
    "measured": "measured",
    REGAINED: "brought back by braking",
}
PAPER = "unknown, because mode paper cannot separate losses from electrical loads"
NOTHING = (
    "unknown, because nothing could be learned from this drive: that takes some seconds of "
    "driving with both speed and battery measured"
)
INVALID = (
    "unknown, because the learned mass is invalid: signals contradict each other, or --vehicle "
    "is wrong"
)


def breakdown_metrics(
    breakdown: Breakdown | None, mode: str, mass: str = Trust.VALID.value
) -> dict[str, Any]:
    """Values of `--metrics` under `breakdown`; None, and the reason, if unknown."""
    if breakdown is None:
        nothing = dict.fromkeys(Amount.__dataclass_fields__)
        rows: dict[str, Any] = {name: dict(nothing) for name in MEANINGS}
        why = INVALID if mass == Trust.INVALID.value else NOTHING
        why = PAPER if mode == Mode.PAPER.value else why
        return {
            **rows,
            "together": [],
            "distance_m": None,
            "duration_s": None,
            "unknown": why,
            "without_height_m": None,
        }
    amounts = {**breakdown.amounts(), "measured": breakdown.total()}
    return {
        **{name: asdict(amounts[name]) for name in MEANINGS},
        "together": [
            {"parts": [part.name.lower() for part in group], **asdict(breakdown.of(*group))}
            for group in breakdown.together()
        ],
        "distance_m": breakdown.distance,
        "duration_s": breakdown.seconds,
        "unknown": None,
        "without_height_m": breakdown.unseen,
    }


def account_metrics(summary: AccountSummary) -> dict[str, dict[str, Any]]:
    """`energy`, `consumption` and `range` of an account; kWh, kWh/100 km, km."""
    trip, life, remaining = summary.since_reset, summary.lifetime, summary.remaining
    return {
        "energy": {
            "trip_kwh": trip.net.value / JOULES_PER_KWH,
            "trip_sigma_kwh": trip.net.sigma / JOULES_PER_KWH,
            "trip_km": trip.distance / 1e3,
            "drawn_kwh": life.drawn / JOULES_PER_KWH,
            "regenerated_kwh": life.regenerated / JOULES_PER_KWH,
            "unmeasured_s": trip.unmeasured_s,
        },
        "consumption": {
            name: value / KWH_PER_100KM for name, value in summary.consumption.items()
        },
        "range": {
            "charge_percent": 100.0 * summary.charge.value,
            "charge_projected": summary.projected,
            "usable_kwh": summary.usable.value / JOULES_PER_KWH,
            "capacity_kwh": summary.capacity.value / JOULES_PER_KWH,
            "range_km": remaining and remaining.distance / 1e3,
            "lower_km": remaining and remaining.lower / 1e3,
            "upper_km": remaining and remaining.upper / 1e3,
        },
    }
