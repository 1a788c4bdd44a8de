"""Selects the rows of one car: published data sets keep a whole fleet in one table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import takewhile
import re

from evpinn_ros.common.errors import SAY_CAR, InputError, near_names
from evpinn_ros.logs.batch import Row
from evpinn_ros.logs.numbers import is_missing
from evpinn_ros.logs.quantities import words_of
from evpinn_ros.logs.survey import Head, Table, data_rows, until_broken

# Words in the name of a column that identifies cars.
NAMES = frozenset(
    (
        *("car", "car id", "carid", "car name", "car no", "car number", "imei"),
        *("vehicle", "vehicle id", "vehicleid", "veh id", "vehid", "vin", "vehicle name"),
        *("vehicle no", "vehicle number", "device id", "deviceid", "license plate"),
        *("id", "device", "plate", "asset", "asset id", "asset name", "unit id", "tracker id"),
        *(
            "bus",
            "bus no",
            "bus id",
            "bus number",
            "tracker",
            "fleet no",
            "truck",
            "truck id",
            "vehicle ref",
        ),
        *("registration", "registration number"),
        *("serial", "serial number", "serial no", "kennung", "immatriculation", "matricula"),
        *("licence plate", "number plate", "fahrzeug", "kennzeichen", "车牌号", "车架号"),
    )
)
LEAST_OF_CAR = 5  # rows of the most frequent car
LEAST_ROWS, LEAST_SHARE = 20, 0.1  # rows of a car, or their share of the most frequent car's
MOST_CARS = 10_000
MOST_NAMED = 10  # cars listed in a message
FRACTION = re.compile(r"[+-]?\d*[.,]\d*[1-9]0*")


class CarTable:
    """The rows of one car of a table."""

    def __init__(self, table: Table, head: Head, place: int, car: str) -> None:
        self._table, self._head, self._place, self._car = table, head, place, car

    @property
    def torn(self) -> int:
        """Number of lines that are no row, of all cars."""
        return self._table.torn

    def rows(self) -> Iterator[Row]:
        """The rows above the data, then the rows of the car."""
        yield from takewhile(lambda row: row[0] <= self._head.row, self._table.rows())
        for number, row in data_rows(self._table, self._head):  # also below repeated headers
            if _car_of(row, self._place) == self._car:
                yield number, row

    def last_row(self) -> list[str]:
        """Always empty: the end of the file may be of another car."""
        return []


def table_of_car(table: Table, head: Head, car: str | None) -> Table:
    """The table, or the rows of the chosen car; InputError: no choice, or no such car."""
    rows = _rows_by_car(table, head)
    cars = {place: names for place in rows if (names := _cars(rows[place]))}
    if not cars:
        if car is not None:
            raise InputError(f"no column names cars, so --car {car!r} selects none")
        return table
    place = max(cars, key=lambda column: len(cars[column]))  # a column of models may exist too
    names = cars[place]
    there = f"column {head.names[place]!r} has {', '.join(names[:MOST_NAMED])}"
    if len(names) > MOST_NAMED:
        there += f" and {len(names) - MOST_NAMED} more"
    if car is not None:
        if car not in rows[place]:
            raise InputError(f"no row of the car {car!r}{near_names(car, names)}; {there}")
        return CarTable(table, head, place, car)
    if len(names) > 1:
        raise InputError(f"rows of {len(names)} cars; {there}; {SAY_CAR}")
    return table


def _rows_by_car(table: Table, head: Head) -> dict[int, Counter[str]]:
    words = {place: words_of(name) for place, name in enumerate(head.names)}
    # A bracket in a name is a unit: `Vin [V]` is a voltage.
    rows: dict[int, Counter[str]] = {
        place: Counter()
        for place, (name, unit) in words.items()
        if name.strip() in NAMES and not unit
    }
    for _, row in until_broken(data_rows(table, head)) if rows else ():
        for place, cars in rows.items():
            car = _car_of(row, place)
            if car in cars or len(cars) < MOST_CARS:
                cars[car] += 1
    return rows


def _cars(rows: Counter[str]) -> list[str]:
    """The cars in a column, sorted; empty if the column holds measured values."""
    commonest = max(rows.values(), default=0)
    if commonest < LEAST_OF_CAR:  # each row has its own value
        return []
    least = min(LEAST_ROWS, LEAST_SHARE * commonest)
    cars = sorted(car for car, count in rows.items() if count >= least and not is_missing(car))
    return [] if any(map(FRACTION.fullmatch, cars)) else cars


def _car_of(row: list[str], place: int) -> str:
    return row[place].strip() if place < len(row) else ""
