"""Breakdown of the energy of a drive for the page: words, a stacked bar with sigmas, a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from evpinn_ros.replay.breakdown_text import breakdown_lines, breakdown_rows, shown

WIDTH = 1000.0  # of the picture


class Box(NamedTuple):
    """A part that took energy, in units of the picture: the box, and its whisker at the end."""

    words: str
    begin: float
    width: float
    end: float
    low: float
    high: float


def breakdown_values(found: Mapping[str, Any]) -> dict[str, Any]:
    """Values for `breakdown.html.j2`, from the metrics under `breakdown`."""
    lines, rows = breakdown_lines(found), breakdown_rows(found)
    parts = [(name, part) for name, part in shown(found) if (part["kwh"] or 0.0) > 0.0]
    if not parts:
        return {"lines": lines, "rows": rows, "boxes": []}
    measured = found["measured"]["kwh"]
    scale = WIDTH / max(sum(part["kwh"] for _, part in parts), measured)
    return {
        "lines": lines,
        "rows": rows,
        "boxes": list(_boxes(parts, scale)),
        "measured": round(max(measured, 0.0) * scale, 1),
    }


def _boxes(parts: list[tuple[str, Any]], scale: float) -> Iterator[Box]:
    """Boxes side by side."""
    begin = 0.0
    for name, part in parts:
        kwh, sigma_kwh = part["kwh"], part["sigma_kwh"]
        end, sigma = begin + kwh * scale, sigma_kwh * scale
        ends = (begin, end - begin, end, max(end - sigma, 0.0), min(end + sigma, WIDTH))
        words = f"{name} {kwh:.2f} \u00b1 {sigma_kwh:.2f} kWh"
        yield Box(words, *(round(each, 1) for each in ends))
        begin = end
