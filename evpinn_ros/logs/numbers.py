"""Numbers as people's programs write them: decimal commas, thousands, signs, missing ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.optional import optional_imports

with optional_imports():
    import polars as pl

# What apps write where a value is missing; NaN is MATLAB's and pandas'.
MISSING = frozenset(("", "na", "n/a", "nan", "none", "null", "-", "--", "---", "?", "no data"))
_GROUPS = re.compile(r"[+-]?\d{1,3}(?:([.,])\d{3})(?:\1\d{3})*")
_SPACES = "[ \u00a0\u202f'\u2019_]"


class Style(NamedTuple):
    """Style of a column's numbers: signs before decimals and between thousands."""

    decimal: str = "."
    thousands: str = ","


POINT, COMMA = Style(".", ","), Style(",", ".")


def is_missing(cell: str) -> bool:
    """True if a cell says that there is no value."""
    return cell.strip().lower() in MISSING


def style_of(cells: Iterable[str]) -> Style | None:
    """The style that the cells of a column show; None where none is certain.

    `12,5` shows a decimal comma and `1,234,567` one between thousands; `12,345` shows neither.
    """
    votes = Counter(filter(None, map(_certain, map(str.strip, cells))))
    if votes[POINT] == votes[COMMA]:
        return None
    return max(votes, key=lambda style: votes[style])


def _certain(cell: str) -> Style | None:
    """The style of a cell that can be read in one way alone."""
    point, comma = cell.rfind("."), cell.rfind(",")
    if point < 0 and comma < 0:
        return None
    if point >= 0 and comma >= 0:
        return POINT if point > comma else COMMA
    sign = "." if point >= 0 else ","
    decimal = POINT if sign == "." else COMMA
    if cell.count(sign) > 1:  # thousands, but for a date
        grouped = _GROUPS.fullmatch(cell) is not None
        return (COMMA if sign == "." else POINT) if grouped else None
    before, after = cell.lstrip("+-").split(sign)
    if not (before + after).isdigit():
        return None
    if len(after) != 3 or before in ("", "0") or len(before) > 3:
        return decimal
    return None


def to_floats(cells: Sequence[str], style: Style) -> NDArray[np.float64]:
    """The numbers of cells, NaN where there is none; shape as the cells."""
    series = pl.Series("", cells, dtype=pl.String).str.strip_chars()
    values = series.cast(pl.Float64, strict=False)
    left = values.is_null() & (series != "")
    if style == COMMA or left.any():
        written = series.str.replace_all(_SPACES, "").str.replace_all("\u2212", "-", literal=True)
        # A sign between thousands stands before three digits: 1,23 is no number then.
        sign = re.escape(style.thousands)
        groups = rf"^[+-]?\d{{1,3}}({sign}\d{{3}})+({re.escape(style.decimal)}\d*)?$"
        bare = written.str.replace_all(style.thousands, "", literal=True)
        written = pl.select(
            pl.when(written.str.contains(groups)).then(bare).otherwise(written)
        ).to_series()
        if style == COMMA:
            written = written.str.replace(",", ".", literal=True)
        again = written.cast(pl.Float64, strict=False)
        keep = again if style == COMMA else values.fill_null(again)
        values = keep
    return np.asarray(values.fill_null(float("nan")))
