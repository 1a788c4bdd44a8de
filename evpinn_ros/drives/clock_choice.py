"""Choice of the best one of the columns that could be the time."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import permutations

import numpy as np

from evpinn_ros.drives.column import Column
from evpinn_ros.drives.numbers import Style
from evpinn_ros.drives.quantities import score
from evpinn_ros.drives.survey import Survey
from evpinn_ros.drives.times import (
    NONE,
    Clock,
    clock_of_numbers,
    clock_of_text,
    is_newest_first,
)
from evpinn_ros.signals.readings import DAY_NS


def choose_clock(
    found: Sequence[Column],
    survey: Survey,
    styles: Mapping[int, Style],
    header: Sequence[str],
    days: Collection[int] = (),
) -> Clock | None:
    """The clock of a table; None when no column of time can be read.

    `days` since 1970 decide where a date can be read in two ways.

    The best reads most rows, never runs backwards, tells rows apart, and knows the date: LeafSpy's
    `epoch time` goes on where its `Date/Time` jumps with the phone's time zone.
    """
    clocks = _clocks(found, survey, styles, days)
    by_place = {clock.columns[0]: clock for clock in clocks}
    for date, time in permutations(clocks, 2):
        # A date in one column and the time of day in another; half a clock each.
        if _is_day_alone(date, survey) and time.kind == "time of day":
            cells = [survey.cells[date.columns[0]], survey.cells[time.columns[0]]]
            if joined := clock_of_text((date.columns[0], time.columns[0]), cells, days):
                by_place[date.columns[0]] = joined
    merits = {
        clock: _merit(clock, survey, header)
        for clock in by_place.values()
        if not _is_day_alone(clock, survey)
    }
    return max(merits, key=lambda clock: merits[clock], default=None)


def start_by_date(
    clock: Clock,
    found: Sequence[Column],
    survey: Survey,
    styles: Mapping[int, Style],
    days: Collection[int] = (),
) -> tuple[int, Clock] | None:
    """Stamp of time 0 of a clock without a date, ns, by another column, and the clock of that.

    None where no other column has the date and the time of day.
    """
    own = clock.running().add(clock.stamps(survey.cells))
    for other in _clocks(found, survey, styles, days):
        if not other.dated or _is_day_alone(other, survey):
            continue
        dates = other.stamps(survey.cells)
        both = (own != NONE) & (dates != NONE)
        if both.any():  # by the first row: some apps write the date in bursts, later and later
            first = int(np.argmax(both))
            return int(dates[first] - own[first]), other
    return None


def _clocks(
    found: Sequence[Column],
    survey: Survey,
    styles: Mapping[int, Style],
    days: Collection[int] = (),
) -> list[Clock]:
    columns = [column for column in found if column.quantity == "time"]
    return [clock for column in columns if (clock := _clock(column, survey, styles, days))]


def _clock(
    column: Column, survey: Survey, styles: Mapping[int, Style], days: Collection[int]
) -> Clock | None:
    cells = survey.cells[column.place]
    style, unit = styles[column.place], column.unit or None
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


def _merit(clock: Clock, survey: Survey, header: Sequence[str]) -> tuple[float, ...]:
    stamps = clock.stamps(survey.cells)
    if is_newest_first(stamps[stamps != NONE]):
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
        score("time", header[clock.columns[0]]),
    )
