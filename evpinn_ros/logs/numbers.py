"""Parses numbers as apps write them: decimal commas, thousands, signs, missing values."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.optional import optional_imports
from evpinn_ros.logs.batch import Cells

with optional_imports():
    import polars as pl

# Texts of a missing value; NaN is that of MATLAB and pandas.
MISSING = frozenset(("", "na", "n/a", "nan", "none", "null", "-", "--", "---", "?", "no data"))
SMALLEST, LARGEST = 1e-30, 1e30
"""Range of absolute values in any unit; squares of larger ones would overflow."""
_SPACES = "[ \u00a0\u202f'\u2019_]"


class Style(NamedTuple):
    """Style of a column's numbers: decimal separator and thousands separator."""

    decimal: str = "."
    thousands: str = ","


POINT, COMMA = Style(".", ","), Style(",", ".")


def is_missing(cell: str) -> bool:
    """True if a cell stands for a missing value."""
    return cell.strip().lower() in MISSING


def filled(cells: Cells) -> pl.Series:
    """The cells with a value."""
    series = pl.Series("", cells, dtype=pl.String)
    return series.filter(~series.str.strip_chars().str.to_lowercase().is_in([*MISSING]))


def style_of(cells: Cells) -> Style | None:
    """Decimal and thousands separators of cells; None if both styles fit, as for `12,345`."""
    text = pl.Series("", cells, dtype=pl.String).str.strip_chars()
    votes = {style: text.str.contains(_certain(style)).sum() for style in (POINT, COMMA)}
    if votes[POINT] == votes[COMMA]:
        return None
    return max(votes, key=lambda style: votes[style])


def _certain(style: Style) -> str:
    """Pattern of numbers that only this style can read."""
    decimal, thousands = map(re.escape, style)
    one_sign = rf"\d+{decimal}(\d{{0,2}}|\d{{4,}})|{decimal}\d+|(0|\d{{4,}}){decimal}\d{{3}}"
    groups = rf"[+-]?\d{{1,3}}({thousands}\d{{3}}){{2,}}"
    return rf"{thousands}.*{decimal}[^{thousands}]*$|^[+-]*({one_sign})$|^{groups}$"


def to_floats(cells: Cells, style: Style) -> NDArray[np.float64]:
    """The numbers of n cells, shape (n,); NaN if missing, unreadable or above `LARGEST`."""
    series = pl.Series("", cells, dtype=pl.String).str.strip_chars()
    values = series.cast(pl.Float64, strict=False)
    unread = values.is_null() & (series != "")
    if style == COMMA or unread.any():
        written = series.str.replace_all(_SPACES, "").str.replace_all("\u2212", "-", literal=True)
        # A thousands separator stands before three digits: 1,23 is then no number.
        sign = re.escape(style.thousands)
        groups = rf"^[+-]?\d{{1,3}}({sign}\d{{3}})+({re.escape(style.decimal)}\d*)?$"
        bare = written.str.replace_all(style.thousands, "", literal=True)
        written = pl.select(
            pl.when(written.str.contains(groups)).then(bare).otherwise(written)
        ).to_series()
        if style == COMMA:
            written = written.str.replace(",", ".", literal=True)
        parsed = written.cast(pl.Float64, strict=False)
        values = parsed if style == COMMA else values.fill_null(parsed)
    numbers = np.asarray(values.fill_null(float("nan")))
    sizes = np.abs(numbers)
    return np.where(sizes < LARGEST, np.where(sizes > SMALLEST, numbers, 0.0), np.nan)
