"""Consecutive rows of a table, converted together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.optional import optional_imports

with optional_imports():
    import polars as pl

Row = tuple[int, list[str]]  # line number in the file, cells
Cells: TypeAlias = "Sequence[str] | pl.Series"

MOST_ROWS, MOST_CELLS = 16_384, 500_000  # of a batch


@dataclass(frozen=True, slots=True)
class Batch:
    """Rows of a table, column by column."""

    lines: Sequence[int]  # numbers of the rows' lines in the file
    columns: Sequence[pl.Series]  # text of each column, "" for cells missing in a shorter row
    widths: NDArray[np.int64]  # number of cells in each row

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Batch:
        """A batch of rows."""
        cells = [row for _, row in rows]
        columns = zip_longest(*cells, fillvalue="")
        return cls(
            [line for line, _ in rows],
            [pl.Series("", column, dtype=pl.String) for column in columns],
            np.array([len(row) for row in cells], np.int64),
        )

    def __len__(self) -> int:
        return len(self.lines)

    def cells(self, place: int) -> pl.Series:
        """Cells of a column; "" where a row is shorter."""
        if place < len(self.columns):
            return self.columns[place]
        return pl.repeat("", len(self), dtype=pl.String, eager=True)

    def rows(self) -> Iterator[Row]:
        """The rows one by one."""
        cells = zip(*(column.to_list() for column in self.columns), strict=True)
        for line, width, row in zip(self.lines, self.widths.tolist(), cells, strict=True):
            yield line, list(row[:width])

    def where(self, chosen: NDArray[np.bool_]) -> Batch:
        """The rows where `chosen`, a mask of shape (n,), is True."""
        lines = [self.lines[place] for place in np.flatnonzero(chosen).tolist()]
        columns = [column.filter(pl.Series(chosen)) for column in self.columns]
        return Batch(lines, columns, self.widths[chosen])

    def part(self, first: int, last: int | None = None) -> Batch:
        """The rows from `first` to before `last`."""
        rows = slice(first, last)
        columns = [column[rows] for column in self.columns]
        return Batch(self.lines[rows], columns, self.widths[rows])

    def within(self, width: int) -> Batch:
        """The first `width` columns."""
        return Batch(self.lines, self.columns[:width], np.minimum(self.widths, width))


def batches_of(rows: Iterable[Row]) -> Iterator[Batch]:
    """Batches of rows; the rows before an error of the table are yielded before it is raised."""
    batch: list[Row] = []
    cells = 0
    try:
        for row in rows:
            batch.append(row)
            cells += len(row[1])
            if len(batch) == MOST_ROWS or cells > MOST_CELLS:
                yield Batch.of(batch)
                batch, cells = [], 0
    except Exception:
        yield Batch.of(batch)
        raise
    if batch:
        yield Batch.of(batch)


def regrouped(batches: Iterable[Batch]) -> Iterator[Batch]:
    """The same rows in batches as large as those of `batches_of`."""
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
    """One batch of the rows of several."""
    if len(batches) == 1:
        return batches[0]
    places = range(max(len(batch.columns) for batch in batches))
    return Batch(
        [line for batch in batches for line in batch.lines],
        [pl.concat([batch.cells(place) for batch in batches]) for place in places],
        np.concatenate([batch.widths for batch in batches]),
    )
