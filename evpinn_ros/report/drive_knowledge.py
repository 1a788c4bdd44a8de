"""Information in a drive on its car: identifiable combinations, and prior shares over time."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from evpinn_ros.energy.power_model import prior_identifiable
from evpinn_ros.replay.history import Drive
from evpinn_ros.vehicle.files import Vehicle

ROWS = {  # combination: what it is, its digits and unit, what kind of driving tells it
    "mass_over_eta": ("mass / η", "{:.0f} kg", "speeding up and braking, over 0.5 m/s²"),
    "drag_area_over_eta": ("A C_d / η", "{:.4f} m²", "above 80 km/h"),
    "c_rr": ("C_rr", "{:.5f}", "steady, 5 to 80 km/h"),
    "regeneration": ("η μ", "{:.3f}", "braking over 0.5 m/s²"),
    "p_aux": ("auxiliary power", "{:.0f} W", "below 5 km/h"),
}


def knowledge(vehicle: Vehicle, drive: Drive, minutes: Mapping[str, float]) -> str:
    """The section as HTML; `minutes` driven of the kind that tells each combination."""
    before = prior_identifiable(vehicle)[1]._asdict()
    rows = "".join(
        _row(name, drive.combinations[name][-1], before[name], minutes[name])
        for name in ROWS
        if len(drive.combinations.get(name, ()))
    )
    if not rows:
        return ""
    return (
        "<h2>What could be known</h2><p>Power and speed determine only these combinations. "
        "Mass, η and C_d scaled together change nothing that could be measured, so their absolute "
        "values keep a share of the prior however long the drive.</p>"
        "<div class='wide'><table><thead><tr><th>combination</th><th>at the end, 1-sigma</th>"
        "<th>left of the vehicle file's 1-sigma</th><th>learned by driving</th><th>for</th></tr>"
        f"</thead><tbody>{rows}</tbody></table></div>{_SHARES}"
    )


def _row(name: str, end: np.ndarray, before: float, minutes: float) -> str:
    """A row: `end` is time, value, 1-sigma; `before` the vehicle file's 1-sigma."""
    label, form, learned_by = ROWS[name]
    _, value, std = end
    left = 100 * std / before if before > 0 else 100.0
    spread = f"± {100 * std / abs(value):.1f} %" if value else ""
    cells = (
        escape(label),
        f"{escape(form.format(value))} {spread}",
        f"<span class='bar'><i style='width:{min(left, 100):.0f}%'></i></span>{left:.0f} %",
        escape(learned_by),
        f"{minutes:.1f} min",
    )
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


_SHARES = (
    "<figure><figcaption><b>Share of the prior</b> in each parameter. Full colour: all from "
    "data; pale: all prior.</figcaption><div class='plot' data-plot='shares'></div></figure>"
)
