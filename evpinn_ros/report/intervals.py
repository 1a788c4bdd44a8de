"""Rows of amounts with their intervals, for the macro `intervals`: a bar each, and a line."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, NamedTuple


class IntervalRow(NamedTuple):
    """A row: its name, what stands beside it, the amount, half of its interval, and its least."""

    name: str
    text: str
    value: float
    half: float
    least: float = -math.inf

    @property
    def low(self) -> float:
        """Begin of its interval."""
        return max(self.value - self.half, self.least)


def interval_rows(rows: Sequence[IntervalRow]) -> list[dict[str, Any]]:
    """The rows with the places of bar, interval and zero, in percent of the width.

    The width holds every interval and zero, so that nothing is cut off.
    """
    low = min([0.0, *(min(row.value, row.low) for row in rows)])
    high = max([0.0, *(row.value + row.half for row in rows)])
    width = max(high - low, 1e-12)

    def at(value: float) -> float:
        return round(100.0 * (value - low) / width, 2)

    return [
        {
            "name": row.name,
            "text": row.text,
            "zero": at(0.0),
            "left": at(min(row.value, 0.0)),
            "width": round(abs(at(row.value) - at(0.0)), 2),
            "from_": at(row.low),
            "to": at(row.value + row.half),
        }
        for row in rows
    ]
