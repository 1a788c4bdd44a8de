"""Tables with one value a row: time, name of the signal, value, unit.

Car Scanner's "All in one" export is `SECONDS;PID;VALUE;UNITS;LATITUDE;LONGTITUDE`, its seconds
counted from midnight and on over the next one, every cell quoted, each line with a separator at
its end, the names in the language of the phone (as its readers say: obd2_viewer's data structure
document, the tests of `car_scanner.dart`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from evpinn_ros.drives.quantities import may_be_of_use, score
from evpinn_ros.drives.survey import Head, Row, Table

MOST_SIGNALS = 10_000


class LongTable:
    """A long table as a wide one, with the columns that may be of use; one value a row.

    Attributes:
        others: names of signals that have no column.
    """

    def __init__(self, table: Table, head: Head, places: tuple[int, int, int | None]) -> None:
        """Find all signals: one pass over the table.

        `places` are those of the columns of names, values and units.
        """
        self._table, self._head = table, head
        self._name, self._value, self._unit = places
        self._last = max(place for place in places if place is not None)
        self._narrow = 0
        self._time = [i for i, name in enumerate(head.names) if score("time", name) > 0]
        self._columns: dict[tuple[str, str], int] = {}
        self.others: list[str] = []
        self._names = [head.names[i] for i in self._time]
        self._find()

    @property
    def torn(self) -> int:
        """Lines that are no row."""
        return self._narrow + self._table.torn

    def rows(self) -> Iterator[Row]:
        """The header, then a row for each value of a signal that has a column."""
        yield self._head.row, self._names
        width = len(self._names)
        self._narrow = 0
        for number, row in self._table.rows():
            if number <= self._head.row:
                continue
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
        """The times of the last row, none where the table does not show it."""
        row = self._table.last_row()
        return [row[time] for time in self._time if time < len(row)]

    def _find(self) -> None:
        seen: set[tuple[str, str]] = set()
        for number, row in self._table.rows():
            if number <= self._head.row or len(row) <= self._last:
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
