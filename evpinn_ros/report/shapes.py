"""Values for the macros of `parts.html.j2`: curves, rows with intervals, trends."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.units import METRIC, Units, counted, fixed
from evpinn_ros.replays.trends import DrivePoint, Trend, trends

MOST_TICKS = 6


class Curve(NamedTuple):
    """A line with an optional band; arrays of shape (n,)."""

    across: np.ndarray  # x
    up: np.ndarray  # y, NaN if unknown
    half: np.ndarray | None = None  # half the height of the band
    limits: tuple[float, float] = (-math.inf, math.inf)  # of line and band

    def at(self, sign: float) -> np.ndarray:
        """The line (0), or the upper (1) or lower (-1) edge of its band."""
        away = 0.0 if self.half is None else sign * self.half
        return np.clip(self.up + away, *self.limits)


def curve(title: str, lines: Sequence[Curve], *, from_zero: bool) -> dict[str, Any] | None:
    """Values for the macro `curve`; None if no value is known. `from_zero`: the y axis has 0."""
    spans = [line.at(sign) for line in lines for sign in (-1.0, 1.0)]
    finite = np.concatenate([span[np.isfinite(span)] for span in spans])
    if not len(finite):
        return None
    low, high = float(finite.min()), float(finite.max())
    across = ticks(0.0, max(float(line.across[-1]) for line in lines))
    up = ticks(min(0.0, low) if from_zero else low, high)
    return {
        "title": title,
        "lines": [_points(line.across, line.at(0.0), across, up) for line in lines],
        "bands": [_band(line, across, up) for line in lines],
        "across": [(f"{tick:g}", round(100 * _share(tick, across), 2)) for tick in across],
        "up": [(f"{tick:g}", round(100 * _share(tick, up), 2)) for tick in up],
    }


def ticks(low: float, high: float) -> list[float]:
    """Round values of an axis, at most `MOST_TICKS`, that include both ends."""
    span = max(high - low, 1e-3)
    size = 10.0 ** math.floor(math.log10(span))
    step = next(
        step
        for step in (size * factor for factor in (0.2, 0.5, 1.0, 2.0, 5.0))
        if math.ceil(high / step) - math.floor(low / step) < MOST_TICKS
    )
    first, last = math.floor(low / step), math.ceil(high / step)
    return [round(i * step, 10) for i in range(first, max(last, first + 1) + 1)]


def _band(line: Curve, across: Sequence[float], up: Sequence[float]) -> str:
    if line.half is None:
        return ""
    there = _points(line.across, line.at(1.0), across, up)
    back = _points(line.across[::-1], line.at(-1.0)[::-1], across, up)
    return f"{there} {back}"


def _points(xs: np.ndarray, ys: np.ndarray, across: Sequence[float], up: Sequence[float]) -> str:
    return " ".join(
        f"{1000 * _share(x, across):.0f},{1000 - 1000 * _share(y, up):.0f}"
        for x, y in zip(xs, ys, strict=True)
        if math.isfinite(y)
    )


def _share(value: float, axis: Sequence[float]) -> float:
    return (value - axis[0]) / (axis[-1] - axis[0])


class IntervalRow(NamedTuple):
    """A row of the macro `intervals`."""

    name: str
    text: str  # beside the bar
    value: float
    half: float  # of the interval's width
    least: float = -math.inf  # lower limit of the interval

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return max(self.value - self.half, self.least)


def with_interval(
    kwh: float,
    half: float,
    digits: int,
    least: float = -math.inf,
    sign: str = "",
    unit: str = " kWh",
) -> str:
    """Energy with the ends of its interval in brackets: `0.93 kWh (0.81 to 1.06)`."""
    ends = (max(kwh - half, least), kwh + half)
    low, high = (fixed(end, digits, sign) for end in ends)
    return f"{fixed(kwh, digits, sign)}{unit} ({low} to {high})"


def interval_rows(rows: Sequence[IntervalRow]) -> list[dict[str, Any]]:
    """Values for the macro `intervals`: bar, interval and zero in percent of the common width."""
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


def trend_intervals(
    points: Iterable[DrivePoint | None], units: Units = METRIC
) -> list[tuple[str, list[dict[str, Any]]]]:
    """(title, values for the macro `intervals`) of each trend; intervals show single drives."""
    present = [point for point in points if point is not None]
    return [(trend.title, _rows(trend, units)) for trend in trends(present, units)]


def _rows(trend: Trend, units: Units) -> list[dict[str, Any]]:
    rows = []
    for row in trend.rows:
        text = f"{row.mean:.{trend.digits}f}"
        if row.drives > 1:
            digits = trend.digits + (round(row.spread, trend.digits) == 0.0)  # no ± 0.0
            text += f" (single drives ± {row.spread:.{digits}f})"
        distance = f"{row.distance / units.metres:.0f} {units.distance}"
        text += f"; {counted(row.drives, 'drive')}, {distance}"
        rows.append(IntervalRow(row.name, text, row.mean, row.spread))
    return interval_rows(rows)
