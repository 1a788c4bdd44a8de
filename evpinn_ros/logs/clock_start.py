"""Finds the start of a clock without a date: in another column, the file's name, a comment."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timezone
import re
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.readings import DAY_NS, NANOSECONDS
from evpinn_ros.logs.clock import LAST_TIME_NS, NONE, Clock
from evpinn_ros.logs.clock_choice import FIRST_TIME_NS, clock_of_text
from evpinn_ros.logs.survey import Survey

STARTED = r"start\w*\s*(?:time)?\s*[=:]\s*(.+)"
LONGEST_COMMENT = 200  # characters: the expression above takes time quadratic in them
_NAMED_DATE = re.compile(
    r"(?<!\d)(?:20)?(\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)"
    r"(?:[ T_-]*([0-2]\d)[-_.:]?([0-5]\d)(?:[-_.:]?[0-5]\d)?)?(?!\d)"
)


def start_by_date(
    clock: Clock, others: Sequence[Clock], survey: Survey
) -> tuple[int, Clock] | None:
    """Stamp, ns, of time 0 of a clock without a date, and the clock that has the date; or None.

    The rows of the survey are in order of time.
    """
    times = clock.running().add(clock.stamps(survey.cells))
    for other in others:
        if not other.dated:
            continue
        dates = other.stamps(survey.cells)
        both = (times != NONE) & (dates != NONE)
        if both.any():  # by the first row: some apps write the date in bursts, with growing delay
            first = int(np.argmax(both))
            return int(dates[first] - times[first]), other
    return None


class NamedDate(NamedTuple):
    """A date in a file's name: midnight, ns since 1970, and the time of day, if given."""

    day_ns: int
    clock_ns: int | None


def dates_of_name(name: str) -> list[NamedDate]:
    """Dates that a file's name may contain: 20181101, 181101, 2018-11-01_12-40-45 and similar."""
    dates = []
    for match in _NAMED_DATE.finditer(name):
        year, month, day = (int(part) for part in match.groups()[:3])
        with suppress(ValueError):
            moment = datetime(2000 + year, month, day, tzinfo=timezone.utc)
            minutes = int(match[4]) * 60 + int(match[5]) if match[4] else None
            clock = None if minutes is None else minutes * 60 * NANOSECONDS
            dates.append(NamedDate(int(moment.timestamp()) * NANOSECONDS, clock))
    return [date for date in dates if FIRST_TIME_NS < date.day_ns < LAST_TIME_NS]


def days_of_name(name: str) -> frozenset[int]:
    """Days since 1970 that a file's name may contain."""
    return frozenset(date.day_ns // DAY_NS for date in dates_of_name(name))


def day_of_name(name: str, first_ns: int, *, certain: bool) -> int | None:
    """Midnight, ns, of the date in a file's name; None without a date that fits.

    The name's time of day must be within an hour of `first_ns`; a date without time needs
    `certain`.
    """
    for day_ns, clock_ns in dates_of_name(name):
        agrees = clock_ns is not None and abs(clock_ns - first_ns % DAY_NS) <= 3600 * NANOSECONDS
        if agrees or (clock_ns is None and certain):
            return day_ns
    return None


def start_of_comments(comments: Sequence[str]) -> int | None:
    """Time in a comment, ns, such as OBD Fusion's `# StartTime = ... PM`; or None."""
    for comment in comments:
        if match := re.search(STARTED, comment[:LONGEST_COMMENT], re.IGNORECASE):
            cells = [match[1].strip(' ,;"')]
            clock = clock_of_text((0,), [cells])
            if clock is not None and clock.kind == "date":
                return int(clock.stamps({0: cells})[0])
    return None
