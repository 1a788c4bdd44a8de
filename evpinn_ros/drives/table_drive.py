"""A drive in a table: which column is what, and the readings of its rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.clock_choice import choose_clock
from evpinn_ros.drives.column import Column, check_columns, columns_by_name
from evpinn_ros.drives.evidence import Signal, seconds, stands_still, with_units
from evpinn_ros.drives.long_form import LongTable
from evpinn_ros.drives.numbers import MISSING, POINT, Style, style_of, to_floats
from evpinn_ros.drives.order import RowOrder
from evpinn_ros.drives.quantities import QUANTITIES, Unit
from evpinn_ros.drives.rows_to_readings import MOST, RowReadings
from evpinn_ros.drives.survey import (
    MOST_ROWS,
    Survey,
    Table,
    data_rows,
    find_head,
    long_form,
    look_through,
)
from evpinn_ros.drives.text_table import TextTable
from evpinn_ros.drives.times import (
    LAST_TIME_NS,
    NONE,
    RELATIVE_BELOW_S,
    Clock,
    date_of_name,
    is_newest_first,
    start_of_comments,
)
from evpinn_ros.signals.readings import DRIVE_START_NS, NANOSECONDS, Reading

BATCH = 16_384  # rows converted at once
FEW_ROWS = 2000  # looked at where all names are ours and nothing is guessed

Batch = tuple[tuple[int, list[str]], ...]


class TableDrive:
    """A table of a drive.

    Attributes:
        path: of the file.
        rules: columns that are used, in their order.
        columns: their names.
        ignored: columns of the file that are not used.
        clock: how the time is read.
        dropped: rows and cells that `readings` left out, by reason; complete at its end.
        rows: below the header that were read, and `used`, those that gave a reading; likewise.
        nominal_voltage: V, taken where a row has power alone.
        at_nominal_voltage: battery readings made from power alone; likewise.
        zoned: the times name a zone, or count since 1970: the stamps are UTC.
        no_speed: speed is zero throughout while the odometer goes on, so it is not used.
        first_bad: the first cell that could not be read, with the way to mend it; likewise.
        dated: what tells the day of the drive: `log`, `name` of the file, or "" for nothing.
    """

    def __init__(
        self, table: Table, path: Path, nominal_voltage: float, chosen: Sequence[str] = ()
    ) -> None:
        """Look through the table.

        The path is for messages, and a date in its name. Power alone becomes current at
        `nominal_voltage`, V; `chosen` are columns that are given, see `column.columns_by_name`.

        Raises:
            InputError: empty, columns are missing, a choice is wrong or a unit is not known.
        """
        self.path, self._table = path, table
        self.dropped: Counter[str] = Counter()
        self.rows = self.used = 0
        self.at_nominal_voltage = 0
        self.first_bad: str | None = None
        self.no_speed = False
        self.nominal_voltage = nominal_voltage
        try:
            self._head = find_head(table)
            if long := long_form(self._head):
                self._table = LongTable(table, self._head, long)
                self._head = find_head(self._table)
            header = self._head.names
            found = columns_by_name(header, chosen)
            check_columns(found, header)
        except InputError as error:
            text = str(error)
            raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error
        own = all(
            not column.why and column.name == QUANTITIES[column.quantity].column
            for column in found
        )
        places = sorted({column.place for column in found})

        limit = FEW_ROWS if own else MOST_ROWS
        survey = look_through(
            self._table,
            self._head,
            places,
            early=partial(self._chosen_clock, found),
            limit=limit,
        )
        self._survey = survey
        self._looked_at_all = survey.widths.total() < limit
        self._styles = _styles(survey)
        self.clock = self._chosen_clock(found, survey)
        stamps = self.clock.stamps([survey.cells[place] for place in self.clock.columns])
        self._newest_first = is_newest_first(stamps[stamps != NONE])
        if self._newest_first:
            for cells in survey.cells.values():
                cells.reverse()
        self.rules = self._ruled(found, own)
        self.columns = tuple(rule.name for rule in self.rules)
        used = {rule.place for rule in self.rules} | set(self.clock.columns)
        others = self._table.others if isinstance(self._table, LongTable) else []
        self.ignored = (
            *(name for i, name in enumerate(header) if i not in used and name),
            *others,
        )
        self._start_ns, self.dated = self._start()
        self.zoned = self.clock.zoned

    @property
    def seconds(self) -> float | None:
        """Time from the first row to the last, s; None where only reading it tells."""
        clock, cells = self.clock, self._survey.cells
        looked_at = [cells[place] for place in clock.columns]
        if self._looked_at_all:
            ends = clock.stamps(looked_at)
        elif isinstance(self._table, TextTable) and clock.unwrapped is None:
            last = self._table.last_row()
            if max(clock.columns) >= len(last):
                return None
            rows = zip(looked_at, clock.columns, strict=True)
            ends = clock.stamps([[column[0], last[place]] for column, place in rows])
        else:
            return None
        if clock.unwrapped is not None:
            ends = clock.unwrapped.add(ends)
        there = ends[ends != NONE]
        return abs(int(there[-1]) - int(there[0])) / NANOSECONDS if there.size > 1 else None

    def _chosen_clock(self, found: Sequence[Column], survey: Survey) -> Clock:
        """The clock of the table; InputError when no column of time can be read."""
        clock = choose_clock(found, survey, _styles(survey), self._head.names)
        if clock is None:
            raise InputError(f"{self.path}: {_no_time(found, survey)}")
        return clock

    def readings(self) -> Iterator[Reading]:
        """The readings in order of time; an empty cell makes none.

        Raises:
            InputError: the file cannot be read to its end.
        """
        self.dropped.clear()
        self.rows = self.used = 0
        self.first_bad = None
        clock = self.clock
        unwrapped = clock.unwrapped
        order = RowOrder()
        makers = RowReadings(self.rules, self.nominal_voltage, self.dropped)
        for batch in self._batches():
            stamps = clock.stamps([self._cells(batch, place) for place in clock.columns])
            self._count_times(batch, stamps)
            if unwrapped is not None:
                stamps = unwrapped.add(stamps)
            there = stamps != NONE
            stamps = np.where(there, stamps, 0) + self._start_ns
            late = there & ((stamps >= LAST_TIME_NS) | (stamps <= 0))
            self.dropped["time_out_of_range"] += int(late.sum())
            values = {
                rule.quantity: self._numbers(batch, rule)
                for rule in self.rules
                if rule.quantity not in ("time", "odometer")
            }
            if self.no_speed:
                self.dropped["speed_stands_still"] += int(np.isfinite(values["speed"]).sum())
                values["speed"][:] = math.nan
            rows = np.flatnonzero(there & ~late)
            yield from makers.readings(stamps, values, order.sorted(stamps, rows))
        self.dropped["time_not_increasing"] += order.dropped
        self.used, self.at_nominal_voltage = makers.used, makers.at_nominal_voltage
        torn = getattr(self._table, "torn", 0)
        if torn:
            self.dropped["wrong_number_of_cells"] += torn
            self.rows += torn
        for reason in [reason for reason, count in self.dropped.items() if not count]:
            del self.dropped[reason]

    def _batches(self) -> Iterator[Batch]:
        """Whole rows, some thousand at a time; what a broken file still gives comes first."""
        rows = self._whole_rows()
        broken: list[InputError] = []

        def until_broken() -> Iterator[tuple[int, list[str]]]:
            try:
                yield from rows
            except InputError as error:
                broken.append(error)

        if self._newest_first:  # databases export so; there is no end to begin from in a stream
            whole = list(until_broken())
            whole.reverse()
            yield from _batched(iter(whole))
        else:
            yield from _batched(until_broken())
        if broken:
            raise broken[0]

    def _whole_rows(self) -> Iterator[tuple[int, list[str]]]:
        known: dict[int, bool] = {}
        for number, row in data_rows(self._table, self._head):
            self.rows += 1
            width = len(row)
            if width not in known:
                known[width] = self._survey.is_whole(width)
            if known[width]:
                yield number, row
            else:
                self.dropped["wrong_number_of_cells"] += 1

    def series(self, names: Sequence[str]) -> dict[str, Signal]:
        """Columns that are no readings of ours, as they are: for benchmarks and a closer look.

        Names that are not there are left out.

        Returns:
            times, s since 1970, and numbers by name, NaN where there is none.
        """
        clock, header = self.clock, self._head.names
        places = {name: header.index(name) for name in names if name in header}
        found: dict[str, list[NDArray[np.float64]]] = {name: [] for name in places}
        times: list[NDArray[np.float64]] = []
        unwrapped = clock.unwrapped
        for batch in self._batches():
            stamps = clock.stamps([self._cells(batch, place) for place in clock.columns])
            stamps = unwrapped.add(stamps) if unwrapped is not None else stamps
            times.append(np.where(stamps == NONE, np.nan, seconds(stamps, -self._start_ns)))
            for name, place in places.items():
                cells = self._cells(batch, place)
                style = style_of(cells) or POINT
                found[name].append(to_floats(cells, style))
        time = np.concatenate(times) if times else np.empty(0)
        return {name: Signal(time, np.concatenate(values)) for name, values in found.items()}

    @staticmethod
    def _cells(batch: Batch, place: int) -> list[str]:
        return [row[place] if place < len(row) else "" for _, row in batch]

    def _numbers(self, batch: Batch, rule: Column) -> NDArray[np.float64]:
        """SI values of a column; NaN where there is none."""
        cells = self._cells(batch, rule.place)
        values = to_floats(cells, self._styles[rule.place])
        for i in np.flatnonzero(~np.isfinite(values)):
            if cells[i].strip().lower() not in MISSING:
                self.dropped[f"{QUANTITIES[rule.quantity].column}_not_a_number"] += 1
                self._say_bad(batch[i][0], rule, cells[i], "is no number")
        values = values * rule.factor + rule.offset
        values[~(np.abs(values) < MOST)] = math.nan
        return values

    def _count_times(self, batch: Batch, stamps: NDArray[np.int64]) -> None:
        place = self.clock.columns[0]
        for i in np.flatnonzero(stamps == NONE):
            self.dropped["no_time"] += 1
            cell = batch[i][1][place] if place < len(batch[i][1]) else ""
            if cell.strip().lower() not in MISSING:
                self.dropped["t_s_not_a_number"] += 1
                rule = Column("time", self._head.names[place])
                self._say_bad(batch[i][0], rule, cell, "is no time like the others")

    def _say_bad(self, line: int, rule: Column, cell: str, what: str) -> None:
        if self.first_bad is None:
            self.first_bad = (
                f"{self.path}:{line}: column {rule.name!r}: {cell[:40]!r} {what}; "
                f"--column {rule.quantity}=NAME takes another column"
            )

    def _ruled(self, found: Sequence[Column], own: bool) -> tuple[Column, ...]:
        """The columns with units and signs, in the order of the file."""
        clock = self.clock
        header = self._head.names
        time = Column("time", header[clock.columns[0]], place=clock.columns[0])
        given = any(column.quantity == "time" and column.why == "as given" for column in found)
        named = time.name == QUANTITIES["time"].column
        if not named:
            meant = QUANTITIES["time"].units.get(clock.unit, Unit(1.0))
            why = "as given" if given else clock.why or "by its cells"
            time = time.measured_in(clock.unit or clock.kind, meant, why)
        used = {column.quantity: column for column in found if column.quantity != "time"}
        if not own:
            stamps = clock.stamps([self._survey.cells[place] for place in clock.columns])
            if unwrapped := clock.unwrapped:
                stamps = unwrapped.add(stamps)
            there = stamps[stamps != NONE]
            times = seconds(stamps, int(there[0]) if there.size else 0)
            times[stamps == NONE] = np.nan
            signals = {
                name: Signal(
                    times, to_floats(self._survey.cells[each.place], self._styles[each.place])
                )
                for name, each in used.items()
            }
            used = with_units(used, signals, frozenset(header))
            self.no_speed = stands_still(used, signals)
        return tuple(sorted([time, *used.values()], key=lambda column: column.place))

    def _start(self) -> tuple[int, str]:
        """Offset to add to the times of the clock, ns, and the source of the date."""
        clock = self.clock
        stamps = clock.stamps([self._survey.cells[place] for place in clock.columns])
        known = stamps[stamps != NONE]
        first = int(known[0]) if known.size else NONE
        if clock.dated:
            return 0, "log"
        if first >= RELATIVE_BELOW_S * NANOSECONDS:
            return 0, "log"
        # A time of day, or seconds since midnight as Car Scanner's long form has them.
        day = date_of_name(self.path.name, first, certain=clock.kind == "time of day")
        if day is not None:
            return day, "name"
        started = start_of_comments(self._head.comments)
        if started is not None and clock.kind == "number":
            return started - first, "log"
        return DRIVE_START_NS, ""


def _batched(rows: Iterator[tuple[int, list[str]]]) -> Iterator[Batch]:
    while batch := tuple(islice(rows, BATCH)):
        yield batch


def _styles(survey: Survey) -> dict[int, Style]:
    """Number style of each column; an undecided one takes that of the others."""
    found = {place: style_of(cells) for place, cells in survey.cells.items()}
    given = Counter(style for style in found.values() if style is not None)
    common = given.most_common(1)[0][0] if given else POINT
    return {
        place: style or style_of(survey.cells[place], common) or common
        for place, style in found.items()
    }


def _no_time(found: Sequence[Column], survey: Survey) -> str:
    column = next(column for column in found if column.quantity == "time")
    cell = next((cell for cell in survey.cells[column.place] if cell.strip()), "")
    if not survey.widths.total():
        return "no row below the header"
    return (
        f"column {column.name!r}: {cell[:40]!r} is no time that is known; "
        "say --column time=NAME or time=NAME:s"
    )
