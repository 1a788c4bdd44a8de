"""A look through a whole table before it is read: header, widths of rows, some cells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import Protocol

from evpinn_ros.drives.quantities import QUANTITIES, known_unit, score
from evpinn_ros.errors import InputError

HEADER_WITHIN = 60  # rows
LEAST_SHARE = 0.02  # of rows that are wider than the header: an app that was updated
NARROW_SHARE = 0.2  # of narrower ones, which leave out empty cells at the end
MOST_CELLS = 1_000_000  # kept

Row = tuple[int, list[str]]


class Table(Protocol):
    """Rows of text cells, each with its number in the file."""

    def rows(self) -> Iterator[Row]:
        """The rows from the first, header and all."""


@dataclass(slots=True)
class Head:
    """The header of a table.

    Attributes:
        names: of the columns.
        row: its number; data begin below it.
        comments: the lines before it.
    """

    names: list[str]
    row: int
    comments: list[str] = field(default_factory=list)


def find_head(table: Table) -> Head:
    """The first row whose cells are names of ours, a row of units below it joined in.

    Raises:
        InputError: the table is empty or cannot be read.
    """
    rows = list(islice(table.rows(), HEADER_WITHIN))
    if not rows:
        raise InputError("the file is empty")
    place = next((i for i, (_, row) in enumerate(rows) if _names_some(row)), 0)
    number, row = rows[place]
    names = [name.strip().strip("\ufeff") for name in row]
    comments = [",".join(cells) for _, cells in rows[:place]]
    if place + 1 < len(rows) and (units := _units_row(names, rows[place + 1][1])):
        number = rows[place + 1][0]
        names = [
            f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)
        ]
    return Head(names, number, comments)


def _names_some(row: Sequence[str]) -> bool:
    """Whether two cells of a row or more are names of quantities."""
    names = [cell.strip() for cell in row if 0 < len(cell) < 100]
    names = [name for name in names if not name[0].isdigit()][:1000]
    found = {
        quantity
        for quantity, known in QUANTITIES.items()
        for name in names
        if name == known.column or score(quantity, name) > 0
    }
    return len(found) >= 2


def _units_row(names: Sequence[str], row: Sequence[str]) -> list[str]:
    """The units of a row that holds nothing else; empty when it does."""
    cells = [cell.strip().strip("[]()") for cell in row]
    if len(cells) != len(names) or any(
        character.isdigit() for cell in cells for character in cell
    ):
        return []
    units = {
        i
        for i, cell in enumerate(cells)
        for quantity in QUANTITIES
        if cell and score(quantity, names[i]) > 0 and known_unit(quantity, cell.lower())
    }
    return cells if len(units) >= 2 else []


@dataclass(slots=True)
class Survey:
    """What was seen of a table.

    Attributes:
        cells: of each wanted column, in the order of the file, thinned evenly.
        widths: how many rows have so many cells.
        width: of the header.
    """

    cells: dict[int, list[str]]
    widths: Counter[int]
    width: int

    def is_whole(self, width: int) -> bool:
        """Whether a row of so many cells is one of this table and not torn."""
        if width == self.width:
            return True
        share = LEAST_SHARE if width > self.width else NARROW_SHARE
        return self.widths[width] >= max(3.0, share * self.widths.total())


def look_through(
    table: Table, head: Head, wanted: Sequence[int], limit: int | None = None
) -> Survey:
    """Keep the cells of the wanted columns, every k-th row of a long table.

    Args:
        table: to read.
        head: of it.
        wanted: places of columns.
        limit: of rows to look at; all when None.
    """
    widths: Counter[int] = Counter()
    kept: list[tuple[str, ...]] = []
    most = max(1000, MOST_CELLS // max(1, len(wanted)))
    stride = 1
    with suppress(InputError):  # where the file breaks off is told on reading
        for index, (_, row) in enumerate(islice(data_rows(table, head), limit)):
            width = len(row)
            widths[width] += 1
            if index % stride:
                continue
            kept.append(tuple(row[i] if i < width else "" for i in wanted))
            if len(kept) > most:
                kept, stride = kept[::2], 2 * stride
    columns = list(zip(*kept, strict=True)) if kept else [()] * len(wanted)
    cells = {place: list(column) for place, column in zip(wanted, columns, strict=True)}
    return Survey(cells, widths, len(head.names))


def data_rows(table: Table, head: Head) -> Iterator[Row]:
    """The rows below the header, without comments and further headers."""
    again = head.names[:5]  # an app that was restarted writes its header again
    for number, row in table.rows():
        is_header = row[0] == again[0] and [cell.strip() for cell in row[:5]] == again
        if number > head.row and not is_header and not row[0].startswith("#"):
            yield number, row
