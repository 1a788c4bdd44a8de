"""A drive in a table: the meaning of its columns, and the readings of its rows."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
import math
from pathlib import Path
import re
import sys
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import DRIVE_START_NS, NANOSECONDS
from evpinn_ros.logs.batch import Batch, regrouped
from evpinn_ros.logs.bursts import come_in_bursts, join, joined
from evpinn_ros.logs.cars import table_of_car
from evpinn_ros.logs.clock import LAST_TIME_NS, NONE, Clock, Order
from evpinn_ros.logs.clock_choice import ASSUMED_UNIT, RELATIVE_BELOW_S, clocks_of
from evpinn_ros.logs.clock_start import (
    day_of_name,
    days_of_name,
    start_by_date,
    start_of_comments,
)
from evpinn_ros.logs.column import (
    NO_USE,
    SIGNED,
    Column,
    check_columns,
    columns_by_name,
    is_complete,
    unit_places,
    unused_columns,
)
from evpinn_ros.logs.contradictions import contradictions, doubts
from evpinn_ros.logs.frozen_values import FrozenValues, measured_alone
from evpinn_ros.logs.numbers import filled, is_missing, to_floats
from evpinn_ros.logs.quantities import (
    ANGLES,
    NEEDED,
    PLACES,
    QUANTITIES,
    Unit,
    is_engine_speed,
    known_unit,
)
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.rows_to_blocks import MOST, HeldSignals, RowBlocks, RowOrder
from evpinn_ros.logs.signal import LEAST_EVENTS, Signal, last_known
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.split_numbers import joined_table
from evpinn_ros.logs.survey import (
    MOST_ROWS,
    OTHER_SHEETS,
    LongTable,
    Survey,
    Table,
    data_batches,
    find_head,
    long_form,
    look_through,
)
from evpinn_ros.logs.values import (
    flows_one_way,
    held_columns,
    is_backwards,
    is_engine,
    net,
    of_12_volts,
    power_beside,
    with_units,
)

with optional_imports():
    import polars as pl

if TYPE_CHECKING:
    from evpinn_ros.logs.terrain import Terrain

AT_ONCE = 16_384  # rows per block of a table that is not in time order
DIGITS = re.compile(r"\d+")
LEVEL = "elevation: all heights are equal, so the road is assumed to be level"
FEW_ROWS = 20_000  # rows examined if all names are ours, so that nothing is guessed

Stamps = NDArray[np.int64]
Numbers = dict[str, NDArray[np.float64]]
Timed = tuple[Stamps, Numbers]  # times of some rows, and their values, SI


class TableDrive(Source):
    """A table of a drive."""

    problem: str | None = None

    def __init__(
        self,
        table: Table,
        path: Path,
        nominal_voltage: float,
        options: ReadOptions,
    ) -> None:
        """Examine the table; InputError if it lacks a column, a unit or a single car."""
        super().__init__(path)
        self._terrain = options.terrain  # None without positions
        self._nominal_voltage = nominal_voltage
        self._at_nominal_voltage = 0
        self._not_traction = ""  # why the voltage is unused
        self._frozen = FrozenValues(self.dropped)
        # `rows` read below the header; those `used` gave a reading. Complete once exhausted.
        self.rows = self.used = 0
        self.first_bad: str | None = None  # first unreadable cell, and the remedy
        try:
            self._head = find_head(table)
            self._table = table_of_car(table, self._head, options.car)
            self._long: LongTable | None = None
            if places := long_form(self._head):
                self._table = self._long = LongTable(self._table, self._head, places)
                self._head = find_head(self._table)
            header = self._head.names
            columns = self._named_columns(options)
            check_columns(columns, header, battery=options.battery)
            self._beside = power_beside(header, columns)
            self._units = unit_places(header)
            engines = (place for place, name in enumerate(header) if is_engine_speed(name))
            self._engine = next(engines, None)  # index of its column, for a hybrid
            self._begin(columns, options)
        except InputError as error:
            text = str(error)
            raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error

    def _begin(self, columns: list[Column], options: ReadOptions) -> None:
        """Choose clock, units and signs from the cells of the columns."""
        header = self._head.names
        all_ours = all(not column.why and column.is_ours for column in columns)
        limit = FEW_ROWS if all_ours else MOST_ROWS
        if self._long is not None:  # signals may begin one after the other
            limit = sys.maxsize
        survey = self._look_through(columns, limit)
        if survey.is_wider and self._long is None:
            self._table = joined_table(self._table, self._head)
            survey = self._look_through(columns, limit)
        for is_useless in (lambda survey, column: column.place in survey.empty, _is_silent):
            columns, survey = self._better(columns, survey, options, is_useless, limit)
        self._looked_at_all = survey.widths.total() < limit
        self._survey = survey
        self.clock, *clocks = self._clocks(columns, survey)
        if self.clock.spread is not None and not self.clock.spread.rows:
            name = header[self.clock.columns[0]]
            raise InputError(
                f"column {name!r}: the rows share too few different times to tell their interval; "
                "say --column time=NAME for a finer column"
            )
        self.zoned = self.clock.zoned
        self.in_order = self.clock.order is not Order.SHUFFLED
        stamps = self.clock.stamps(survey.cells)
        if self.clock.order is not Order.OLDEST_FIRST:
            rows = self.clock.order.rows(stamps)
            stamps = stamps[rows]
            survey.put_in_order(rows)
        self._contradictions: tuple[str, ...] = ()
        self._doubts: tuple[str, ...] = ()
        self.rules = self._used_columns(columns, all_ours, stamps)
        taken = {*self.clock.columns, *self._units.values()}
        self.ignored = unused_columns(header, self.rules, taken, survey.empty)
        if self._long is not None:
            self.ignored |= dict.fromkeys(self._long.others, NO_USE)
        if not {rule.quantity for rule in self.rules} >= {*PLACES}:
            self._terrain = None
        self._level = (
            self._looked_at_all and self._terrain is None and any(map(self._is_level, columns))
        )
        self._start_ns, self.dated = self._start(clocks, stamps)
        self._stamps = stamps  # of the kept rows
        survey.forget_cells()

    @property
    def seconds(self) -> float | None:
        """Time from the first row to the last, s; None if only reading the table shows it."""
        clock, stamps = self.clock, self._stamps
        if not self._looked_at_all:
            ends_last = self.in_order and not clock.begins_anew
            last = self._table.last_row() if ends_last else []
            if max(clock.columns) >= len(last):
                return None
            # In the order of the file: the kept rows are reversed.
            first = -1 if clock.order is Order.NEWEST_FIRST else 0
            stamps = np.append(
                stamps[first], clock.stamps({at: [last[at]] for at in clock.columns})
            )
        ends = clock.running().add(stamps)
        there = ends[ends != NONE]
        return abs(int(there[-1]) - int(there[0])) / NANOSECONDS if there.size > 1 else None

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Units and signs that the data do not decide, and whether the ground is level."""
        return (*super().assumptions, *(LEVEL,) * self._level)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for a person on how the table was read; complete once exhausted."""
        assumed = " ".join(self.assumptions)  # an assumed sign is a doubt too, but told once
        doubts = [doubt for doubt in self._doubts if doubt not in assumed]
        notes = [*self.assumptions, *doubts, *self._contradictions]
        comments = self._head.comments
        notes += [text.lstrip("# ") for text in comments if text.startswith(OTHER_SHEETS)]
        if not self.in_order:
            notes.append("rows are not in order of time, so they were sorted")
        notes += [
            f"{rule.quantity}: {rule.name!r} wraps: numbers above {rule.wraps / 2:g} are negative"
            for rule in self.rules
            if rule.wraps
        ]
        for rule in self.rules:
            if rule.back is not None:
                back = self._head.names[rule.back]
                notes.append(
                    f"{rule.quantity}: {back!r} is assumed to flow back, and is subtracted"
                )
            alike = [name for name in self.ignored if _is_numbered_like(name, rule.name)]
            if rule.quantity in SIGNED and alike:
                notes.append(
                    f"{rule.quantity}: {rule.name!r} is assumed to be that of the whole battery; "
                    f"not counted: {', '.join(alike)}"
                )
        if self._backwards:
            notes.append("speed: all numbers are negative, so their sign is turned")
        if self._engine is not None:
            notes.append("rows in which the combustion engine runs are not used")
        if self._in_bursts and self._long is None:
            notes.append("rows written in one burst are one reading, of their last values")
        if self._held:
            names = " and ".join(sorted(self._held))
            notes.append(f"{names}: cells that repeat the last value are not used")
        notes += self._notes_on_time()
        if self._not_traction:
            notes.append(f"voltage is {self._not_traction}, so it is not used")
        notes += self._frozen.notes
        if self._at_nominal_voltage:
            notes.append(
                f"{self._at_nominal_voltage} battery readings have power only; their voltage is "
                f"assumed to be the nominal {self._nominal_voltage:g} V"
            )
        return (*notes, self.first_bad) if self.first_bad else tuple(notes)

    def _notes_on_time(self) -> Iterator[str]:
        clock, spread = self.clock, self.clock.spread
        name = self._head.names[clock.columns[0]]
        if clock.why == ASSUMED_UNIT:
            yield (
                f"time: {name!r} is assumed to be in {clock.unit}: in the unit of its name, speed "
                f"would change as no car's does; --column 'time={name}:UNIT' sets another unit"
            )
        if clock.half_days:
            yield f"time: {name!r} is assumed to be a 12-hour clock without AM and PM"
        if clock.formats == "%H:%M" and not clock.as_written and spread is None:
            yield (
                f"time: {name!r} is assumed to be hours and minutes; if it is minutes and "
                f"seconds, use --column 'time={name}:%M:%S'"
            )
        if spread is not None:
            every = spread.resolution_ns / NANOSECONDS
            yield f"time: stamps have a resolution of {every:g} s; rows are spread evenly over it"

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences on why totals are uncertain."""
        return self._doubts

    def read(self) -> Iterator[Block]:
        """Readings in time order, up to any damage; InputError if there are none."""
        begun, self.problem = False, None
        try:
            for block in self._read():
                begun |= len(block) > 0
                yield block
        except InputError as error:
            if not begun:
                raise
            self.problem = str(error)
        if not begun:
            reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(self.dropped.items()))
            nothing = f"{self.path}: no usable reading; dropped: {reasons or 'nothing'}"
            raise InputError(self.first_bad or nothing)

    def _named_columns(self, options: ReadOptions, empty: Collection[int] = ()) -> list[Column]:
        """The columns of `columns_by_name`; slopes of a drive with battery only if chosen."""
        columns = columns_by_name(self._head.names, options.columns, empty)
        return [
            column
            for column in columns
            if column.quantity != "grade" or column.why == "as given" or not options.battery
        ]

    def _is_level(self, column: Column) -> bool:
        """True for constant heights, unless a receiver without a fix may have written them."""
        if column.quantity != "elevation" or not (column.is_ours or column.why == "as given"):
            return False
        heights = to_floats(self._survey.cells[column.place], self._survey.styles[column.place])
        heights = heights[np.isfinite(heights)]
        return heights.size > 1 and not np.ptp(heights)

    def _look_through(self, columns: Sequence[Column], limit: int) -> Survey:
        return look_through(
            self._table,
            self._head,
            sorted(
                {column.place for column in (*columns, *filter(None, [self._beside]))}
                | {column.back for column in columns if column.back is not None}
                | {self._units[column.place] for column in columns if column.place in self._units}
                | ({self._engine} if self._engine is not None else set())
            ),
            early=partial(self._clocks, columns),
            limit=limit,
        )

    def _better(
        self,
        columns: list[Column],
        survey: Survey,
        options: ReadOptions,
        is_useless: Callable[[Survey, Column], bool],
        limit: int,
    ) -> tuple[list[Column], Survey]:
        """The columns, with useless guesses replaced; needed ones stay if nothing is better."""
        first, useless = (columns, survey), set(survey.empty)
        while places := {
            column.place
            for column in columns
            if column.quantity != "time"
            and not (column.why == "as given" or column.is_ours)
            and is_useless(survey, column)
        }:
            useless |= places
            others = self._named_columns(options, useless)
            names = {column.quantity for column in others}
            lost = {column.quantity for column in columns} - names
            if lost & NEEDED and not is_complete(names):
                return first
            columns, survey = others, self._look_through(others, limit)
        return columns, survey

    def _clocks(self, columns: Sequence[Column], survey: Survey) -> list[Clock]:
        """The clocks of the table, the best first; InputError if no time can be read."""
        days = days_of_name(self.path.name)
        clocks = clocks_of(columns, survey, days)
        if not clocks:
            raise InputError(f"{self.path}: {_no_time(columns, survey)}")
        return clocks

    def _read(self) -> Iterator[Block]:
        self.dropped.clear()
        self.rows = self.used = 0
        self.first_bad = None
        order = RowOrder()
        maker = RowBlocks(self._nominal_voltage, self.dropped)
        held, self._frozen = HeldSignals(self._held), FrozenValues(self.dropped)
        for stamps, values in self._timed():
            there = stamps != NONE
            stamps = np.where(there, stamps, 0) + self._start_ns
            late = there & ((stamps >= LAST_TIME_NS) | (stamps <= 0))
            self.dropped["time_out_of_range"] += int(late.sum())
            if self._not_traction:
                self.dropped["voltage_stands_still"] += int(np.isfinite(values["voltage"]).sum())
                values["voltage"][:] = math.nan
            rows = order.sorted(stamps, np.flatnonzero(there & ~late))
            if self._in_bursts:
                rows = join(stamps, values, rows)
            held.drop_repeats(stamps, values, rows)
            self._frozen.drop(stamps, values, rows)
            yield maker.block(stamps, values, rows)
        self.used, self._at_nominal_voltage = maker.used, maker.at_nominal_voltage
        self.rows += self._table.torn
        self.dropped["time_not_increasing"] += order.dropped
        self.dropped["wrong_number_of_cells"] += self._table.torn
        for reason in [reason for reason, count in self.dropped.items() if not count]:
            del self.dropped[reason]

    def _timed(self) -> Iterator[Timed]:
        """Continuous times, ns, and SI values of whole rows; raises a file's damage last."""
        broken: list[InputError] = []
        running = self.clock.running()
        places = self.clock.columns
        stamped = (
            (batch, np.array(self.clock.stamps({place: batch.cells(place) for place in places})))
            for batch in regrouped(self._until_broken(broken))
        )
        parts = ((stamps, self._values(batch, stamps)) for batch, stamps in stamped)
        for stamps, values in _oldest_first(parts, self.clock.order):
            yield running.add(stamps), values
        if broken:
            raise broken[0]

    def _values(self, batch: Batch, stamps: Stamps) -> Numbers:
        """SI values of the quantities in use; `stamps` while the engine runs become `NONE`."""
        self._count_times(batch, stamps)
        if self._engine is not None:
            style = self._survey.styles[self._engine]
            on = (to_floats(batch.cells(self._engine), style) > 0) & (stamps != NONE)
            self.dropped["engine_on"] += int(on.sum())
            stamps[on] = NONE
        values = {
            rule.quantity: self._numbers(batch, rule)
            for rule in self.rules
            if rule.quantity != "time"
        }
        if self._terrain is not None:
            heights = _heights(self._terrain, *(values[name] for name in PLACES))
            recorded = values.get("elevation", heights)  # kept where no tile has a height
            values["elevation"] = np.where(np.isnan(heights), recorded, heights)
        elif self._level:
            values["grade"] = 0.0 * values["elevation"]
        return values

    def _until_broken(self, broken: list[InputError]) -> Iterator[Batch]:
        """Rows that are not torn; an error that ends the file is added to `broken`."""
        try:
            for batch in data_batches(self._table, self._head):
                widths = batch.widths
                self.rows += len(batch)
                torn = [w for w in np.unique(widths).tolist() if not self._survey.is_whole(w)]
                if torn:
                    whole = ~np.isin(widths, torn)
                    self.dropped["wrong_number_of_cells"] += int((~whole).sum())
                    batch = batch.where(whole)
                if len(batch):
                    yield batch
        except InputError as error:
            broken.append(error)

    def _numbers(self, batch: Batch, rule: Column) -> NDArray[np.float64]:
        values = to_floats(batch.cells(rule.place), self._survey.styles[rule.place])
        self._count_bad(batch, rule, ~np.isfinite(values), "is not a number")
        if rule.back is not None:
            values = net(values, to_floats(batch.cells(rule.back), self._survey.styles[rule.back]))
        values = np.where(np.abs(values) < MOST, values, math.nan)  # no factor makes it infinite
        values = rule.si(values)
        if rule.quantity == "grade" and rule.unit not in ANGLES:
            values = np.arctan(values)
        values[~(np.abs(values) < MOST)] = math.nan
        return values

    def _count_times(self, batch: Batch, stamps: Stamps) -> None:
        place = self.clock.columns[0]
        bad = stamps == NONE
        self.dropped["no_time"] += int(bad.sum())
        time = Column("time", self._head.names[place], place=place)
        self._count_bad(batch, time, bad, "has not the format of the other times")

    def _count_bad(self, batch: Batch, rule: Column, bad: NDArray[np.bool_], what: str) -> None:
        """Count the bad cells of a column that are not just missing, and quote the first."""
        cells = batch.cells(rule.place)
        if not bad.any() or not len(filled(pl.Series(cells).filter(bad))):
            return
        for i in np.flatnonzero(bad).tolist():
            line, cell = batch.lines[i], cells[i]
            if is_missing(cell):
                continue
            self.dropped[f"{QUANTITIES[rule.quantity].column}_not_a_number"] += 1
            if self.first_bad is None:
                self.first_bad = (
                    f"{self.path}:{line}: column {rule.name!r}: {cell[:40]!r} {what}; "
                    f"--column {rule.quantity}=NAME chooses another column"
                )

    def _used_columns(
        self, columns: Sequence[Column], all_ours: bool, stamps: Stamps
    ) -> tuple[Column, ...]:
        """The columns in use, in file order, with units and signs; notes what is implausible."""
        clock, header = self.clock, self._head.names
        time = Column("time", header[clock.columns[0]], place=clock.columns[0])
        if not time.is_ours:
            given = any(
                column.quantity == "time" and column.why == "as given" for column in columns
            )
            meant = QUANTITIES["time"].units.get(clock.unit, Unit(1.0))
            why = "as given" if given else clock.why or "by its values"
            time = time.measured_in(clock.unit or clock.kind, meant, why)
        used = {column.quantity: column for column in columns if column.quantity != "time"}
        times = _seconds(clock.running().add(stamps))
        beside = {"power": self._beside} if self._beside else {}
        used = {
            name: self._with_unit_beside(self._with_returned(column))
            for name, column in used.items()
        }
        signals = self._signals({**used, **beside}, times)
        speed = used["speed"]
        self._backwards = speed.why != "as given" and is_backwards(signals["speed"])
        if self._backwards:
            signals["speed"] = Signal(signals["speed"].time, -signals["speed"].value)
        if not all_ours:
            used = with_units(used, signals)
        self._not_traction = of_12_volts(used, signals)
        if self._engine is not None:
            turning = self._signal(Column("time", "", place=self._engine), times)
            self._engine = self._engine if is_engine(turning, signals["speed"]) else None
        self._held = held_columns(signals) & used.keys()
        measured = {
            name: used[name] for name in used if name != "voltage" or not self._not_traction
        }
        if {"voltage", "current"} <= measured.keys():
            measured |= beside
        self._contradictions = tuple(contradictions(measured, signals))
        self._doubts = tuple(doubts(measured, signals))
        if self._backwards:
            used["speed"] = used["speed"].turned()
        return tuple(sorted([time, *used.values()], key=lambda column: column.place))

    def _signals(
        self, columns: Mapping[str, Column], times: NDArray[np.float64]
    ) -> dict[str, Signal]:
        """Signals of the examined rows, in the file's units."""
        signals = {name: self._signal(column, times) for name, column in columns.items()}
        self._in_bursts = come_in_bursts(signals)
        if self._in_bursts:
            signals = {name: joined(signal) for name, signal in signals.items()}
        return measured_alone(signals)

    def _signal(self, column: Column, times: NDArray[np.float64]) -> Signal:
        values = self._surveyed(column.place)
        if column.back is not None:
            values = net(values, self._surveyed(column.back))
        return Signal(times, np.where(np.abs(values) < MOST, values, math.nan))

    def _surveyed(self, place: int) -> NDArray[np.float64]:
        """Numbers of a column in the examined rows."""
        return to_floats(self._survey.cells[place], self._survey.styles[place])

    def _with_returned(self, column: Column) -> Column:
        """The column, without its column of returned energy if the two are no such pair."""
        if column.back is None:
            return column
        is_pair = flows_one_way(self._surveyed(column.place), self._surveyed(column.back))
        return column if is_pair else replace(column, back=None)

    def _with_unit_beside(self, column: Column) -> Column:
        """The column in the unit that another column names; InputError if that unit changes."""
        place = self._units.get(column.place)
        if place is None or column.has_unit:
            return column
        name, cells = self._head.names[place], filled(self._survey.cells[place]).unique()
        told = sorted(cell.strip().lower() for cell in cells)
        units = {known_unit(column.quantity, text) for text in told}
        if len(units) > 1 and None not in units:
            raise InputError(
                f"column {name!r}: the unit changes between {' and '.join(told)}: split the file "
                "where it does"
            )
        unit = units.pop() if units else None
        return column.measured_in(told[0], unit, f"by {name!r}") if unit else column

    def _start(self, others: Sequence[Clock], stamps: Stamps) -> tuple[int, str]:
        """Offset to add to the times of the clock, ns, and the source of the date."""
        clock, times = self.clock, stamps[stamps != NONE]
        first = int(times[0]) if times.size else NONE
        if clock.dated or first >= RELATIVE_BELOW_S * NANOSECONDS:
            return 0, "log"
        if dated := start_by_date(clock, others, self._survey):
            self.zoned = dated[1].zoned
            return dated[0], "log"
        # A time of day, or seconds since midnight as in Car Scanner's long form.
        day = day_of_name(self.path.name, first, certain=clock.kind == "time of day")
        if day is not None:
            return day, "name"
        started = start_of_comments(self._head.comments)
        if started is not None and clock.kind == "number":
            return started - first, "log"
        return DRIVE_START_NS, ""


def _is_numbered_like(name: str, other: str) -> bool:
    """True if two names differ only in a number, as for two packs."""
    return name != other and DIGITS.sub("0", name) == DIGITS.sub("0", other)


def _is_silent(survey: Survey, column: Column) -> bool:
    """True if a quantity that changes in every drive is constant."""
    if column.quantity not in ("speed", "current", "power"):
        return False
    values = to_floats(survey.cells[column.place], survey.styles[column.place])
    finite = values[np.isfinite(values)]
    return finite.size >= LEAST_EVENTS and not np.ptp(finite)


def _heights(
    terrain: Terrain, latitude: NDArray[np.float64], longitude: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Heights of the ground, m, shape (n,), where the position is new."""
    new = np.isfinite(latitude) | np.isfinite(longitude)
    place = [last_known(degrees)[new] for degrees in (latitude, longitude)]
    heights = np.full(latitude.shape, np.nan)
    heights[new] = terrain.heights(*place)
    return heights


def _oldest_first(parts: Iterator[Timed], order: Order) -> Iterator[Timed]:
    """Parts in time order; all but `OLDEST_FIRST` keep the numbers of the whole table."""
    if order is Order.OLDEST_FIRST:
        yield from parts
        return
    if order is Order.NEWEST_FIRST:  # times of a day may restart, so they are not sorted
        for stamps, values in reversed(list(parts)):
            yield stamps[::-1], {name: numbers[::-1] for name, numbers in values.items()}
        return
    held = list(parts)
    stamps = np.concatenate([part for part, _ in held] or [np.empty(0, np.int64)])
    names = held[0][1] if held else {}
    values = {name: np.concatenate([part[name] for _, part in held]) for name in names}
    del held
    rows = order.rows(stamps)
    for begin in range(0, rows.size, AT_ONCE):
        some = rows[begin : begin + AT_ONCE]
        yield stamps[some], {name: part[some] for name, part in values.items()}


def _seconds(stamps: Stamps) -> NDArray[np.float64]:
    there = stamps != NONE
    first = int(stamps[there.argmax()]) if there.any() else 0
    return np.where(there, (stamps - first) / NANOSECONDS, math.nan)


def _no_time(columns: Sequence[Column], survey: Survey) -> str:
    column = next(column for column in columns if column.quantity == "time")
    cell = next(iter(filled(survey.cells[column.place])), "")
    if not survey.widths.total():
        return "no rows below the header"
    return (
        f"column {column.name!r}: {cell[:40]!r} is in no known format of time; "
        "say --column time=NAME, time=NAME:s or time=NAME:%d.%m.%Y %H:%M:%S%.f"
    )
