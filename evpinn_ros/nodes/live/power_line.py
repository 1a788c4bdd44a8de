"""Power of the last minutes, in bins of time, and as a line of Braille dots."""

from __future__ import annotations

from collections.abc import Sequence
import math

BIN_NS = 500_000_000
KEPT_BINS = 600  # five minutes
STARTED_OVER_NS = 10 * 10**9  # stamps that go back further are no stragglers
BEYOND_ANY_CAR = 1e9  # W

_BRAILLE = 0x2800
# Bit of each dot of a character: column, then row from the top.
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
DOT_COLUMNS, DOT_ROWS = len(_DOTS), len(_DOTS[0])  # of one character


class PowerHistory:
    """The mean power of each half second, of several kinds beside each other.

    Attributes:
        newest_ns: the newest stamp of any kind, None before the first.
    """

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        self._bins: dict[str, dict[int, tuple[float, int]]] = {}

    def add(self, kind: str, stamp_ns: int, power: float) -> None:
        """Add one value, W; when time starts over, so does the line."""
        if self.newest_ns is not None and stamp_ns < self.newest_ns - STARTED_OVER_NS:
            self._bins.clear()
            self.newest_ns = None
        self.newest_ns = max(stamp_ns, self.newest_ns or stamp_ns)
        bins = self._bins.setdefault(kind, {})
        index = stamp_ns // BIN_NS
        total, count = bins.get(index, (0.0, 0))
        bins[index] = total + power, count + 1
        while len(bins) > KEPT_BINS:
            del bins[min(bins)]

    def last(self, kind: str, count: int) -> list[float]:
        """The newest bins, W, oldest first; NaN where nothing was received."""
        bins = self._bins.get(kind, {})
        if self.newest_ns is None:
            return [math.nan] * count
        end = self.newest_ns // BIN_NS + 1
        sums = (bins.get(index) for index in range(end - count, end))
        return [
            math.nan if sum_and_count is None else sum_and_count[0] / sum_and_count[1]
            for sum_and_count in sums
        ]


def power_axis(values: Sequence[float]) -> tuple[float, float]:
    """Round ends, W, of an axis that holds zero and all values a car can have; NaN are none."""
    known = [value for value in values if abs(value) < BEYOND_ANY_CAR]
    low, high = min([0.0, *known]), max([0.0, *known])
    span = max(high - low, 1000.0)
    step = 10.0 ** math.floor(math.log10(span))
    step = next((step / n for n in (5, 2) if span / step * n <= 8), step)
    return math.floor(low / step) * step, max(math.ceil(high / step), 1) * step


def braille_line(
    values: Sequence[float], width: int, height: int, axis: tuple[float, float]
) -> list[str]:
    """A line through values, as `height` rows of `width` Braille characters from the top.

    There are two values for each character, oldest first; NaN leaves a gap. The axis has the
    values at the bottom and at the top.
    """
    low, high = axis
    cells = [[0] * width for _ in range(height)]
    last_row = height * DOT_ROWS - 1
    before: int | None = None
    for column, value in enumerate(values[: width * DOT_COLUMNS]):
        if not math.isfinite(value):
            before = None
            continue
        share = min(max((value - low) / (high - low), 0.0), 1.0)
        row = round((1.0 - share) * last_row)
        # Joined to the value before, without a second dot beside that one.
        step = 0 if before is None or before == row else (1 if row > before else -1)
        first = row if before is None or not step else before + step
        for dot in range(min(first, row), max(first, row) + 1):
            cell, bit = column // DOT_COLUMNS, _DOTS[column % DOT_COLUMNS][dot % DOT_ROWS]
            cells[dot // DOT_ROWS][cell] |= bit
        before = row
    return ["".join(chr(_BRAILLE + cell) for cell in row) for row in cells]
