"""Readings of one car as columns, in the order in which they came.

A node makes a block of the readings since its last callback, a replay of some minutes of a file.
How readings are cut into blocks changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import NamedTuple, get_args

import numpy as np

from evpinn_ros.core.signals.readings import MOST_STAMP, RANGES, Reading

KINDS: tuple[type[Reading], ...] = get_args(Reading)
FIELDS: Mapping[type[Reading], tuple[str, ...]] = {
    kind: tuple(field.name for field in fields(kind))[1:] for kind in KINDS
}
"""Values of each kind of reading, after its stamp."""
_READERS = {kind: attrgetter(*names) for kind, names in FIELDS.items()}


class Rows(NamedTuple):
    """Readings of one kind.

    Attributes:
        order: their places among all readings of the block, increasing, shape (n,).
        stamps: ns, shape (n,).
        values: a row for each of `FIELDS`, shape (fields, n).
    """

    order: np.ndarray
    stamps: np.ndarray
    values: np.ndarray

    def where(self, chosen: np.ndarray | slice) -> Rows:
        """The rows of a mask or slice."""
        return Rows(self.order[chosen], self.stamps[chosen], self.values[:, chosen])


NO_ROWS = {
    kind: Rows(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((len(names), 0)))
    for kind, names in FIELDS.items()
}


@dataclass(frozen=True, slots=True)
class Block:
    """Readings in the order in which they came.

    Attributes:
        length: number of places.
        rows: by kind; kinds without readings are missing.
    """

    length: int
    rows: Mapping[type[Reading], Rows]

    @classmethod
    def of(cls, readings: Iterable[Reading]) -> Block:
        """A block of readings; an impossible stamp becomes one beyond `MOST_STAMP`."""
        orders: dict[type[Reading], list[int]] = {}
        by_kind: dict[type[Reading], list[Reading]] = {}
        length = 0
        for reading in readings:
            kind = type(reading)
            if kind not in orders:
                orders[kind], by_kind[kind] = [], []
            orders[kind].append(length)
            by_kind[kind].append(reading)
            length += 1
        rows = {
            kind: _rows_of(kind, np.array(order, np.int64), by_kind[kind])
            for kind, order in orders.items()
        }
        return cls(length, rows)

    @classmethod
    def sorted(cls, rows: Mapping[type[Reading], Rows]) -> Block:
        """A block of rows, each kind in order of stamps, placed in order of stamps."""
        stamps = np.concatenate([np.empty(0, np.int64), *(some.stamps for some in rows.values())])
        places = np.empty(len(stamps), np.int64)
        places[stamps.argsort(kind="stable")] = np.arange(len(stamps))
        placed, begin = {}, 0
        for kind, (_, of_kind, values) in rows.items():
            end = begin + len(of_kind)
            placed[kind] = Rows(places[begin:end], of_kind, values)
            begin = end
        return cls(len(stamps), placed)

    def __len__(self) -> int:
        return self.length

    def of_kind(self, kind: type[Reading]) -> Rows:
        """Rows of a kind; empty if there are none."""
        return self.rows.get(kind) or NO_ROWS[kind]

    def part(self, first: int, last: int) -> Block:
        """The readings from place `first` to before `last`; places begin at 0 again."""
        if first == 0 and last == self.length:
            return self
        rows = {}
        for kind, all_rows in self.rows.items():
            begin, end = np.searchsorted(all_rows.order, (first, last))
            if end > begin:
                some = all_rows.where(slice(begin, end))
                rows[kind] = some._replace(order=some.order - first)
        return Block(last - first, rows)

    def until(self, stamp_ns: int) -> tuple[Block, Block]:
        """A block in order of stamps, cut before a stamp."""
        before = sum(int(rows.stamps.searchsorted(stamp_ns)) for rows in self.rows.values())
        return self.part(0, before), self.part(before, self.length)

    def with_rows(self, kind: type[Reading], rows: Rows) -> Block:
        """The block with other rows of a kind, at places of that kind."""
        return replace(self, rows={**self.rows, kind: rows})

    def parts(self, size: int) -> Iterator[Block]:
        """The block in parts of at most this many places."""
        for first in range(0, self.length, size):
            yield self.part(first, min(first + size, self.length))

    def only(self, chosen: Mapping[type[Reading], np.ndarray]) -> Block:
        """The rows that a mask of each kind chooses, shape (n,), and all of other kinds.

        Places are numbered anew.
        """
        if all(mask.all() for mask in chosen.values()):
            return self
        taken = np.zeros(self.length, dtype=bool)
        rows = {
            kind: some.where(chosen.get(kind, slice(None))) for kind, some in self.rows.items()
        }
        for some in rows.values():
            taken[some.order] = True
        places = np.cumsum(taken) - 1
        rows = {
            kind: some._replace(order=places[some.order])
            for kind, some in rows.items()
            if len(some.order)
        }
        return Block(int(taken.sum()), rows)

    def stamps(self) -> np.ndarray:
        """Stamps by place, ns, shape (length,); 0 at an empty place."""
        stamps = np.zeros(self.length, np.int64)
        for rows in self.rows.values():
            stamps[rows.order] = rows.stamps
        return stamps

    def readings(self) -> Iterator[Reading]:
        """Yields the readings one by one."""
        placed: list[Reading | None] = [None] * self.length
        for kind, (order, stamps, values) in self.rows.items():
            columns = (order.tolist(), stamps.tolist(), *values.tolist())
            for place, *row in zip(*columns, strict=True):
                placed[place] = kind(*row)
        return (reading for reading in placed if reading is not None)


def joined(blocks: Sequence[Block]) -> Block:
    """Concatenated blocks, in order of arrival."""
    begins = np.cumsum([0, *(block.length for block in blocks)]).tolist()
    rows = {}
    for kind in KINDS:
        parts = [
            some._replace(order=some.order + begin)
            for block, begin in zip(blocks, begins, strict=False)
            if (some := block.rows.get(kind)) is not None
        ]
        if parts:
            order, stamps, values = zip(*parts, strict=True)
            rows[kind] = Rows(
                np.concatenate(order), np.concatenate(stamps), np.concatenate(values, axis=1)
            )
    return Block(begins[-1], rows)


def impossible(kind: type[Reading], rows: Rows) -> list[tuple[str, np.ndarray]]:
    """(reason, mask of rows, shape (n,)) of impossible rows; a row has its first reason only."""
    reasons = [("stamp_out_of_range", np.abs(rows.stamps) > MOST_STAMP)]
    for what, field, least, most, unknown in RANGES[kind]:
        value = _value(kind, field, rows)
        possible = (value >= least) & (value <= most)
        reasons.append((f"{what}_out_of_range", ~(possible | (np.isnan(value) & unknown))))
    first: list[tuple[str, np.ndarray]] = []
    before = np.zeros(len(rows.order), dtype=bool)
    for reason, wrong in reasons:
        if (new := wrong & ~before).any():
            first.append((reason, new))
            before |= new
    return first


def _value(kind: type[Reading], field: str, rows: Rows) -> np.ndarray:
    """A field of readings, or `load`, the sum of their fields."""
    names = FIELDS[kind]
    if field in names:
        return np.asarray(rows.values[names.index(field)])
    return np.asarray(rows.values.sum(axis=0))


def _rows_of(kind: type[Reading], order: np.ndarray, readings: Sequence[Reading]) -> Rows:
    beyond = MOST_STAMP + 1
    stamps = [min(max(reading.stamp_ns, -beyond), beyond) for reading in readings]
    values = np.array([_READERS[kind](reading) for reading in readings], dtype=float)
    return Rows(order, np.array(stamps, np.int64), values.reshape(len(readings), -1).T)
