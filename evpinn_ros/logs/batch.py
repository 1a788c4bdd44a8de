"""Consecutive rows of a table, converted together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.optional import optional_imports

with optional_imports():
    import polars as pl

Row = tuple[int, list[str]]  # the number of its line in the file, its cells
Cells: TypeAlias = "Sequence[str] | pl.Series"

MOST_ROWS, MOST_CELLS = 16_384, 500_000  # of a batch


class Batch:
    """Rows of a table: as lists of cells, or as columns where all rows are alike.

    Attributes:
        lines: numbers of their lines in the file.
        columns: text of each column, where all rows have as many cells; else None.
    """

    def __init__(
        self,
        lines: Sequence[int],
        rows: Sequence[list[str]] = (),
        columns: Sequence[pl.Series] | None = None,
    ) -> None:
        """Take rows, or columns."""
        self.lines, self._rows, self.columns = lines, rows, columns

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Batch:
        """A batch of rows."""
        return cls([line for line, _ in rows], [cells for _, cells in rows])

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def widths(self) -> NDArray[np.int64]:
        """How many cells each row has."""
        if self.columns is not None:
            return np.full(len(self.lines), len(self.columns))
        return np.array([len(row) for row in self._rows], np.int64)

    def cells(self, place: int) -> Cells:
        """Cells of a column; "" where a row has none there."""
        if self.columns is None:
            return [row[place] if place < len(row) else "" for row in self._rows]
        return self.columns[place] if place < len(self.columns) else [""] * len(self.lines)

    def rows(self) -> Iterator[Row]:
        """The rows one by one."""
        if self.columns is None:
            return zip(self.lines, self._rows, strict=True)
        cells = zip(*(column.to_list() for column in self.columns), strict=True)
        return zip(self.lines, map(list, cells), strict=True)

    def where(self, chosen: NDArray[np.bool_]) -> Batch:
        """The chosen rows, a mask of shape (n,)."""
        places = np.flatnonzero(chosen).tolist()
        lines = [self.lines[place] for place in places]
        if self.columns is None:
            return Batch(lines, [self._rows[place] for place in places])
        return Batch(lines, columns=[column.filter(pl.Series(chosen)) for column in self.columns])

    def part(self, first: int, last: int | None = None) -> Batch:
        """The rows from one place to before another."""
        some = slice(first, last)
        columns = None if self.columns is None else [column[some] for column in self.columns]
        return Batch(self.lines[some], self._rows[some], columns)

    def within(self, width: int) -> Batch | None:
        """Of a batch of columns the first `width` of them; None if a later one has text."""
        columns = self.columns or ()
        if any((column != "").any() for column in columns[width:]):
            return None
        return Batch(self.lines, columns=columns[:width])


def batches_of(rows: Iterable[Row]) -> Iterator[Batch]:
    """Rows in batches; an error of the table is raised after the rows before it."""
    batch: list[Row] = []
    cells = 0
    try:
        for row in rows:
            batch.append(row)
            cells += len(row[1])
            if len(batch) == MOST_ROWS or cells > MOST_CELLS:
                yield Batch.of(batch)
                batch, cells = [], 0
    except InputError:
        yield Batch.of(batch)
        raise
    if batch:
        yield Batch.of(batch)


def regrouped(batches: Iterable[Batch]) -> Iterator[Batch]:
    """The rows in batches as large as those of `batches_of`, however they came."""
    waiting: list[Batch] = []
    for batch in batches:
        waiting.append(batch)
        size = min(MOST_ROWS, MOST_CELLS // max(1, int(waiting[0].widths[0])) + 1)
        while sum(map(len, waiting)) >= size:
            whole = _joined(waiting)
            yield whole.part(0, size)
            rest = whole.part(size)
            waiting = [rest] if len(rest) else []
    if waiting:
        yield _joined(waiting)


def _joined(batches: Sequence[Batch]) -> Batch:
    """Batches one after another; by column where all rows have as many cells."""
    if len(batches) == 1:
        return batches[0]
    lines = [line for batch in batches for line in batch.lines]
    widths = np.unique(np.concatenate([batch.widths for batch in batches]))
    if widths.size > 1:
        return Batch(lines, [row for batch in batches for _, row in batch.rows()])
    columns = (
        [pl.Series("", batch.cells(place), dtype=pl.String) for batch in batches]
        for place in range(int(widths[0]))
    )
    return Batch(lines, columns=[pl.concat(parts) for parts in columns])
