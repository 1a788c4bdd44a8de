"""One drive as a row of plain values: what the tables of a fleet are made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.replays.run import Replayed
from evpinn_ros.replays.trends import DrivePoint, drive_point

NUMBERS = (
    "duration_s",
    *("power_rmse_w", "power_coverage_90"),
    *("energy_measured_j", "energy_predicted_j", "energy_error_percent"),
)
POINT = DrivePoint._fields
PARAMETER_NUMBERS = tuple(
    f"{name}{suffix}" for name in PARAMETER_NAMES for suffix in ("", "_std", "_prior_share")
)
PARAMETER_STATES = tuple(f"{name}_state" for name in PARAMETER_NAMES)


def drive_row(done: Replayed) -> dict[str, Any]:
    """The scores of a drive and the parameters of the car after it."""
    metrics = done.metrics
    power, energy = metrics["power"], metrics["energy"]
    return {
        "problem": done.problem,
        "samples": metrics["input"]["samples"],
        "duration_s": metrics["input"]["duration_s"],
        "power_rmse_w": power["rmse_w"],
        "power_coverage_90": power["coverage_90"],
        "energy_measured_j": energy["measured_j"],
        "energy_predicted_j": energy["predicted_j"],
        "energy_error_percent": energy["error_percent"],
        **_point(drive_point(done.drive)),
        **_parameters(metrics["parameters"]),
    }


def failed_row(problem: str) -> dict[str, Any]:
    """A drive of which nothing came."""
    numbers = dict.fromkeys(NUMBERS)
    return {"problem": problem, "samples": 0, **numbers, **_point(None), **_parameters({})}


def point_of(row: Mapping[str, Any]) -> DrivePoint | None:
    """Point of a drive in trends, by its row; None of a short or failed one."""
    return None if row["distance_m"] is None else DrivePoint(*(row[name] for name in POINT))


def _point(point: DrivePoint | None) -> dict[str, Any]:
    return dict.fromkeys(POINT) if point is None else point._asdict()


def _parameters(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for name in PARAMETER_NAMES:
        estimate = parameters.get(name, {})
        row[name] = estimate.get("value")
        row[f"{name}_std"] = estimate.get("std")
        row[f"{name}_prior_share"] = estimate.get("prior_share")
        row[f"{name}_state"] = estimate.get("state")
    return row


def impossible(row: Mapping[str, Any]) -> list[str]:
    """Parameters that lie where no such car can be, or whose signals contradict each other."""
    return [name for name in PARAMETER_NAMES if row[f"{name}_state"] == Trust.INVALID.value]
