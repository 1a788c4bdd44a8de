"""Chooses a table's clock: the format that reads most cells, with the fewest jumps."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import permutations, product
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.core.signals.readings import DAY_NS, NANOSECONDS
from evpinn_ros.logs.batch import Cells
from evpinn_ros.logs.clock import (
    BACK_NS,
    DAY_OF_FORMAT,
    LAST_TIME_NS,
    NONE,
    UNITS_NS,
    Clock,
    Order,
    RowSpread,
    begin_drives,
    half_day_back,
    joined_cells,
    parsed_times,
)
from evpinn_ros.logs.column import Column
from evpinn_ros.logs.numbers import Style, filled, to_floats
from evpinn_ros.logs.quantities import QUANTITIES, score
from evpinn_ros.logs.source import STRAGGLING_NS
from evpinn_ros.logs.survey import Survey

FIRST_TIME_NS = 1_200_000_000 * NANOSECONDS  # no log of an electric car is older than 2008
LARGEST = 1e19  # largest number that is a time: ns since 1970 up to 64 bits
RELATIVE_BELOW_S = 1e8  # smaller first times (3 years) do not count from 1970
SELDOM = 0.05  # share of rows earlier than the last, in a table of ordered drives
FASTEST_STEP = 9e-4  # s: shorter steps mean days of a spreadsheet, not seconds
SLOWEST_STEP = 5.0  # s: longer steps would be useless, so the unit is smaller
MOSTLY = 0.8  # share of the steps between rows
SHUFFLED = 0.2  # share of rows much earlier than the last: drives have more rows
SHARED = 0.3  # share of rows with the stamp of the last, if stamps are coarse
LEAST_SHARED = 3  # shared stamps needed to estimate the interval of rows
LEAP_NS, LEAST_PART = 600 * NANOSECONDS, 10  # forward, and rows between two leaps
LEAST_SECONDS = 20  # different seconds that tell a clock without colons from a number
CHANGED = 0.1  # share of the rows with a shared stamp whose value differs from the last
LONG_STEP, SLOW = 25.0, 3e-3  # s between rows, and mean change of speed in m/s^2: too slow
SMOOTH = 0.1  # largest change between rows of a well-sampled speed, as a share of its span
USUAL_CHANGE = (0.01, 2.0)  # m/s^2, mean of a moving car
IMPOSSIBLE = 20.0  # m/s^2
PAUSE = 10.0  # in usual steps
ENOUGH = 0.9  # share of the best format's cells that a competing format reads

# Orders of a date, in order of preference among equals: ISO, then day first as in most of the
# world, unless AM or PM shows that an American wrote it.
_DATES = {
    "year, month, day": ("%Y-%m-%d", "%Y%m%d"),
    "day, month, year": ("%d-%m-%Y", "%d-%m-%y", "%d-%b-%Y", "%d-%b-%y"),
    "month, day, year": ("%m-%d-%Y", "%m-%d-%y", "%b-%d-%Y"),
}
ASSUMED_UNIT = "assumed: in the unit of the name, speed would change as no car's does"
UNITS_OF_SPEED = QUANTITIES["speed"].units
_CLOCKS_24 = ("%H:%M:%S%.f", "%H:%M")
_CLOCKS_12 = ("%I:%M:%S%.f %p", "%I:%M %p")
_ZONES = ("", "%z")
_SINCE_1970 = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (RELATIVE_BELOW_S, "s"))


def clocks_of(used: Sequence[Column], survey: Survey, days: Collection[int] = ()) -> list[Clock]:
    """The clocks of a table, best first: those that read most rows, go back least, have the date.

    LeafSpy's `epoch time` is continuous where its `Date/Time` jumps with the phone's time zone.
    `days` since 1970 decide between two readings of a date.
    """
    columns = [column for column in used if column.quantity == "time"]
    names = {column.place: column.name for column in columns}
    speed = next((column for column in used if column.quantity == "speed"), None)
    clocks = [
        clock if speed is None else _in_possible_unit(clock, speed, survey)
        for column in columns
        if (clock := _clock(column, survey, days))
    ]
    by_place = {clock.columns[0]: clock for clock in clocks}
    stamps_of = {clock: clock.stamps(survey.cells) for clock in clocks}
    for date, time in permutations(clocks, 2):
        # A date in one column and the time of day in another make one clock.
        if _is_day_alone(date, stamps_of[date]) and time.kind == "time of day":
            cells = [survey.cells[date.columns[0]], survey.cells[time.columns[0]]]
            if joined := clock_of_text((date.columns[0], time.columns[0]), cells, days):
                by_place[date.columns[0]] = joined
                stamps_of[joined] = joined.stamps(survey.cells)
    merits: dict[Clock, tuple[float, ...]] = {}
    for clock in by_place.values():
        stamps = stamps_of[clock]
        if not _is_day_alone(clock, stamps):
            clock = replace(clock, half_days=_is_of_half_days(clock, stamps))
            clock = _in_its_order(clock, stamps, survey, names)
            clock = replace(clock, spread=_spread_of(clock, stamps, survey, names))
            merits[clock] = _merit(clock, stamps, names[clock.columns[0]])
    return sorted(merits, key=lambda clock: merits[clock], reverse=True)


def _clock(column: Column, survey: Survey, days: Collection[int]) -> Clock | None:
    if "%" in column.unit:
        return clock_of_format(column.place, column.unit)
    cells = survey.cells[column.place]
    style, unit = survey.styles[column.place], column.unit or None
    numbers = clock_of_numbers(column.place, cells, style, unit, in_seconds=column.is_ours)
    if column.is_ours:  # in seconds by its name; unreadable cells are counted later
        return numbers or Clock((column.place,), "number", style=style)
    return numbers or clock_of_text((column.place,), [cells], days)


def clock_of_format(column: int, formats: str) -> Clock:
    """The clock of a column with a person's format, such as `%d.%m.%Y %H:%M:%S%.f`."""
    kind = "date" if DAY_OF_FORMAT.search(formats) else "time of day"
    zoned = "%z" in formats or "%s" in formats
    return Clock((column,), kind, formats, "", zoned, why="as given", as_written=True)


def clock_of_numbers(
    column: int, cells: Cells, style: Style, unit: str | None, *, in_seconds: bool = False
) -> Clock | None:
    """The clock of a column of numbers; None if most are no times.

    Without `unit`, numbers that do not count from 1970 have the unit of their steps, or seconds if
    `in_seconds`.
    """
    values = to_floats(cells, style)
    times = values[np.abs(values) < LARGEST]
    texts = filled(cells)
    if times.size == 0 or times.size < ENOUGH * len(texts):
        return None
    if re.fullmatch(r"20[0-3]\d[01]\d[0-3]\d[0-2]\d[0-5]\d[0-5]\d", texts[0].strip()):
        return None  # a date such as 20240305070809
    if unit is None and not in_seconds and _is_clock_without_colons(times):
        return None
    times = _forward(times)
    size = float(np.median(np.abs(times)))
    since_1970 = next((name for least, name in _SINCE_1970 if size >= least), None)
    if since_1970 is not None and (
        unit is None or size * UNITS_NS[unit] / 1e9 >= RELATIVE_BELOW_S
    ):
        name = unit or since_1970
        if size * UNITS_NS[name] < FIRST_TIME_NS:
            return None  # another epoch, or ticks of 100 ns
        why = "since 1970, by its values"
        return Clock((column,), "number", unit=name, zoned=True, why=why, style=style)
    name = "s" if in_seconds else unit or _unit_of_steps(times)
    if not name:
        return None
    why = "by its name" if unit or in_seconds else "by the step between rows"
    clock = Clock((column,), "number", unit=name, why=why, style=style)
    if _begins_anew(times, DAY_NS / UNITS_NS[name]):
        return replace(clock, daily=True)
    # Each drive restarts the clock at the first time.
    first, back = times[0], BACK_NS / UNITS_NS[name]
    if _is_in_order(times) and begin_drives(times, times[[0, 0]], first, back).any():
        return replace(clock, drives_from_ns=int(times[0] * UNITS_NS[name]))
    return clock


def _is_clock_without_colons(times: NDArray[np.float64]) -> bool:
    """True if 95959 is followed by 100000: minutes and seconds stay below 60."""
    whole = np.floor(times)
    seconds, minutes = whole % 100, whole // 100 % 100
    inside = (whole >= 0) & (whole < 240_000) & (seconds < 60) & (minutes < 60)
    return bool(inside.all() and np.ptp(whole) > 100 and np.unique(seconds).size >= LEAST_SECONDS)


def _unit_of_steps(times: NDArray[np.float64]) -> str:
    """Unit of times by the steps between rows in any order; "" if none fits."""
    steps = np.diff(times if _is_in_order(times) else np.sort(times))
    forward = steps[steps > 0]
    step = float(np.median(forward)) if forward.size else 0.0
    if step <= SLOWEST_STEP:
        return "s" if step >= FASTEST_STEP or not forward.size else ""
    return "ms" if step <= SLOWEST_STEP * 1e3 else "us" if step <= SLOWEST_STEP * 1e6 else "ns"


def _begins_anew(times: NDArray[np.float64], day: float) -> bool:
    """True if times are times of day in the unit of `day`, and midnight passes."""
    inside = times.min() >= 0 and times.max() <= day
    return bool(inside and (np.diff(times) < -0.9 * day).any())


def _is_in_order(times: NDArray[np.float64]) -> bool:
    return times.size > 1 and float(np.mean(np.diff(times) < 0)) <= SELDOM


def clock_of_text(
    columns: tuple[int, ...], cells: Sequence[Cells], days: Collection[int] = ()
) -> Clock | None:
    """The clock of columns of dates or times of day; or None. `days` decide ambiguous dates."""
    text = joined_cells(cells)
    text = text.filter(text.str.contains(r"\d\D\d|\d{8}"))
    if len(text) == 0 or len(text) < 0.5 * max(len(filled(column)) for column in cells):
        return None
    first = text.head(200)
    with_date = bool(text.str.contains(r"^\w+-\w+-\w+|^\d{8}").any())
    twelve = bool(text.str.contains(r" [AaPp]M").any())
    candidates: list[tuple[tuple[float, ...], Clock]] = []
    for rank, (order, pattern) in enumerate(_formats(with_date, twelve)):
        if (parsed_times(first, pattern) == NONE).mean() > 0.5:
            continue
        stamps = parsed_times(text, pattern)
        stamps = stamps[stamps != NONE]
        if stamps.size < 0.5 * len(text):
            continue
        if with_date and not FIRST_TIME_NS < np.median(stamps) < LAST_TIME_NS:
            continue
        steps = np.diff(_forward(stamps))
        backwards = int((steps < 0).sum())
        long = float(np.sum(np.abs(steps) > DAY_NS)) if with_date else 0.0
        span = float(np.ptp(stamps)) if with_date else 0.0
        named = with_date and int(stamps[0]) // DAY_NS in days
        merit = (
            *(-float(stamps.size), float(backwards), long, span),
            *(-float(named), float(rank)),
        )
        kind = "date" if with_date else "time of day"
        clock = Clock(columns, kind, pattern, "", "%z" in pattern, order)
        candidates.append((merit, clock))
    return _best(candidates)


def _best(candidates: list[tuple[tuple[float, ...], Clock]]) -> Clock | None:
    """The best clock; its `why` names an equally good order of year, month and day."""
    if not candidates:
        return None
    candidates.sort(key=lambda candidate: candidate[0])
    merit, clock = candidates[0]
    rivals = [
        other for m, other in candidates[1:] if m[:5] == merit[:5] and other.why != clock.why
    ]
    if rivals and clock.why:
        doubt = f"{clock.why}; could be {rivals[0].why} as well"
        clock = replace(clock, why=doubt)
    return clock


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
    return dated + [(order, date) for order in orders for date in _DATES[order]]


def _in_possible_unit(clock: Clock, speed: Column, survey: Survey) -> Clock:
    """The clock; in another unit if the changes of speed would be impossible in its own."""
    if clock.kind != "number" or clock.why != "by its name":
        return clock
    values = to_floats(survey.cells[speed.place], survey.styles[speed.place])
    values = values * (speed.factor if speed.has_unit else UNITS_OF_SPEED["km/h"].factor)
    times = clock.stamps(survey.cells)
    there = np.isfinite(values) & (times != NONE)
    times, values = times[there], values[there]
    steps, changes = np.abs(np.diff(times)) / NANOSECONDS, np.abs(np.diff(values))
    usual = np.median(steps[steps > 0.0]) if steps.any() else 0.0
    moves = ((values[1:] != 0.0) | (values[:-1] != 0.0)) & (steps <= PAUSE * usual)
    steps, changes = steps[moves], changes[moves]
    if steps.size < LEAST_SECONDS or not steps.sum() or not changes.sum():
        return clock
    mean, step = float(changes.sum() / steps.sum()), float(np.median(steps)) / survey.stride
    is_followed = changes.mean() < SMOOTH * float(np.ptp(values))
    too_slow = (step > LONG_STEP or mean < SLOW) and is_followed
    if not too_slow and mean < IMPOSSIBLE:
        return clock
    now = UNITS_NS[clock.unit]
    for name in ("ms", "s", "us", "min"):
        factor = UNITS_NS[name] / now
        if (factor < 1.0) == too_slow and USUAL_CHANGE[0] < mean / factor < USUAL_CHANGE[1]:
            return replace(clock, unit=name, why=ASSUMED_UNIT)
    return clock


def _is_of_half_days(clock: Clock, stamps: NDArray[np.int64]) -> bool:
    """True if 12:59 is followed by 1:00, and no hour is above 12."""
    times = stamps[stamps != NONE]
    if clock.kind == "number" or "%p" in clock.formats or not times.size:
        return False
    hours = times % DAY_NS // (3600 * NANOSECONDS)
    is_back = half_day_back(np.diff(_forward(times))).any()
    return bool(is_back and hours.min() >= 1 and hours.max() <= 12)


def _in_its_order(
    clock: Clock, stamps: NDArray[np.int64], survey: Survey, times: Collection[int]
) -> Clock:
    """The clock with the order of rows; columns stacked in one table are no new drives."""
    there = stamps != NONE
    if not _is_newest_first(stamps[there]) and _goes_back(stamps[there]):
        numbers = (
            np.isfinite(to_floats(cells, survey.styles[place]))
            for place, cells in survey.cells.items()
            if place not in times
        )
        columns = [stamps[there & of_column] for of_column in numbers]
        if columns and not any(map(_goes_back, columns)):
            return replace(clock, order=Order.SHUFFLED, daily=False, drives_from_ns=None)
        if (first := clock.drives_from_ns) is not None:
            begins = [_begins(times, first) for times in (stamps[there], *columns)]
            if begins[0] > 2 * max(begins[1:], default=0):
                clock = replace(clock, drives_from_ns=None)
    if clock.drives_from_ns is not None:
        clock = replace(clock, why=f"{clock.why}, anew with each drive")
    return replace(clock, order=_order_of(clock, stamps))


def _spread_of(
    clock: Clock, stamps: NDArray[np.int64], survey: Survey, times: Collection[int]
) -> RowSpread | None:
    """How rows share coarse stamps; None if rows with one stamp are of one moment."""
    if clock.order is Order.SHUFFLED:
        return None
    rows = clock.order.rows(stamps)
    rows = rows[stamps[rows] != NONE]
    steps = np.diff(stamps[rows])
    again = np.flatnonzero(steps == 0)
    later = steps[steps > 0]
    if again.size < SHARED * steps.size or not again.size:
        return None
    resolution = int(later.min(initial=DAY_NS))
    if resolution < NANOSECONDS or (later % resolution).any():
        return None
    for place, cells in survey.cells.items():
        if place in times:
            continue
        values = to_floats(cells, survey.styles[place])[rows]
        change = np.abs(values[again + 1] - values[again])
        if np.isfinite(change).mean() > 0.5 and (change > 0).mean() > CHANGED:
            begins = np.flatnonzero(steps) + 1
            if begins.size < LEAST_SHARED:
                return RowSpread(resolution, 0, 0)
            count = float(np.median(np.diff(begins)))
            share = survey.stride * np.array([count, begins[0]])
            return RowSpread(resolution, max(1, int(share[0])), int(share[1]))
    return None


def _goes_back(times: NDArray[np.int64]) -> bool:
    return bool((np.diff(times) < -STRAGGLING_NS).any())


def _begins(times: NDArray[np.int64], first: int) -> int:
    if times.size < 2:
        return 0
    return int(begin_drives(times, times[[0, 0]], first, BACK_NS).sum())


def _order_of(clock: Clock, stamps: NDArray[np.int64]) -> Order:
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
    """True if the parts between leaps in time cover different hours.

    Files joined by name do, and so does a drive during which the phone's time zone differed.
    """
    begins = np.append(0, np.flatnonzero(back | (np.diff(times) > LEAP_NS)) + 1)
    if np.diff(np.append(begins, times.size)).min() < LEAST_PART:  # a broken date
        begins = np.append(0, np.flatnonzero(back) + 1)
    first, last = np.minimum.reduceat(times, begins), np.maximum.reduceat(times, begins)
    order = np.argsort(first)
    return bool((last[order][:-1] < first[order][1:]).all())


def _is_newest_first(times: NDArray[Any]) -> bool:
    steps = np.diff(times)
    steps = steps[steps != 0]
    return steps.size >= 3 and float(np.mean(steps < 0)) > MOSTLY


def _forward(times: NDArray[Any]) -> NDArray[Any]:
    return times[::-1] if _is_newest_first(times) else times


def _is_day_alone(clock: Clock, stamps: NDArray[np.int64]) -> bool:
    """True if the column holds dates without a time, or with midnight as the time."""
    if clock.kind != "date" or len(clock.columns) > 1:
        return False
    times = stamps[stamps != NONE]
    return times.size > 1 and not (times % DAY_NS).any()


def _merit(clock: Clock, stamps: NDArray[np.int64], name: str) -> tuple[float, ...]:
    """Sort key, best last: share of rows read, steps back, rising steps, date, name."""
    if clock.order is Order.NEWEST_FIRST:
        stamps = stamps[::-1]
    stamps = clock.running().add(stamps)
    times = stamps[stamps != NONE]
    steps = np.diff(times)
    rising = float((steps > 0).mean()) if steps.size else 0.0
    return (
        round(times.size / max(1, stamps.size), 1),
        -float((steps < 0).sum()),
        round(rising, 1),  # a date written in bursts does not order rows
        float(clock.dated),
        score("time", name),
    )
