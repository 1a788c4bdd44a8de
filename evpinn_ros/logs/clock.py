"""The clock of a table: converts cells of dates, times or numbers to continuous stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.months import IN_ENGLISH
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.core.signals.readings import DAY_NS, NANOSECONDS
from evpinn_ros.logs.batch import Cells
from evpinn_ros.logs.numbers import POINT, Style, to_floats
from evpinn_ros.logs.quantities import QUANTITIES

with optional_imports():
    import polars as pl

NONE = np.iinfo(np.int64).min  # marks an unknown time
LAST_TIME_NS = 2**31 * NANOSECONDS  # the end of ROS time, in 2038
BACK_NS = 10 * NANOSECONDS  # tolerance of the time at which a clock restarts with each drive
HALF_DAY_NS, HALF_DAY_PAUSE_NS = DAY_NS // 2, 600 * NANOSECONDS
PAUSE_NS = 3600 * NANOSECONDS  # assumed pause between such drives; its true length is unknown

# With separators, as a month may be part of another word.
_MONTHS = {f"-{name}-": f"-{month}-" for name, month in IN_ENGLISH.items()}

UNITS_NS = {name: 1e9 * unit.factor for name, unit in QUANTITIES["time"].units.items()}
DAY_OF_FORMAT = re.compile("%[-_0]?[cDdeFjvs]")  # parts of a format that hold the day
CLOCK_OF_FORMAT = re.compile("%[-_0]?[cHIkMRrSsTX]")  # parts of a format that hold the time of day


class RowSpread(NamedTuple):
    """How many rows share a stamp whose resolution is coarser than their interval."""

    resolution_ns: int  # of the stamps
    rows: int  # rows per stamp; 0 if too few stamps are known
    first: int  # rows of the first stamp, which the log may hold only in part


class Order(Enum):
    """Order in which the rows of a table stand."""

    OLDEST_FIRST = "oldest first"
    NEWEST_FIRST = "newest first"  # as a database exports them
    SHUFFLED = "in no order"  # as exported by a database without sorting

    def rows(self, times: NDArray[Any]) -> NDArray[np.intp]:
        """Indices of rows from the oldest to the newest, shape (n,), given their times."""
        if self is Order.SHUFFLED:
            return np.argsort(times, kind="stable")
        return np.arange(times.size)[:: -1 if self is Order.NEWEST_FIRST else 1]


@dataclass(frozen=True, slots=True)
class Clock:
    """Reads stamps from the cells of the time columns."""

    columns: tuple[int, ...]  # one column, or two if date and time are separate
    kind: str  # `number`, `date` or `time of day`
    formats: str = ""  # in polars' notation, one for a date or a time of day
    unit: str = "s"  # unit of numbers
    zoned: bool = False  # True if cells name a zone or count from 1970, so stamps are UTC
    why: str = ""  # why it was chosen, for people
    style: Style = POINT  # number style
    daily: bool = False  # True if numbers restart at midnight
    as_written: bool = False  # True if a person gave the format: cells are parsed unchanged
    half_days: bool = False  # True if hours restart at one o'clock, without AM or PM
    drives_from_ns: int | None = None  # time at which each drive restarts; None for a single drive
    order: Order = Order.OLDEST_FIRST  # of the rows
    spread: RowSpread | None = None  # None where each row has a stamp of its own

    @property
    def period_ns(self) -> int:
        """Time after which it restarts, ns: a day or half of it; 0 if it does not."""
        if self.kind != "time of day" and not self.daily:
            return 0
        return HALF_DAY_NS if self.half_days else DAY_NS

    @property
    def begins_anew(self) -> bool:
        """True if its times restart, at midnight or with the next drive."""
        return self.period_ns > 0 or self.drives_from_ns is not None

    def running(self) -> RunningClock:
        """A counter that makes its times continuous."""
        is_local = self.kind == "date" and not self.zoned
        spread = self.spread if self.spread is not None and self.spread.rows else None
        dated_halves = self.half_days and self.kind == "date"
        return RunningClock(
            self.period_ns, self.drives_from_ns, spread, is_local=is_local, halves=dated_halves
        )

    @property
    def dated(self) -> bool:
        """True if the cells contain the date."""
        return self.kind == "date" or (self.kind == "number" and self.zoned)

    def stamps(self, cells: Mapping[int, Cells]) -> NDArray[np.int64]:
        """Times of cells by column, ns since 1970, midnight or the start; `NONE` if unknown."""
        columns = [cells[place] for place in self.columns]
        if self.as_written:
            return parsed_times(pl.Series("", columns[0], dtype=pl.String), self.formats)
        if self.kind != "number":
            return parsed_times(joined_cells(columns), self.formats)
        values = to_floats(columns[0], self.style)
        factor = UNITS_NS[self.unit]
        bad = ~np.isfinite(values) | (np.abs(values) > 9e18 / factor)
        values = np.where(bad, 0.0, values)
        # Whole seconds apart: a float of ns since 1970 resolves only 256 ns.
        whole = np.floor(values)
        rest: NDArray[np.int64] = np.rint((values - whole) * factor).astype(np.int64)
        return np.where(bad, NONE, whole.astype(np.int64) * int(factor) + rest)


class RunningClock:
    """Makes times continuous over midnight, new drives, and clocks that are set back."""

    def __init__(
        self,
        period_ns: int,
        drives_from_ns: int | None = None,
        spread: RowSpread | None = None,
        *,
        is_local: bool = False,
        halves: bool = False,
    ) -> None:
        self._period, self._first, self._spread = period_ns, drives_from_ns, spread
        self._is_local, self._halves = is_local, halves
        self._added = 0
        self._before: NDArray[np.int64] | None = None  # the last two times
        self._shared = (NONE, 0)  # the last stamp, and its number of rows

    def add(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Continuous times, ns, of the next rows by their stamps, ns, shape (n,) each."""
        there = np.flatnonzero(stamps != NONE)
        if there.size == 0:
            return stamps
        times = stamps[there]
        if self._spread is not None:
            stamps = stamps.copy()
            stamps[there] = times = self._spread_out(times, self._spread)
        if not (self._period or self._first is not None or self._is_local or self._halves):
            return stamps
        before = times[[0, 0]] if self._before is None else self._before
        steps = np.diff(times, prepend=before[1])
        added = self._added + np.cumsum(self._turns(times, before, steps))
        self._added, self._before = int(added[-1]), np.append(before, times)[-2:]
        running = stamps.copy()
        running[there] = times + added
        return running

    def _turns(
        self, times: NDArray[np.int64], before: NDArray[np.int64], steps: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Time to add from each row on, ns, shape (n,): where the clock restarts or is set."""
        if self._halves:  # jumps at 1 pm, and at midnight, which reads 12
            return HALF_DAY_NS * (
                1 * half_day_back(steps) - 2 * half_day_back(steps - 3 * HALF_DAY_NS)
            )
        if self._is_local:
            turned: NDArray[np.int64] = -_HOUR_NS * _set_forward(times - steps, times)
            return turned
        if self._first is not None:
            begins = begin_drives(times, before, self._first, BACK_NS)
            return np.where(begins, PAUSE_NS - steps, 0)
        turns = np.where(steps < -self._period // 2, self._period, 0)
        # A straggler from before midnight belongs to the day before.
        straggles = (steps > self._period // 2) & (np.cumsum(turns) + self._added > 0)
        return turns - np.where(straggles, self._period, 0)

    def _spread_out(self, times: NDArray[np.int64], spread: RowSpread) -> NDArray[np.int64]:
        """Times, ns, with rows of one stamp spread evenly over its resolution."""
        begins = np.flatnonzero(np.diff(times, prepend=self._shared[0]) != 0)
        counts = np.arange(times.size)
        before = np.full(times.size, self._shared[1])  # rows of the first stamp in earlier batches
        if begins.size:
            later = counts >= begins[0]
            at = np.searchsorted(begins, counts[later], side="right") - 1
            counts[later] -= begins[at]
            before[later] = 0
        if self._shared[0] == NONE:  # the log may have begun within its first stamp
            end = begins[1] if begins.size > 1 else times.size
            before[:end] = max(0, spread.rows - spread.first)
        shared = counts + before
        self._shared = int(times[-1]), int(shared[-1]) + 1
        step = spread.resolution_ns / spread.rows
        over = np.maximum(shared - (spread.rows - 1), 0)
        offset = np.where(over > 0, spread.resolution_ns - step / (1 + over), shared * step)
        return np.asarray(times + offset.astype(np.int64))


_HOUR_NS, _MINUTE_NS = 3600 * NANOSECONDS, 60 * NANOSECONDS
_NIGHT_NS = 4 * _HOUR_NS  # clocks change before this hour, at a full hour
_THURSDAY = 4  # 1970-01-01, counted from a Sunday


def _set_forward(before: NDArray[np.int64], after: NDArray[np.int64]) -> NDArray[np.int64]:
    """Hours by which a local clock was set forward between rows: 1, 0, or -1 in autumn."""
    steps = after - before
    sunday = (after // DAY_NS + _THURSDAY) % 7 == 0
    night = sunday & (after % DAY_NS < _NIGHT_NS) & (after % _HOUR_NS <= _MINUTE_NS)
    back = night & (steps > -_HOUR_NS) & (steps <= _MINUTE_NS - _HOUR_NS)
    forward = night & (steps > _HOUR_NS) & (steps <= _HOUR_NS + _MINUTE_NS)
    forward &= before % _HOUR_NS >= _HOUR_NS - _MINUTE_NS
    hours: NDArray[np.int64] = np.where(forward, 1, np.where(back, -1, 0))
    return hours


def half_day_back(steps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """True where rows are half a day before the last, as at one on a 12-hour clock."""
    return np.asarray((steps >= -HALF_DAY_NS) & (steps <= HALF_DAY_PAUSE_NS - HALF_DAY_NS))


def begin_drives(
    times: NDArray[Any], before: NDArray[Any], first: float, back: float
) -> NDArray[np.bool_]:
    """True where a drive begins: two rows lie before both `before` rows, near `first`."""
    padded = np.concatenate((before, times))
    least = np.minimum(padded[1:-1], padded[:-2]) - back
    following = np.append(times[1:], times[-1:])
    return np.asarray((np.maximum(times, following) < least) & (times <= first + back))


def joined_cells(cells: Sequence[Cells]) -> pl.Series:
    """Date and time of each row in one text, with uniform separators."""
    columns = pl.DataFrame(
        {str(i): pl.Series(column, dtype=pl.String) for i, column in enumerate(cells)}
    )
    first, *others = (pl.col(name).str.strip_chars() for name in columns.columns)
    if others:  # a date in a spreadsheet is that of midnight
        first = first.str.replace(r"[T ]00:00(:00(\.0+)?)?$", "")
    # Unify, for example, 2024-03-05T07:08:09,5Z and 5.3.2024 7:08:09.5 p.m.
    text = (
        pl.concat_str(first, *others, separator=" ")
        .str.replace(r"^(\w{3}) (\w{3}) (\d)", "$1-$2-$3")
        .str.replace(r"^(\d{1,2}[ -]\pL{3,9})\.([ -])", "$1$2")
        .str.replace(r"^(\d{1,4})[./ -]([\w]{1,9})[./ -](\d{1,4})\.?", "$1-$2-$3")
        .str.replace(r"^(\d{1,4}-\w{1,9}-\d{1,4}),?[T ,]+", "$1 ")
        .str.replace_many(_MONTHS, ascii_case_insensitive=True)
        .str.replace(r"(:\d\d)[,](\d+)", "$1.$2")
        .str.replace(r"\s*([AaPp])\.?\s?[Mm]\.?", " ${1}M")
        .str.replace(r"^(20\d{6})[T_ ]?(\d\d)(\d\d)(\d\d)$", "$1 $2:$3:$4")
        .str.replace(r"(\d)\s*(Z|UTC|GMT)$", "$1+0000")
        .str.replace(r"(:[\d.]+)\s+([+-]\d\d)", "$1$2")
        .str.replace(r"([+-]\d\d)$", "${1}00")
        .str.replace(r"^(\d+:\d+:\d+):(\d{3})\b", "$1.$2")
    )
    return columns.select(text).to_series()


def parsed_times(text: pl.Series, formats: str) -> NDArray[np.int64]:
    """Times of cells in one format, ns since 1970 or midnight; `NONE` if it does not match."""
    if not DAY_OF_FORMAT.search(formats):
        if formats.startswith("%M"):
            text, formats = "0:" + text, f"%H:{formats}"
        parsed = text.str.to_time(formats, strict=False).to_physical()
    elif not CLOCK_OF_FORMAT.search(formats):
        days = text.str.to_date(formats, strict=False).to_physical().cast(pl.Int64)
        parsed = pl.select(
            pl.when(days.abs() < LAST_TIME_NS // DAY_NS).then(days * DAY_NS)
        ).to_series()
    else:
        micros = text.str.to_datetime(formats, strict=False, time_unit="us").to_physical()
        # polars reads at most microseconds; finer stamps are read as numbers.
        far = micros.abs() > LAST_TIME_NS // 1000
        parsed = pl.select(pl.when(~far).then(micros * 1000)).to_series()
    return np.asarray(parsed.fill_null(NONE), np.int64)
