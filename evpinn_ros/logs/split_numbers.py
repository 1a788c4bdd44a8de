"""Numbers that their own commas split, because commas separate the cells as well.

`0,00,349,84` may be two numbers with decimal commas, `1,000.0` one with a comma between
thousands. They are joined again where only one way fits; otherwise the table is refused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from math import comb
import re
from typing import NamedTuple

from evpinn_ros.common.errors import InputError
from evpinn_ros.logs.apps import layout_of
from evpinn_ros.logs.survey import Head, Table, data_rows, until_broken
from evpinn_ros.logs.text_table import Row

MOST_LAYOUTS = 5000  # ways to join that are tried
TRIED_ROWS = 500  # of one width
LEAST_SHARE = 0.02  # of the rows that are too wide: fewer are torn
LEAST_ROWS = 3

MOST_GROUPS, MOST_WAYS = 6, 8  # in a row, and ways to join it, that are looked at

_WHOLE = re.compile(r"[+-]?(0|[1-9]\d*)")
_PADDED = re.compile(r"[+-]?0\d+")  # 05 is the decimals of a number, not a number
_CLOCK = re.compile(r".*\d:\d\d")  # whose seconds may have decimals
_GROUP, _LAST_GROUP = re.compile(r"\d{3}"), re.compile(r"\d{3}(\.\d*)?")
_LEAD = re.compile(r"[+-]?[1-9]\d{0,2}")


class _Way(NamedTuple):
    """A way to join the cells of a row."""

    cells: list[str]
    columns: frozenset[int]  # those that were split


class JoinedTable:
    """A table whose rows are as wide as its header, where they can be joined in one way.

    Attributes:
        apart: widths of rows that are left as they are.
    """

    apart: frozenset[int] = frozenset()

    def __init__(
        self,
        table: Table,
        head: Head,
        decimals: Mapping[int, tuple[int, ...]],
        thousands: frozenset[int],
    ) -> None:
        """Join rows.

        `decimals` has for a width the columns that a decimal comma splits, `thousands` those that
        are split where their numbers are large.
        """
        self._table, self._head = table, head
        self._decimals, self._thousands = decimals, thousands

    @property
    def torn(self) -> int:
        """Lines that are no row."""
        return self._table.torn

    def rows(self) -> Iterator[Row]:
        """The rows, those that cannot be joined as they are."""
        width = len(self._head.names)
        for number, row in self._table.rows():
            if number > self._head.row and len(row) > width:
                row = self.joined(row, width) or row
            yield number, row

    def joined(self, row: list[str], width: int) -> list[str] | None:
        """A row of so many cells; None where there is no way, or several."""
        if len(row) in self.apart:
            return None
        if columns := self._decimals.get(len(row)):
            return _with_decimals(row, columns)
        ways = _ways(row, width)
        if len(ways) > 1:
            ways = [way for way in ways if way.columns <= self._thousands]
        return ways[0].cells if len(ways) == 1 else None

    def last_row(self) -> list[str]:
        """None: it may have to be joined."""
        return []


def joined_table(table: Table, head: Head) -> Table:
    """The table with split numbers joined again.

    Raises:
        InputError: many of its rows are wider than the header, and not in one way.
    """
    width = len(head.names)
    rows: dict[int, list[Row]] = {}
    counts: Counter[int] = Counter()
    for row in until_broken(data_rows(table, head)):
        size = len(row[1])
        counts[size] += 1
        if counts[size] <= TRIED_ROWS:
            rows.setdefault(size, []).append(row)
    least = max(LEAST_ROWS, LEAST_SHARE * counts.total())
    decimals: dict[int, tuple[int, ...]] = {}
    thousands: set[int] = set()
    wide = {size: found for size, found in sorted(rows.items()) if size > width}
    if any(layout_of(found[0][1]) for found in wide.values()):  # which has cells without a name
        return table
    for size, found in wide.items():
        layouts = _decimal_layouts([row for _, row in found], width)
        if len(layouts) == 1 and counts[size] >= least:
            decimals[size] = layouts[0]
        ways = (_ways(row, width) for _, row in found)
        thousands.update(*(way[0].columns for way in ways if len(way) == 1))
    whole = JoinedTable(table, head, decimals, frozenset(thousands))
    exact = [row for _, row in rows.get(width, [])]
    apart: set[int] = set()
    for size, found in wide.items():
        bad = [row for row in found if whole.joined(row[1], width) is None]
        if len(bad) > LEAST_SHARE * len(found) and size not in decimals:
            apart.add(size)
            split = sum(bool(_ways(row, width)) for _, row in found) > 0.5 * len(found)
            if counts[size] >= least and (split or not _continues(found, exact)):
                number, cells = bad[0]
                raise InputError(
                    f"row {number} has {size} cells under {width} names "
                    f"({','.join(cells)[:60]!r}): if commas split its numbers, save the table "
                    "with semicolons, or with points in its numbers"
                )
    whole.apart = frozenset(apart)
    return whole


def _decimal_layouts(rows: Sequence[list[str]], width: int) -> list[tuple[int, ...]]:
    """Sets of columns whose numbers a decimal comma may split in all these rows."""
    extra = len(rows[0]) - width
    if not 0 < extra <= width or comb(width, extra) > MOST_LAYOUTS:
        return []
    return [
        columns
        for columns in combinations(range(width), extra)
        if _fits(rows, set(columns), width)
    ]


def _fits(rows: Sequence[list[str]], columns: set[int], width: int) -> bool:
    """True if these columns can be split in all rows, with as many decimals in each."""
    digits: dict[int, int] = {}
    for row in rows:
        at = 0
        for column in range(width):
            cell = row[at].strip()
            if column not in columns:
                if _PADDED.fullmatch(cell):
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


def _with_decimals(row: list[str], columns: Sequence[int]) -> list[str]:
    cells: list[str] = []
    at = 0
    while at < len(row):
        step = 2 if len(cells) in columns else 1
        cells.append(",".join(row[at : at + step]))
        at += step
    return cells


def _ways(row: list[str], width: int) -> list[_Way]:
    """The ways, `MOST_WAYS` at most, to join thousands so that a row has so many cells."""
    ways: list[_Way] = []

    def go_on(at: int, cells: list[str], columns: frozenset[int]) -> None:
        left = width - len(cells)
        if len(ways) == MOST_WAYS or left > len(row) - at:
            return
        if not left:
            if at == len(row):
                ways.append(_Way(cells, columns))
            return
        go_on(at + 1, [*cells, row[at]], columns)
        if not _LEAD.fullmatch(row[at].strip()):
            return
        for end in range(at + 1, len(row)):
            if not _LAST_GROUP.fullmatch(row[end].strip()):
                return
            number = "".join(cell.strip() for cell in row[at : end + 1])
            go_on(end + 1, [*cells, number], columns | {len(cells)})
            if not _GROUP.fullmatch(row[end].strip()):
                return

    if len(row) - width <= MOST_GROUPS:
        go_on(0, [], frozenset())
    return ways


def _continues(wide: Sequence[Row], rows: Sequence[list[str]]) -> bool:
    """True if wide rows have more cells at their end alone, as an app writes that was updated.

    The others then hold numbers where rows of the header's width do.
    """
    longer = [row for _, row in wide]
    return bool(rows) and all(
        _numeric(longer, place) == _numeric(rows, place) for place in range(len(rows[0]))
    )


def _numeric(rows: Sequence[list[str]], place: int) -> bool:
    cells = [row[place].strip() for row in rows if row[place].strip()]
    numbers = sum(bool(re.fullmatch(r"[+-]?\d+([.,]\d*)?", cell)) for cell in cells)
    return 2 * numbers > len(cells)
