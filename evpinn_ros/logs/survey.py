"""Surveys a whole table before it is read: header, widths of rows, some cells.

Continued logs of some apps have no header. A table with one value per row is read as a wide one:
Car Scanner's "All in one" export is `SECONDS;PID;VALUE;UNITS;LATITUDE;LONGTITUDE`, with seconds
since midnight and names in the phone's language (obd2_viewer, tests of `car_scanner.dart`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.logs.apps import ANNOTATIONS, layout_of
from evpinn_ros.logs.batch import Batch, Row, batches_of
from evpinn_ros.logs.numbers import POINT, Style, is_missing, style_of
from evpinn_ros.logs.quantities import BY_COLUMN, QUANTITIES, known_unit, may_be_of_use, score
from evpinn_ros.logs.text_table import TextTable

with optional_imports():
    import polars as pl

# The columns of a table with one value per row.
NAMES = (
    *("pid", "name", "signal", "parameter", "metric", "sensor", "channel", "item"),
    *("variable", "_field"),  # of pandas' melt, and of InfluxDB
)
VALUES = ("value", "reading", "wert", "val", "_value")
UNITS = ("units", "unit", "einheit")
OTHER_SHEETS = "# sheets that are not read: "
HEADER_WITHIN = 60  # first rows that may hold the header
LEAST_SHARE = 0.02  # of rows wider than the header, which an updated app wrote
NARROW_SHARE = 0.05  # of narrower rows, which omit empty cells at the end
ROWS_THAT_TELL = 2000  # rows after which an unreadable table is refused
MOST_CELLS = 500_000  # cells kept
MOST_ROWS = 300_000  # rows examined: eight hours at 10 Hz

MOST_SIGNALS = 10_000


class AnotherHeaderError(InputError):
    """A header in the middle of a table has other columns."""


class Table(Protocol):
    """Rows of cells that can be iterated again."""

    @property
    def torn(self) -> int:
        """Number of lines that are no row; complete after `rows`."""

    def rows(self) -> Iterator[Row]:
        """Every row that is not blank, with the header; InputError where the file breaks off."""

    def last_row(self) -> list[str]:
        """The cells of the last row; empty if unknown without reading the whole table."""


@dataclass(slots=True)
class Head:
    """The header of a table."""

    names: list[str]  # of the columns
    row: int  # its row number; data follow below
    comments: list[str] = field(default_factory=list)  # the lines before it
    written: list[str] = field(default_factory=list)  # the names without units of a row below

    def __post_init__(self) -> None:
        self.written = self.written or self.names


def find_head(table: Table) -> Head:
    """The header: the first row that names quantities, or the layout of a known app.

    Units in the row below are added to the names. InputError: no rows, or only one column.
    """
    rows = list(islice(table.rows(), HEADER_WITHIN))
    if not rows:
        raise InputError("the file is empty")
    place = next((i for i, (_, row) in enumerate(rows) if names_some(row)), None)
    if place is None:
        layouts = (layout_of(row) for _, row in rows)
        if names := next(filter(None, layouts), None):
            return Head(names, rows[0][0] - 1)
        place = 0
    number, row = rows[place]
    names = [name.strip().strip("\ufeff") for name in row]
    if len(names) == 1 and len(names[0].split()) > 2:
        raise InputError(
            f"only one column, {names[0][:60]!r}: separate the cells by commas, semicolons, tabs "
            "or bars, not by blanks"
        )
    comments = [",".join(cells) for _, cells in rows[:place]]
    written = names
    if place + 1 < len(rows) and (units := _units_row(names, rows[place + 1][1])):
        number = rows[place + 1][0]
        names = [
            f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)
        ]
    return Head(_distinct(names), number, comments, written)


def _distinct(names: Sequence[str]) -> list[str]:
    """Names of columns; duplicates are numbered so that `--column` can select each."""
    seen: Counter[str] = Counter()
    distinct = []
    for name in names:
        seen[name] += 1
        twin = seen[name] > 1 and name and name not in BY_COLUMN
        distinct.append(f"{name} #{seen[name]}" if twin else name)
    return distinct


def long_form(head: Head) -> tuple[int, int, int | None] | None:
    """Indices of the names, values and units of a long table; None for other tables."""
    names = [name.strip().lower() for name in head.names]

    def place(words: Sequence[str]) -> int | None:
        return next((names.index(word) for word in words if word in names), None)

    name, value = place(NAMES), place(VALUES)
    if name is None or value is None or name == value:
        return None
    return name, value, place(UNITS)


def names_some(row: Sequence[str]) -> bool:
    """True if two cells of a row or more are names of quantities."""
    if not row or row[0] in ANNOTATIONS:
        return False
    names = [cell.strip() for cell in row if 0 < len(cell) < 100]
    names = [name for name in names if not name[:1].isdigit()][:1000]
    quantities = {
        quantity
        for quantity, meaning in QUANTITIES.items()
        for name in names
        if name == meaning.column or score(quantity, name) > 0
    }
    return len(quantities) >= 2 or ("time" in quantities and long_form(Head(names, 0)) is not None)


def _units_row(names: Sequence[str], row: Sequence[str]) -> list[str]:
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
    others = (cell.lower() for cell in cells if cell)
    are_units = all(any(known_unit(name, cell) for name in QUANTITIES) for cell in others)
    return cells if len(units) >= 2 or (units and are_units) else []


@dataclass
class Survey:
    """Result of a survey of a table."""

    cells: dict[int, pl.Series]  # of each wanted column, in file order, evenly thinned
    widths: Counter[int]  # number of rows by number of cells
    width: int  # of the header
    stride: int = 1  # rows of the table per kept row
    empty: frozenset[int] = frozenset()  # indices of columns without a cell in the examined rows

    @cached_property
    def styles(self) -> dict[int, Style]:
        """Number style of each wanted column; an undecided column gets that of the others."""
        styles = {place: style_of(cells) for place, cells in self.cells.items()}
        given = Counter(style for style in styles.values() if style is not None)
        common = given.most_common(1)[0][0] if given else POINT
        return {place: style or common for place, style in styles.items()}

    @property
    def is_wider(self) -> bool:
        """True if rows have more cells than the header."""
        return any(width > self.width for width in self.widths)

    def put_in_order(self, rows: NDArray[np.intp]) -> None:
        """Sort the kept rows by these indices."""
        self.cells = {place: column[rows] for place, column in self.cells.items()}

    def forget_cells(self) -> None:
        """Keep only the number styles while the table is read."""
        self.cells = dict.fromkeys(self.styles, pl.Series(dtype=pl.String))

    def is_whole(self, width: int) -> bool:
        """True if a row with this number of cells is not torn."""
        if width == self.width:
            return True
        least, share = (3, LEAST_SHARE) if width > self.width else (10, NARROW_SHARE)
        return self.widths[width] >= max(least, share * self.widths.total())


def look_through(
    table: Table,
    head: Head,
    wanted: Sequence[int],
    early: Callable[[Survey], object],
    limit: int = MOST_ROWS,
) -> Survey:
    """Survey of every k-th row; `early` gets that of `ROWS_THAT_TELL`, to raise before a bomb."""
    widths: Counter[int] = Counter()
    kept = [pl.Series(dtype=pl.String) for _ in wanted]
    most = max(1000, MOST_CELLS // max(1, len(wanted)))
    stride, seen = 1, 0  # rows
    empty = set(range(len(head.names)))

    def survey() -> Survey:
        cells = dict(zip(wanted, kept, strict=True))
        return Survey(cells, widths, len(head.names), stride, frozenset(empty))

    for whole in until_broken(data_batches(table, head)):
        batch = whole.part(0, limit - seen)
        widths.update(batch.widths.tolist())
        empty = {place for place in empty if all(map(is_missing, batch.cells(place)))}
        for column, place in zip(kept, wanted, strict=True):
            column.append(batch.cells(place)[-seen % stride :: stride])
        while kept and len(kept[0]) > most:
            kept, stride = [column.gather_every(2) for column in kept], 2 * stride
        if seen <= ROWS_THAT_TELL < seen + len(batch):
            early(survey())
        seen += len(batch)
        if seen >= limit:
            break
    return survey()


Broken = TypeVar("Broken", Row, Batch)


def until_broken(parts: Iterator[Broken]) -> Iterator[Broken]:
    """The rows, or batches, up to damage, which only the later reading reports."""
    try:
        yield from parts
    except AnotherHeaderError:
        raise
    except InputError:
        return


def data_batches(table: Table, head: Head) -> Iterator[Batch]:
    """`data_rows` in batches."""
    below = _Below(head)
    for batch in table.batches() if isinstance(table, TextTable) else batches_of(table.rows()):
        if len(batch) and below.are_as_the_first(batch):
            yield batch.within(max(len(head.names), 1))
        else:
            yield from batches_of(below.rows(batch.rows()))


def data_rows(table: Table, head: Head) -> Iterator[Row]:
    """The rows below the header, without comments and repeated headers."""
    return _Below(head).rows(table.rows())


class _Below:
    """Rows below a header, in the order of its columns."""

    def __init__(self, head: Head) -> None:
        self._head, self._names = head, frozenset(head.written)
        # Order of the header's columns below another header.
        self._places: list[int | None] | None = None

    def are_as_the_first(self, batch: Batch) -> bool:
        """True if rows are no headers, and have just the columns of the first header."""
        if self._places is not None or batch.lines[0] <= self._head.row:
            return False
        beyond = batch.columns[max(len(self._head.names), 1) :]
        numbers = batch.columns[0].str.contains("^[ 0-9+.-]").all()
        names = any(name[:1] in _NO_NAME for name in self._names)
        return bool(numbers) and not names and not any((c != "").any() for c in beyond)

    def rows(self, rows: Iterator[Row]) -> Iterator[Row]:
        head, width = self._head, len(self._head.names)
        for number, row in rows:
            cell = row[0]
            if number <= head.row or cell[:1] == "#":
                continue
            if (cell[:1] not in _NO_NAME or cell in self._names) and _is_header(row, head):
                self._places = _places_below(row, head, number)
                continue
            if self._places is not None:
                row = [row[at] if at is not None and at < len(row) else "" for at in self._places]
            elif len(row) > width and not any(row[width:]):
                row = row[:width]  # each line ends with a separator
            yield number, row


_NO_NAME = frozenset(" 0123456789+-.")  # first characters of a number or a time


def _is_header(row: Sequence[str], head: Head) -> bool:
    """True if an app wrote another header here, after a restart for example."""
    names = {cell.strip().strip("\ufeff") for cell in row}
    if len(names.intersection(head.written)) >= min(2, len(head.written)):
        return True
    if any(map(str.isdigit, row[0])) or long_form(head) is not None:
        return False  # in a long table each row contains names
    return names_some(row)


def _places_below(row: Sequence[str], head: Head, number: int) -> list[int | None] | None:
    """Indices of the first header's columns below another; None if the same; InputError."""
    names = [cell.strip().strip("\ufeff") for cell in row]
    if names == head.written[: len(names)] or names[: len(head.written)] == head.written:
        return None
    for name in head.written:
        if name and name not in names and (score("time", name) > 0 or may_be_of_use(name)):
            raise AnotherHeaderError(
                f"row {number} is another header, without {name!r}: split the file there"
            )
    return [names.index(name) if name in names else None for name in head.written]


class LongTable:
    """A long table as a wide one with its useful columns; one value per row."""

    def __init__(self, table: Table, head: Head, places: tuple[int, int, int | None]) -> None:
        """Find all signals in one pass; `places` index the columns of names, values and units."""
        self._table, self._head = table, head
        self._name, self._value, self._unit = places
        self._last = max(place for place in places if place is not None)
        self._narrow = 0
        self._time = [i for i, name in enumerate(head.names) if score("time", name) > 0]
        self._columns: dict[tuple[str, str], int] = {}
        self.others: list[str] = []  # names of signals without a column
        self._names = [head.names[i] for i in self._time]
        self._find()

    @property
    def torn(self) -> int:
        """Number of lines that are no row."""
        return self._narrow + self._table.torn

    def rows(self) -> Iterator[Row]:
        """The header, then a row for each value of a signal with a column."""
        yield self._head.row, self._names
        width = len(self._names)
        self._narrow = 0
        for number, row in data_rows(self._table, self._head):
            if len(row) <= self._last:
                self._narrow += 1
                continue
            place = self._columns.get((row[self._name], self._unit_of(row)))
            if place is None:
                continue
            cells = [""] * width
            for at, time in enumerate(self._time):
                cells[at] = row[time] if time < len(row) else ""
            cells[place] = row[self._value]
            yield number, cells

    def last_row(self) -> list[str]:
        """The times of the last row; empty if the table does not show it."""
        row = self._table.last_row()
        return [row[time] for time in self._time if time < len(row)]

    def _find(self) -> None:
        seen: set[tuple[str, str]] = set()
        for _, row in until_broken(data_rows(self._table, self._head)):
            if len(row) <= self._last:
                continue
            key = row[self._name], self._unit_of(row)
            if key in seen or len(seen) >= MOST_SIGNALS:
                continue
            seen.add(key)
            name, unit = key[0].strip(), key[1].strip()
            if may_be_of_use(name):
                self._columns[key] = len(self._names)
                self._names.append(f"{name} ({unit})" if unit else name)
            else:
                self.others.append(name)

    def _unit_of(self, row: Sequence[str]) -> str:
        return row[self._unit] if self._unit is not None else ""
