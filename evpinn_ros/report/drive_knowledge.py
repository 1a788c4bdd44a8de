"""Information in a drive on its car: identifiable combinations, and prior shares over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.units import Units
from evpinn_ros.replays.history import Drive
from evpinn_ros.report.drive_maps import FAST, SLOW
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import prior_identifiable

ROWS = {  # combination: what it is, its digits and unit, what kind of driving tells it
    "mass_over_eta": ("mass / η", "{:.0f} kg", "speeding up and braking, over 0.5 m/s²"),
    "drag_area_over_eta": ("A C_d / η", "{:.4f} m²", "above {fast}"),
    "c_rr": ("C_rr", "{:.5f}", "steady, {slow} to {fast}"),
    "regeneration": ("η μ", "{:.3f}", "braking over 0.5 m/s²"),
    "p_aux": ("auxiliary power", "{:.0f} W", "below {slow}"),
}


class Row(NamedTuple):
    """A combination: its value at the end, percent left of its prior's 1-sigma, what tells it."""

    label: str
    value: str
    left: int
    learned_by: str
    minutes: str


def knowledge(
    vehicle: Vehicle, drive: Drive, minutes: Mapping[str, float], units: Units
) -> list[Row]:
    """A row for each combination; `minutes` driven of the kind that tells each."""
    before = prior_identifiable(vehicle)[1]._asdict()
    return [
        _row(name, drive.combinations[name][-1], before[name], minutes[name], units)
        for name in ROWS
        if len(drive.combinations.get(name, ()))
    ]


def _row(name: str, end: np.ndarray, before: float, minutes: float, units: Units) -> Row:
    """A row: `end` is time, value, 1-sigma; `before` the vehicle file's 1-sigma."""
    label, form, learned_by = ROWS[name]
    _, value, std = end
    left = 100 * std / before if before > 0 else 100.0
    spread = f"± {100 * std / abs(value):.1f} %" if value else ""
    fast, slow = (f"{limit * units.speeds:.0f} {units.speed}" for limit in (FAST, SLOW))
    learned_by = learned_by.format(fast=fast, slow=slow)
    text = f"{form.format(value)} {spread}"
    return Row(label, text, round(left), learned_by, f"{minutes:.1f}")
