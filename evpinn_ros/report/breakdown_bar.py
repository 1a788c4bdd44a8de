"""Breakdown of the energy of a drive for the page: words, a stacked bar with sigmas, a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from evpinn_ros.common.units import Units
from evpinn_ros.estimation.breakdown import UNEXPLAINED
from evpinn_ros.replays.breakdown_text import (
    MEANINGS,
    NAMES,
    breakdown_columns,
    breakdown_lines,
    breakdown_notes,
    breakdown_rows,
    breakdown_sentence,
    shown,
)

WIDTH = 1000.0  # of the picture
TINY = 1e-9  # kWh
COLOURED = (*NAMES, UNEXPLAINED)


class Box(NamedTuple):
    """A part that took energy, in units of the picture: the box, and its whisker at the end."""

    words: str
    colour: int  # of its first part, the same on every page
    begin: float
    width: float
    end: float
    low: float
    high: float


def breakdown_values(found: Mapping[str, Any], units: Units) -> dict[str, Any]:
    """Values for `breakdown.html.j2`, from the metrics under `breakdown`."""
    if found["unknown"] is not None:
        return {"sentence": "", "notes": breakdown_lines(found), "rows": [], "boxes": []}
    parts = [(name, part) for name, part in shown(found) if part["kwh"] > 0.0]
    below = [(name, part) for name, part in shown(found) if part["kwh"] < 0.0]
    measured = found["measured"]["kwh"]
    digits = 2 if measured >= 1.0 else 3
    scale = WIDTH / max(sum(part["kwh"] for _, part in parts), measured, TINY)
    return {
        "sentence": breakdown_sentence(found),
        "notes": breakdown_notes(found, units),
        "columns": breakdown_columns(units),
        "rows": breakdown_rows(found, units),
        "boxes": list(_boxes(parts, scale, digits)),
        "below": [_words(name, part, digits) for name, part in below],
        "measured": round(max(measured, 0.0) * scale, 1),
    }


def _boxes(parts: list[tuple[str, Any]], scale: float, digits: int) -> Iterator[Box]:
    """Boxes side by side, their kWh with so many digits."""
    begin = 0.0
    for name, part in parts:
        kwh, sigma_kwh = part["kwh"], part["sigma_kwh"]
        end, sigma = begin + kwh * scale, sigma_kwh * scale
        ends = (begin, end - begin, end, max(end - sigma, 0.0), min(end + sigma, WIDTH))
        words = _words(name, part, digits)
        yield Box(words, _colour(name), *(round(each, 1) for each in ends))
        begin = end


def _words(name: str, part: Mapping[str, float], digits: int) -> str:
    value = round(part["kwh"], digits) + 0.0
    return f"{name} {value:.{digits}f} ± {part['sigma_kwh']:.{digits}f} kWh"


def _colour(name: str) -> int:
    """Number of the first part of what has this name."""
    return next(i for i, part in enumerate(COLOURED) if name.startswith(MEANINGS[part]))
