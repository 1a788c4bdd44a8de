"""The clock of a table: dates of any order, 12 h clocks, times of day, seconds since anything.

A format is chosen once, over the whole column: the one that reads most cells, runs backwards least
and jumps least. polars reads the cells by it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from enum import Enum
from itertools import permutations, product
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
import polars as pl

from evpinn_ros.drives.column import Column
from evpinn_ros.drives.numbers import POINT, Style, is_missing, to_floats
from evpinn_ros.drives.quantities import QUANTITIES, score
from evpinn_ros.drives.source import STRAGGLING_NS
from evpinn_ros.drives.survey import Survey
from evpinn_ros.signals.readings import DAY_NS, NANOSECONDS

STARTED = r"start\w*\s*(?:time)?\s*[=:]\s*(.+)"
LONGEST_COMMENT = 200  # characters: the expression above takes the square of them
NONE = np.iinfo(np.int64).min  # where there is no time
HALF_DAY_NS = DAY_NS // 2
FIRST_TIME_NS = 1_200_000_000 * NANOSECONDS  # no log of an electric car is older than 2008
LAST_TIME_NS = 2**31 * NANOSECONDS  # the end of ROS time, in 2038
LARGEST = 1e19  # of a number that is a time: ns since 1970 to the end of 64 bits
RELATIVE_BELOW_S = 1e8  # a first time below this (3 years) counts from the start of something
BACK_NS = 10 * NANOSECONDS  # to where it began, about: a clock that begins anew with each drive
SELDOM = 0.05  # of the rows lie behind the one before, in a table whose drives are in order
PAUSE_NS = 3600 * NANOSECONDS  # between such drives; it is not known, but a drive has ended
SLOWEST_STEP = 5.0  # s: rows farther apart would be useless, so the unit is smaller
# Spreadsheets store a moment as days since 30 December 1899, and a time of day as a part of one.
SERIAL_ZERO_NS = -25_569 * DAY_NS
SERIALS = (39_448.0, 50_424.0)  # days, from 2008 to the end of ROS time
SERIAL_STEP = 60.0 / 86_400.0  # days: less is no step between rows in seconds
MOSTLY = 0.8  # of the steps between rows
SHUFFLED = 0.2  # of the rows lie farther behind the one before: no drive is of so few rows
ENOUGH = 0.9  # of the cells that the best format reads: another that reads so many competes

# Orders of a date, the likeliest first among equals: ISO, then day first as most of the world has
# it, unless an AM or PM says that an American wrote it.
_DATES = {
    "year, month, day": ("%Y-%m-%d", "%Y%m%d"),
    "day, month, year": ("%d-%m-%Y", "%d-%m-%y", "%d-%b-%Y", "%d-%b-%y"),
    "month, day, year": ("%m-%d-%Y", "%m-%d-%y", "%b-%d-%Y"),
}
_CLOCKS_24 = ("%H:%M:%S%.f", "%H:%M")
_CLOCKS_12 = ("%I:%M:%S%.f %p", "%I:%M %p")
_ZONES = ("", "%z")
# Torque's "GPS Time", the text of a Java date: Mon Dec 17 17:46:23 GMT+01:00 2018.
_JAVA = ("%a-%b-%d %H:%M:%S GMT%z %Y", "%a-%b-%d %H:%M:%S UTC %Y")

# Months as phones abbreviate them in German, French, Spanish, Italian, Dutch and Portuguese, where
# English does not.
_MONTHS = {
    f"-{name}-": f"-{month}-"
    for month, names in {
        "Jan": "jän janv ene gen",
        "Feb": "févr fév fev",
        "Mar": "mär märz mrz mars mrt",
        "Apr": "avr abr",
        "May": "mai mag mei",
        "Jun": "juin giu",
        "Jul": "juil lug",
        "Aug": "août aoû ago",
        "Sep": "sept set",
        "Oct": "okt ott out",
        "Dec": "déc dez dic",
    }.items()
    for name in names.split()
}

_NS = {name: 1e9 * unit.factor for name, unit in QUANTITIES["time"].units.items()}
_NS["day"] = float(DAY_NS)  # of spreadsheets alone
_SINCE_1970 = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (RELATIVE_BELOW_S, "s"))


class Order(Enum):
    """Order in which the rows of a table stand."""

    OLDEST_FIRST = "oldest first"
    NEWEST_FIRST = "newest first"  # as a database exports them
    SHUFFLED = "in no order"  # as a database exports them that was not asked to sort

    def rows(self, times: NDArray[Any]) -> NDArray[np.intp]:
        """Places of rows from the oldest to the newest; shape (n,) as their times."""
        if self is Order.SHUFFLED:
            return np.argsort(times, kind="stable")
        return np.arange(times.size)[:: -1 if self is Order.NEWEST_FIRST else 1]


@dataclass(frozen=True, slots=True)
class Clock:
    """Reader of the cells of the time columns."""

    columns: tuple[int, ...]  # of the table, one, or two where date and time are apart
    kind: str  # `number`, `date` or `time of day`
    formats: str = ""  # of polars, one for a date or a time of day
    unit: str = "s"  # of numbers
    zoned: bool = False  # the cells name a zone or are seconds since 1970, so the stamps are UTC
    why: str = ""  # this was chosen, for people
    twelve: bool = False  # hours are counted to twelve
    style: Style = POINT  # of numbers
    daily: bool = False  # numbers begin anew at midnight
    zero_ns: int = 0  # moment that numbers count from, ns since 1970
    drives_from_ns: int | None = None  # time that each drive begins at; None if there is one
    order: Order = Order.OLDEST_FIRST  # of the rows

    @property
    def period_ns(self) -> int:
        """Time after which it begins anew, a day or half of it; 0 where it runs on."""
        if self.kind != "time of day" and not self.daily:
            return 0
        return HALF_DAY_NS if self.twelve and "%p" not in self.formats else DAY_NS

    @property
    def begins_anew(self) -> bool:
        """True if its times do not run on, at midnight or with the next drive."""
        return self.period_ns > 0 or self.drives_from_ns is not None

    def running(self) -> RunningClock:
        """Counter that lets its times run on where it begins anew."""
        return RunningClock(self.period_ns, self.drives_from_ns)

    @property
    def dated(self) -> bool:
        """True if the cells hold the date."""
        return self.kind == "date" or (self.kind == "number" and (self.zoned or self.zero_ns != 0))

    def stamps(self, cells: Mapping[int, Sequence[str]]) -> NDArray[np.int64]:
        """Times of n rows, ns since 1970, midnight or the start; `NONE` where there is none.

        `cells` are n of each of `columns`, and of others perhaps, by the place of the column.
        """
        own = [cells[place] for place in self.columns]
        if self.kind != "number":
            return _parsed(_joined(own), self.formats)
        values = to_floats(own[0], self.style)
        factor = _NS[self.unit]
        bad = ~np.isfinite(values) | (np.abs(values) > 9e18 / factor)
        values = np.where(bad, 0.0, values)
        # Apart from the whole ones, for a float of ns since 1970 is 256 ns coarse.
        whole = np.floor(values)
        rest: NDArray[np.int64] = np.rint((values - whole) * factor).astype(np.int64)
        return np.where(bad, NONE, whole.astype(np.int64) * int(factor) + rest + self.zero_ns)


def _joined(cells: Sequence[Sequence[str]]) -> pl.Series:
    """Date and time of each row in one cell, their signs made uniform."""
    text = pl.Series("", cells[0], dtype=pl.String).str.strip_chars()
    if len(cells) > 1:  # a spreadsheet's date is one of midnight
        text = text.str.replace(r"[T ]00:00(:00(\.0+)?)?$", "")
    for other in cells[1:]:
        more = pl.Series("", other, dtype=pl.String).str.strip_chars()
        text = text + " " + more
    # 2024-03-05T07:08:09,5Z and 5.3.2024 7:08:09.5 p.m. become one pattern.
    return (
        text.str.replace(r"^(\w{3}) (\w{3}) (\d)", "$1-$2-$3")
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


def _parsed(text: pl.Series, formats: str) -> NDArray[np.int64]:
    if formats.startswith(("%H", "%I")):
        parsed = text.str.to_time(formats, strict=False).to_physical()
    elif ":" not in formats:
        days = text.str.to_date(formats, strict=False).to_physical().cast(pl.Int64)
        parsed = pl.select(
            pl.when(days.abs() < LAST_TIME_NS // DAY_NS).then(days * DAY_NS)
        ).to_series()
    else:
        micros = text.str.to_datetime(formats, strict=False, time_unit="us").to_physical()
        # Digits below a microsecond are for logs whose stamps are numbers.
        far = micros.abs() > LAST_TIME_NS // 1000
        parsed = pl.select(pl.when(~far).then(micros * 1000)).to_series()
    return np.asarray(parsed.fill_null(NONE), np.int64)


def _order_of(clock: Clock, stamps: NDArray[np.int64]) -> Order:
    """Order of rows that have these times of a clock."""
    if _is_newest_first(stamps[stamps != NONE]):
        return Order.NEWEST_FIRST
    times = clock.running().add(stamps)
    times = times[times != NONE]
    back = np.diff(times) < -STRAGGLING_NS
    if not back.any():
        return Order.OLDEST_FIRST
    mixed = back.size >= 3 and np.mean(back) > SHUFFLED
    return (
        Order.SHUFFLED
        if mixed or (clock.dated and _lie_apart(times, back))
        else Order.OLDEST_FIRST
    )


def _lie_apart(times: NDArray[np.int64], back: NDArray[np.bool_]) -> bool:
    """True if no two parts of a table, between which time goes back, are of the same hours.

    They are then drives that were put together in the order of their names. A clock that was set
    back, as in autumn, goes through the same hour twice.
    """
    begins = np.append(0, np.flatnonzero(back) + 1)
    first, last = np.minimum.reduceat(times, begins), np.maximum.reduceat(times, begins)
    order = np.argsort(first)
    return bool((last[order][:-1] < first[order][1:]).all())


def _is_newest_first(times: NDArray[Any]) -> bool:
    """True if times run backwards on the whole, in whichever unit."""
    steps = np.diff(times)
    return steps.size >= 3 and float(np.mean(steps < 0)) > MOSTLY


def _forward(times: NDArray[Any]) -> NDArray[Any]:
    return times[::-1] if _is_newest_first(times) else times


def clock_of_numbers(
    column: int, cells: Sequence[str], style: Style, unit: str | None, *, in_seconds: bool = False
) -> Clock | None:
    """The clock of a column of numbers; None where most cells are none.

    Args:
        column: its place.
        cells: of it.
        style: of their numbers.
        unit: that its name tells, or None.
        in_seconds: numbers that are no dates are s, however far apart rows are: those of a plan
            may be minutes.
    """
    values = to_floats(cells, style)
    known = values[np.abs(values) < LARGEST]
    filled = [cell for cell in cells if not is_missing(cell)]
    if known.size == 0 or known.size < ENOUGH * len(filled):
        return None
    if re.fullmatch(r"20[0-3]\d[01]\d[0-3]\d[0-2]\d[0-5]\d[0-5]\d", filled[0].strip()):
        return None  # 20240305070809 is a date
    known = _forward(known)
    if unit is None and (serial := _serial_clock(column, known, style)):
        return serial
    size = float(np.median(np.abs(known)))
    since_1970 = next((name for least, name in _SINCE_1970 if size >= least), None)
    if since_1970 is not None and (unit is None or size * _NS[unit] / 1e9 >= RELATIVE_BELOW_S):
        name = unit or since_1970
        why = "since 1970, by its values"
        return Clock((column,), "number", unit=name, zoned=True, why=why, style=style)
    name = "s" if in_seconds else unit or _unit_of_steps(known)
    why = "by its name" if unit or in_seconds else "by the step between rows"
    clock = Clock((column,), "number", unit=name, why=why, style=style)
    if _begins_anew(known, DAY_NS / _NS[name]):
        return replace(clock, daily=True)
    if _holds_drives(known, BACK_NS / _NS[name]):
        why = f"{why}, anew with each drive"
        return replace(clock, drives_from_ns=int(known[0] * _NS[name]), why=why)
    return clock


def _serial_clock(column: int, known: NDArray[np.float64], style: Style) -> Clock | None:
    """The clock of a column of a spreadsheet's serial dates, or times of day; None of others."""
    forward = np.diff(known)
    forward = forward[forward > 0]
    if not forward.size or np.median(forward) > SERIAL_STEP:
        return None
    if SERIALS[0] <= known.min() and known.max() <= SERIALS[1]:
        why = "serial dates of a spreadsheet, by their size"
        return Clock((column,), "number", unit="day", why=why, style=style, zero_ns=SERIAL_ZERO_NS)
    if known.min() >= 0.0 and known.max() < 1.0:
        why = "parts of a day, by their size"
        return Clock((column,), "number", unit="day", why=why, style=style, daily=True)
    return None


def _unit_of_steps(times: NDArray[np.float64]) -> str:
    """Unit of times by how far apart they are, in whichever order the rows stand."""
    steps = np.diff(times if _is_in_order(times) else np.sort(times))
    forward = steps[steps > 0]
    step = float(np.median(forward)) if forward.size else 0.0
    if step <= SLOWEST_STEP:
        return "s"
    return "ms" if step < SLOWEST_STEP * 1e3 else "us" if step < SLOWEST_STEP * 1e6 else "ns"


def _begins_anew(times: NDArray[np.float64], day: float) -> bool:
    """True if times are those of a day, in the unit of `day`, and midnight passes."""
    inside = times.min() >= 0 and times.max() <= day
    return bool(inside and (np.diff(times) < -0.9 * day).any())


def _is_in_order(times: NDArray[np.float64]) -> bool:
    """True if nearly every time is later than the one before."""
    return times.size > 1 and float(np.mean(np.diff(times) < 0)) <= SELDOM


def _holds_drives(times: NDArray[np.float64], back: float) -> bool:
    """True if times go back to the first one, by more than `back`, and on from there."""
    return _is_in_order(times) and bool(_begin_drives(times, times[[0, 0]], times[0], back).any())


def _begin_drives(
    times: NDArray[Any], before: NDArray[Any], first: float, back: float
) -> NDArray[np.bool_]:
    """True where a drive begins: it and the next row lie behind the two before, so none is wrong.

    `before` are the two times before these; `first` is where drives begin, about.
    """
    padded = np.concatenate((before, times))
    least = np.minimum(padded[1:-1], padded[:-2]) - back
    following = np.append(times[1:], times[-1:])
    return np.asarray((np.maximum(times, following) < least) & (times <= first + back))


def clock_of_text(
    columns: tuple[int, ...], cells: Sequence[Sequence[str]], days: Collection[int] = ()
) -> Clock | None:
    """The clock of columns of dates or times of day; None where most cells are neither.

    `days` since 1970 may be the first one: they decide where a date can be read in two ways.
    """
    text = _joined(cells)
    text = text.filter(text.str.contains(r"\d\D\d|\d{8}"))
    filled = max(sum(not is_missing(cell) for cell in column) for column in cells)
    if len(text) == 0 or len(text) < 0.5 * filled:
        return None
    first = text.head(200)
    with_date = bool(text.str.contains(r"^\w+-\w+-\w+|^\d{8}").any())
    twelve = bool(text.str.contains(r" [AaPp]M").any())
    found: list[tuple[tuple[float, ...], Clock]] = []
    for rank, (order, pattern) in enumerate(_formats(with_date, twelve)):
        if (_parsed(first, pattern) == NONE).mean() > 0.5:
            continue
        stamps = _parsed(text, pattern)
        stamps = stamps[stamps != NONE]
        if stamps.size < 0.5 * len(text) or (with_date and not _plausible(stamps)):
            continue
        steps = np.diff(_forward(stamps))
        backwards = int((steps < 0).sum())
        if not with_date and not twelve:
            hours = stamps // (3600 * NANOSECONDS)
            twelve = bool(
                hours.min() >= 1 and hours.max() <= 12 and (steps < -HALF_DAY_NS * 0.9).any()
            )
        long = float(np.sum(np.abs(steps) > DAY_NS)) if with_date else 0.0
        span = float(np.ptp(stamps)) if with_date else 0.0
        named = with_date and int(stamps[0]) // DAY_NS in days
        merit = (
            *(-float(stamps.size), float(backwards), long, span),
            *(-float(named), float(rank)),
        )
        kind = "date" if with_date else "time of day"
        clock = Clock(columns, kind, pattern, "", "%z" in pattern, order, twelve)
        found.append((merit, clock))
    return _best(found)


def _best(found: list[tuple[tuple[float, ...], Clock]]) -> Clock | None:
    if not found:
        return None
    found.sort(key=lambda each: each[0])
    merit, clock = found[0]
    rivals = [other for m, other in found[1:] if m[:5] == merit[:5] and other.why != clock.why]
    if rivals and clock.why:
        doubt = f"{clock.why}; could be {rivals[0].why} as well"
        clock = replace(clock, why=doubt)
    return clock


def _plausible(stamps: NDArray[np.int64]) -> bool:
    """True if most times are those of a log."""
    return bool(FIRST_TIME_NS < np.median(stamps) < LAST_TIME_NS)


def _formats(with_date: bool, twelve: bool) -> list[tuple[str, str]]:
    clocks = _CLOCKS_12 if twelve else _CLOCKS_24
    if not with_date:
        return [("", clock) for clock in clocks]
    orders = list(_DATES)
    if twelve:
        orders = [orders[0], orders[2], orders[1]]
    dated = [
        (order, f"{date} {clock}{zone}")
        for order in orders
        for date, clock, zone in product(_DATES[order], clocks, _ZONES)
    ]
    dated += [(order, date) for order in orders for date in _DATES[order]]
    return [*dated, *(("", pattern) for pattern in _JAVA)]


class RunningClock:
    """Times made to run on over midnight, or from drive to drive, batch by batch.

    A 12 h clock without AM and PM goes from 12:59 to 1:00; what falls by about half a day and was
    never above 12 is such a one.
    """

    def __init__(self, period_ns: int, drives_from_ns: int | None = None) -> None:
        """Make times run on that begin anew after a period, or at a time with each drive."""
        self._period, self._first = period_ns, drives_from_ns
        self._added = 0
        self._before: NDArray[np.int64] | None = None  # the last two times

    def add(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """The times of the next rows."""
        there = np.flatnonzero(stamps != NONE)
        if there.size == 0 or not (self._period or self._first is not None):
            return stamps
        known = stamps[there]
        before = known[[0, 0]] if self._before is None else self._before
        steps = np.diff(known, prepend=before[1])
        added = self._added + np.cumsum(self._turns(known, before, steps))
        self._added, self._before = int(added[-1]), np.append(before, known)[-2:]
        found = stamps.copy()
        found[there] = known + added
        return found

    def _turns(
        self, known: NDArray[np.int64], before: NDArray[np.int64], steps: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Time to add from each row on, ns."""
        if self._first is not None:
            begins = _begin_drives(known, before, self._first, BACK_NS)
            return np.where(begins, PAUSE_NS - steps, 0)
        turns = np.where(steps < -self._period // 2, self._period, 0)
        # A straggler from before midnight belongs to the day before.
        straggles = (steps > self._period // 2) & (np.cumsum(turns) + self._added > 0)
        return turns - np.where(straggles, self._period, 0)


def start_of_comments(comments: Sequence[str]) -> int | None:
    """The moment that a line above the header tells, ns; None without one.

    OBD Fusion begins with `# StartTime = 10/14/2017 01:20:36.0000 PM` and counts from there.
    """
    for comment in comments:
        if match := re.search(STARTED, comment[:LONGEST_COMMENT], re.IGNORECASE):
            cells = [match[1].strip(' ,;"')]
            clock = clock_of_text((0,), [cells])
            if clock is not None and clock.kind == "date":
                return int(clock.stamps({0: cells})[0])
    return None


class NamedDate(NamedTuple):
    """A date in the name of a file: midnight, ns since 1970, and the time of day if it has one."""

    day_ns: int
    clock_ns: int | None


_NAMED_DATE = re.compile(
    r"(?<!\d)(?:20)?(\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)"
    r"(?:[ T_-]*([0-2]\d)[-_.:]?([0-5]\d)(?:[-_.:]?[0-5]\d)?)?(?!\d)"
)


def dates_of_name(name: str) -> list[NamedDate]:
    """Dates that a file's name may hold: 20181101, 181101, 2018-11-01_12-40-45 and the like."""
    found = []
    for match in _NAMED_DATE.finditer(name):
        year, month, day = (int(part) for part in match.groups()[:3])
        with suppress(ValueError):
            moment = datetime(2000 + year, month, day, tzinfo=timezone.utc)
            minutes = int(match[4]) * 60 + int(match[5]) if match[4] else None
            clock = None if minutes is None else minutes * 60 * NANOSECONDS
            found.append(NamedDate(int(moment.timestamp()) * NANOSECONDS, clock))
    return [date for date in found if FIRST_TIME_NS < date.day_ns < LAST_TIME_NS]


def days_of_name(name: str) -> frozenset[int]:
    """Days since 1970 that a file's name may hold."""
    return frozenset(date.day_ns // DAY_NS for date in dates_of_name(name))


def day_of_name(name: str, first_ns: int, *, certain: bool) -> int | None:
    """Midnight of the date in a file's name, ns; None without one, or where its clock differs.

    `first_ns` is the first time in the file, and `certain` says that it is a time of day;
    otherwise the name must have the same one.
    """
    for day_ns, clock_ns in dates_of_name(name):
        alike = clock_ns is not None and abs(clock_ns - first_ns % DAY_NS) <= 3600 * NANOSECONDS
        if alike or (clock_ns is None and certain):
            return day_ns
    return None


def clocks_of(
    found: Sequence[Column],
    survey: Survey,
    days: Collection[int] = (),
    *,
    by_signal: bool = False,
) -> list[Clock]:
    """The clocks of a table, the best first; none when no column of time can be read.

    `days` since 1970 decide where a date can be read in two ways. A table `by_signal` has one
    signal after the other, each from the first time to the last.

    The best reads most rows, never runs backwards, tells rows apart, and knows the date: LeafSpy's
    `epoch time` goes on where its `Date/Time` jumps with the phone's time zone.
    """
    columns = [column for column in found if column.quantity == "time"]
    names = {column.place: column.name for column in columns}
    clocks = [clock for column in columns if (clock := _clock(column, survey, days))]
    by_place = {clock.columns[0]: clock for clock in clocks}
    for date, time in permutations(clocks, 2):
        # A date in one column and the time of day in another; half a clock each.
        if _is_day_alone(date, survey) and time.kind == "time of day":
            cells = [survey.cells[date.columns[0]], survey.cells[time.columns[0]]]
            if joined := clock_of_text((date.columns[0], time.columns[0]), cells, days):
                by_place[date.columns[0]] = joined
    merits: dict[Clock, tuple[float, ...]] = {}
    for clock in by_place.values():
        if not _is_day_alone(clock, survey):
            stamps = clock.stamps(survey.cells)
            if by_signal:
                clock = replace(clock, order=Order.SHUFFLED, daily=False, drives_from_ns=None)
            else:
                clock = replace(clock, order=_order_of(clock, stamps))
            merits[clock] = _merit(clock, stamps, names[clock.columns[0]])
    return sorted(merits, key=lambda clock: merits[clock], reverse=True)


def start_by_date(
    clock: Clock, others: Sequence[Clock], survey: Survey
) -> tuple[int, Clock] | None:
    """Stamp of time 0 of a clock without a date, ns, by another one, and that.

    The rows of the survey stand from the oldest to the newest. None where no other clock has the
    date.
    """
    own = clock.running().add(clock.stamps(survey.cells))
    for other in others:
        if not other.dated:
            continue
        dates = other.stamps(survey.cells)
        both = (own != NONE) & (dates != NONE)
        if both.any():  # by the first row: some apps write the date in bursts, later and later
            first = int(np.argmax(both))
            return int(dates[first] - own[first]), other
    return None


def _clock(column: Column, survey: Survey, days: Collection[int]) -> Clock | None:
    cells = survey.cells[column.place]
    style, unit = survey.styles[column.place], column.unit or None
    numbers = clock_of_numbers(column.place, cells, style, unit, in_seconds=column.is_ours)
    if column.is_ours:  # its name says seconds; cells that are none are counted one by one
        return numbers or Clock((column.place,), "number", style=style)
    return numbers or clock_of_text((column.place,), [cells], days)


def _is_day_alone(clock: Clock, survey: Survey) -> bool:
    """True if the column holds dates without a clock, or with that of midnight."""
    if clock.kind != "date" or len(clock.columns) > 1:
        return False
    stamps = clock.stamps(survey.cells)
    known = stamps[stamps != NONE]
    return known.size > 1 and not (known % DAY_NS).any()


def _merit(clock: Clock, stamps: NDArray[np.int64], name: str) -> tuple[float, ...]:
    if clock.order is Order.NEWEST_FIRST:
        stamps = stamps[::-1]
    stamps = clock.running().add(stamps)
    known = stamps[stamps != NONE]
    steps = np.diff(known)
    rising = float((steps > 0).mean()) if steps.size else 0.0
    return (
        round(known.size / max(1, stamps.size), 1),
        -float((steps < 0).sum()),
        float(rising > 0.5),  # a date that comes in bursts tells no rows apart
        float(clock.dated),
        round(rising, 1),
        score("time", name),
    )
