"""The rows of one car: published data sets keep a whole fleet in one table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import islice

from evpinn_ros.common.errors import SAY_CAR, InputError, near_names
from evpinn_ros.drives.numbers import is_missing
from evpinn_ros.drives.quantities import words_of
from evpinn_ros.drives.survey import MOST_ROWS, Head, Table, data_rows
from evpinn_ros.drives.text_table import Row

# Names of a column that tells cars apart, by their words.
NAMES = frozenset(
    ("car", "car id", "carid", "vehicle", "vehicle id", "vehicleid", "veh id", "vehid", "vin")
)
LEAST_ROWS = 20  # of a car; what fewer rows have is of rows that are torn
MOST_NAMED = 10  # cars in a message


class CarTable:
    """The rows of one car of a table."""

    def __init__(self, table: Table, head: Head, place: int, car: str) -> None:
        """Take the rows that have the car in the column at this place."""
        self._table, self._head, self._place, self._car = table, head, place, car

    @property
    def torn(self) -> int:
        """Lines that are no row, of all cars."""
        return self._table.torn

    def rows(self) -> Iterator[Row]:
        """The rows above the data, then those of the car."""
        for number, row in self._table.rows():
            if number <= self._head.row or _car_of(row, self._place) == self._car:
                yield number, row

    def last_row(self) -> list[str]:
        """None: the end of the file may be of another car."""
        return []


def table_of_car(table: Table, head: Head, car: str | None) -> Table:
    """The table, or of one of several cars the rows of the one that is asked for.

    Raises:
        InputError: it holds several and none is asked for, or one that it does not hold.
    """
    place = next(
        (i for i, name in enumerate(head.names) if words_of(name)[0].strip() in NAMES), -1
    )
    if place < 0:
        if car is not None:
            raise InputError(f"no column tells cars apart, so there is no car {car!r}")
        return table
    looked = islice(data_rows(table, head), MOST_ROWS)
    rows = Counter(_car_of(row, place) for _, row in looked)
    cars = {name for name, count in rows.items() if count >= LEAST_ROWS and not is_missing(name)}
    there = f"column {head.names[place]!r} has {', '.join(sorted(cars)[:MOST_NAMED])}"
    if len(cars) > MOST_NAMED:
        there += f" and {len(cars) - MOST_NAMED} more"
    if car is not None:
        if car not in rows:
            raise InputError(f"no row of the car {car!r}{near_names(car, cars)}; {there}")
        return CarTable(table, head, place, car)
    if len(cars) > 1:
        raise InputError(f"rows of {len(cars)} cars; {there}; {SAY_CAR}")
    return table


def _car_of(row: list[str], place: int) -> str:
    return row[place].strip() if place < len(row) else ""
