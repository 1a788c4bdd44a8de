"""Times of text logs as python-can's readers take them: since 1970, or since the log began.

An .asc may count from a trigger, midnight, a computer's start or the line before, with a date in
any language.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import datetime
from itertools import pairwise
import re

from evpinn_ros.common.months import MONTHS

SAME_MOMENT = 60.0  # s between the date of a log and its first time of day
# s: a log whose first time is later counts from something else than its date
LATEST_FIRST = 3600.0
EPOCH = 1e6  # s: times above it are not since the line before
LOOKED_AT = 200  # lines
GOES_BACK = 0.3  # of the steps between lines

_DATE = re.compile(
    r"(?:date|begin\s+triggerblock)\s+\w+\.?\s+(\w+)\.?\s+(\d+)\s+"
    r"(\d+):(\d+):(\d+(?:\.\d+)?)(?:\s*([ap]m))?\s+(\d{4})",
    re.IGNORECASE,
)
_TIME = re.compile(r"\s*(-?\d+\.\d+)(\s.*)", re.DOTALL)
_FRAME = re.compile(r"\s+(\d+\s+(\w+\s+(Tx|Rx)|ErrorFrame)|CANFD)", re.ASCII | re.IGNORECASE)
_STAMP = re.compile(r"\s*\((\d+\.\d+)\)(.*)", re.DOTALL)


class TimedLines:
    """The lines of a log with times that run on."""

    summed = False

    def asc(self, lines: Iterable[str]) -> Iterator[str]:
        """Lines of an .asc, with times since 1970 if its date is known."""
        start: datetime | None = None
        base: float | None = None
        passed = 0.0
        for line in lines:
            if match := _DATE.match(line.strip()):
                start, base = _date(match), None
            elif line.lower().startswith("base"):
                self.summed = "relative" in line.lower()
            if not (match := _TIME.fullmatch(line)):
                yield line
                continue
            passed = float(match[1]) + (passed if self.summed else 0.0)
            if base is None and _FRAME.match(match[2]):
                base = _base(start, passed)
            if base is not None:
                yield f"{base + passed:.9f}{match[2]}"

    def candump(self, ahead: Iterable[str], lines: Iterable[str]) -> Iterator[str]:
        """Lines of candump with times since 1970 or the first; `ahead` are the first of them."""
        stamps = [float(stamp[1]) for line in ahead if (stamp := _STAMP.fullmatch(line))]
        back = sum(later < earlier for earlier, later in pairwise(stamps))
        # the times of the log are those since the line before
        self.summed = back > GOES_BACK * len(stamps) and max(stamps) < EPOCH
        passed = 0.0
        for line in lines:
            stamp = _STAMP.fullmatch(line) if self.summed else None
            if stamp is None:
                yield line
                continue
            passed += float(stamp[1])
            yield f"({passed:.6f}){stamp[2]}"


def _date(match: re.Match[str]) -> datetime | None:
    """The date of a line; None where its month is of no known language."""
    month, day, hour, minute, second, half, year = match.groups()
    number = MONTHS.get(month.lower()[:4]) or MONTHS.get(month.lower()[:3])
    if number is None:
        return None
    hours = int(hour) % 12 + (12 if half.lower() == "pm" else 0) if half else int(hour)
    text = f"{year}-{number:02d}-{int(day):02d} {hours:02d}:{minute}:{float(second):09.6f}"
    try:
        return datetime.strptime(text, "%Y-%m-%d %H:%M:%S.%f")
    except ValueError:
        return None


def _base(start: datetime | None, first: float) -> float:
    """What to add to the times of a log, s; its first time is this."""
    if start is None:
        return max(0.0, -first)
    midnight = start.replace(hour=0, minute=0, second=0, microsecond=0)
    if abs(first - (start - midnight).total_seconds()) < SAME_MOMENT:
        return midnight.timestamp()
    return start.timestamp() - (first if first > LATEST_FIRST else 0.0)
