"""Joins numbers split at their commas, if only one way fits: `0,00,349,84`, `1,000.0`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations
from math import comb
import re
from typing import NamedTuple

from evpinn_ros.common.errors import InputError
from evpinn_ros.logs.apps import layout_of
from evpinn_ros.logs.batch import Row
from evpinn_ros.logs.numbers import is_missing
from evpinn_ros.logs.survey import AnotherHeaderError, Head, Table, data_rows, until_broken

MOST_LAYOUTS = 5000  # combinations of columns that are tried
TRIED_ROWS = 500  # rows of one width
LEAST_SHARE = 0.02  # share of rows that are too wide; fewer are torn
LEAST_ROWS = 3

MOST_GROUPS, MOST_WAYS = 6, 8  # in a row, and ways to join it, that are examined

_WHOLE = re.compile(r"[+-]?(0|[1-9]\d*)")
# 05 can only be decimals, and 3.2 has no decimal comma.
_NO_NUMBER = re.compile(r"[+-]?(0\d+|\d+\.\d*)")
_POINT = re.compile(r"[+-]?\d+\.\d+")
_CLOCK = re.compile(r".*\d:\d\d")  # a time, whose seconds may have decimals
_GROUP, _LAST_GROUP = re.compile(r"\d{3}"), re.compile(r"\d{3}(\.\d*)?")
_LEAD = re.compile(r"[+-]?[1-9]\d{0,2}")


class _Way(NamedTuple):
    cells: list[str]
    columns: frozenset[int]  # columns that were split


class JoinedTable:
    """A table whose rows are joined to the width of its header where only one way fits."""

    apart: frozenset[int] = frozenset()  # widths of rows that stay unchanged

    def __init__(
        self, table: Table, head: Head, decimals: frozenset[int], thousands: frozenset[int] | None
    ) -> None:
        """Join decimals, and thousands (None: maybe decimals), in the columns at these indices."""
        self._table, self._head = table, head
        self._decimals, self._thousands = decimals, thousands
        self._spoilt = 0

    @property
    def torn(self) -> int:
        """Number of lines that are no row."""
        return self._table.torn + self._spoilt

    def rows(self) -> Iterator[Row]:
        """The rows; those that cannot be joined stay unchanged."""
        self._spoilt, names = 0, self._head.written
        for number, row in self._table.rows():
            if number <= self._head.row:
                yield number, row
            elif row[0].strip() in names:
                if [cell.strip() for cell in row[: len(names)]] != names:
                    raise AnotherHeaderError(
                        f"row {number} is another header, and commas split the numbers below it: "
                        "save the table with semicolons"
                    )
            elif (joined := self.joined(row)) is not None:
                yield number, joined
            elif self._decimals:
                self._spoilt += 1
            else:
                yield number, row

    def joined(self, row: list[str]) -> list[str] | None:
        """A row as wide as the header; None if no way or several ways fit."""
        width = len(self._head.names)
        if self._decimals:
            return _with_decimals(row, self._decimals, width)
        if len(row) <= width:
            return row
        if len(row) in self.apart or self._thousands is None:
            return None
        ways = _ways(row, width)
        if len(ways) > 1:
            ways = [way for way in ways if way.columns <= self._thousands]
        return ways[0].cells if len(ways) == 1 else None

    def last_row(self) -> list[str]:
        """Always empty: the last row may have to be joined."""
        return []


def joined_table(table: Table, head: Head) -> Table:
    """The table with split numbers joined; InputError if many rows fit in no single way."""
    width = len(head.names)
    rows: dict[int, list[Row]] = {}
    counts: Counter[int] = Counter()
    for row in until_broken(data_rows(table, head)):
        size = len(row[1])
        counts[size] += 1
        if counts[size] <= TRIED_ROWS:
            rows.setdefault(size, []).append(row)
    least = max(LEAST_ROWS, LEAST_SHARE * counts.total())
    wide = {size: same_width for size, same_width in sorted(rows.items()) if size > width}
    if any(layout_of(same_width[0][1]) for same_width in wide.values()):
        return table  # an app whose rows are wider than its header
    thousands: set[int] = set()
    for same_width in wide.values():
        ways = (_ways(row, width) for _, row in same_width)
        thousands.update(*(way[0].columns for way in ways if len(way) == 1))
    written = (
        cell.strip() for same_width in rows.values() for _, row in same_width for cell in row
    )
    has_points = any(map(_POINT.fullmatch, written))  # then commas separate thousands
    commonest = max(counts, key=lambda size: counts[size])
    layouts = _decimal_layouts([row for _, row in wide.get(commonest, [])], width)
    decimals = frozenset(layouts[0] if len(layouts) == 1 else ())
    joined = JoinedTable(table, head, decimals, frozenset(thousands) if has_points else None)
    apart: set[int] = set()
    for size, same_width in wide.items():
        bad = [row for row in same_width if joined.joined(row[1]) is None]
        if len(bad) <= LEAST_SHARE * len(same_width):
            continue
        apart.add(size)
        split = sum(bool(_ways(row, width)) for _, row in same_width) > 0.5 * len(same_width)
        continues = not (decimals or split) and _continues(same_width, rows.get(width, []))
        if counts[size] >= least and not continues:
            number, cells = bad[0]
            raise InputError(
                f"row {number} has {size} cells under {width} names ({','.join(cells)[:60]!r}): "
                "if commas split its numbers, save the table with semicolons, or with points in "
                "its numbers"
            )
    joined.apart = frozenset(apart)
    return joined


def _decimal_layouts(rows: Sequence[list[str]], width: int) -> list[tuple[int, ...]]:
    """Sets of columns whose numbers a decimal comma may split in all these rows."""
    extra = len(rows[0]) - width if rows else 0
    if not 0 < extra <= width or comb(width, extra) > MOST_LAYOUTS:
        return []
    return [
        columns
        for columns in combinations(range(width), extra)
        if _fits(rows, set(columns), width)
    ]


def _fits(rows: Sequence[list[str]], columns: set[int], width: int) -> bool:
    """True if these columns can be split in all rows, with equal decimals in each."""
    digits: dict[int, int] = {}
    for row in rows:
        at = 0
        for column in range(width):
            cell = row[at].strip()
            if column not in columns:
                if _NO_NUMBER.fullmatch(cell):
                    return False
                at += 1
                continue
            decimals = row[at + 1].strip()
            if not (_WHOLE.fullmatch(cell) or _CLOCK.match(cell)) or not decimals.isdigit():
                return False
            if digits.setdefault(column, len(decimals)) != len(decimals):
                return False
            at += 2
    return True


def _with_decimals(row: list[str], columns: frozenset[int], width: int) -> list[str] | None:
    cells: list[str] = []
    at = 0
    while at < len(row):
        split = len(cells) in columns and not is_missing(row[at])
        if split and not (at + 1 < len(row) and row[at + 1].strip().isdigit()):
            return None
        step = 2 if split else 1
        cells.append(",".join(row[at : at + step]))
        at += step
    return cells if len(cells) == width else None


def _ways(row: list[str], width: int) -> list[_Way]:
    """Up to `MOST_WAYS` ways to join thousands so that a row has `width` cells."""
    ways: list[_Way] = []

    def extend(at: int, cells: list[str], columns: frozenset[int]) -> None:
        left = width - len(cells)
        if len(ways) == MOST_WAYS or left > len(row) - at:
            return
        if not left:
            if at == len(row):
                ways.append(_Way(cells, columns))
            return
        extend(at + 1, [*cells, row[at]], columns)
        if not _LEAD.fullmatch(row[at].strip()):
            return
        for end in range(at + 1, len(row)):
            if not _LAST_GROUP.fullmatch(row[end].strip()):
                return
            number = "".join(cell.strip() for cell in row[at : end + 1])
            extend(end + 1, [*cells, number], columns | {len(cells)})
            if not _GROUP.fullmatch(row[end].strip()):
                return

    if len(row) - width <= MOST_GROUPS:
        extend(0, [], frozenset())
    return ways


def _continues(wide: Sequence[Row], exact: Sequence[Row]) -> bool:
    """True if wide rows only have more cells at their end, as from an updated app."""
    if not exact or exact[0][0] > wide[0][0]:
        return False
    longer, rows = [row for _, row in wide], [row for _, row in exact]
    return all(_numeric(longer, place) == _numeric(rows, place) for place in range(len(rows[0])))


def _numeric(rows: Sequence[list[str]], place: int) -> bool:
    cells = [row[place].strip() for row in rows if row[place].strip()]
    numbers = sum(bool(re.fullmatch(r"[+-]?\d+([.,]\d*)?", cell)) for cell in cells)
    return 2 * numbers > len(cells)
