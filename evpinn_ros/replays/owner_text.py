"""A replayed drive in an owner's words: kilometres, kilowatt hours, and what took most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.estimation.breakdown import LEAST_DISTANCE, UNEXPLAINED
from evpinn_ros.replays.breakdown_text import shown
from evpinn_ros.replays.driven import travelled
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.tables import signed_percent, watts

DRIVES_COLUMNS = (
    *("drive", "km", "min", "kWh", "kWh/100 km"),
    *("took most", "RMSE", "energy predicted"),
)


def owner_line(drive: Drive, found: Mapping[str, Any]) -> str:
    """Length, time and energy of a drive, measured or, where it was not, predicted."""
    km, minutes, kwh, consumption = _figures(drive, found)
    how = "predicted" if found["energy"]["measured_j"] is None else "from the battery"
    per_distance = f", {consumption} kWh/100 km" if consumption != "-" else ""
    return f"{km} km in {minutes} min: {kwh} kWh {how}{per_distance}."


def drives_rows(drives: Sequence[tuple[str, Drive, Mapping[str, Any]]]) -> list[tuple[str, ...]]:
    """A row under `DRIVES_COLUMNS` for each name, drive and its metrics."""
    return [
        (
            name,
            *_figures(drive, found),
            _most(found["breakdown"]),
            watts(found["power"]["rmse_w"]),
            signed_percent(found["energy"]["error_percent"]),
        )
        for name, drive, found in drives
    ]


def _figures(drive: Drive, found: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Kilometres, minutes, kWh, and kWh/100 km: of what was measured, where that is known."""
    metres = float(travelled(drive).distance.sum())
    energy, parts = found["energy"], found["breakdown"]["measured"]
    joules = energy["predicted_j"] if energy["measured_j"] is None else energy["measured_j"]
    consumption = parts["kwh_per_100km"]
    if energy["measured_j"] is None and joules is not None and metres >= LEAST_DISTANCE:
        consumption = joules / JOULES_PER_KWH / metres * 1e5
    return (
        f"{metres / 1000:.1f}",
        f"{drive.duration / 60:.0f}",
        "-" if joules is None else f"{joules / JOULES_PER_KWH:.2f}",
        "-" if consumption is None else f"{consumption:.1f}",
    )


def _most(breakdown: Mapping[str, Any]) -> str:
    """Name and share of what took most, of what is known to two sigmas."""
    known = [
        (part["kwh"], f"{name}, {100 * part['share']:.0f} %")
        for name, part in ([] if breakdown["unknown"] else shown(breakdown))
        if name != UNEXPLAINED and part["kwh"] > 2 * part["sigma_kwh"] and part["share"]
    ]
    return max(known)[1] if known else "-"
