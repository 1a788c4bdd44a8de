"""One drive as a row of plain values: what the tables of a fleet are made of."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

from evpinn_ros.core.estimation.estimate import TRACKED, Trust
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.replays.run import Replayed
from evpinn_ros.replays.trends import DrivePoint, drive_point

NUMBERS = (
    "duration_s",
    *("power_rmse_w", "power_coverage_90"),
    *("energy_measured_j", "energy_predicted_j", "energy_error_percent"),
)
POINT = DrivePoint._fields
PARAMETERS = {
    name + ("" if figure == "value" else f"_{figure}"): (name, figure)
    for figures in (TRACKED, ("state",))
    for name, figure in product(PARAMETER_NAMES, figures)
}
"""Columns of parameters: which figure of which."""


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
    none: Mapping[str, Any] = {}
    return {
        column: parameters.get(name, none).get(figure)
        for column, (name, figure) in PARAMETERS.items()
    }


def impossible(row: Mapping[str, Any]) -> list[str]:
    """Parameters that lie where no such car can be, or whose signals contradict each other."""
    return [name for name in PARAMETER_NAMES if row[f"{name}_state"] == Trust.INVALID.value]
