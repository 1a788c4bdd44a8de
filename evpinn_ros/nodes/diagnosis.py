"""Statuses for /diagnostics; the nodes' own are made in `*_diagnosis`, without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import NamedTuple

from evpinn_ros.topics.messages import Level

MISSING_AFTER = 3.0  # s without a message of the main input
LATELY = 10.0  # s for which an event is shown
FEW = 3  # unused messages that need no warning


class Status(NamedTuple):
    """One status of /diagnostics: name of the part, level, one sentence, and values by key."""

    name: str
    level: Level
    text: str
    values: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Health:
    """Faults and counters of a node."""

    bad: Mapping[str, int]  # unused messages, by reason
    faults: Mapping[str, int]  # internal ones, by text
    notices: tuple[str, ...] = ()  # recent events for people, a few words each
    fault: str | None = None  # the newest internal one within `LATELY`
    calls: Mapping[str, int] = field(default_factory=dict)  # of services, by name


WELL = Health({}, {})


class Condition(NamedTuple):
    """Condition of a node that saves its core in a file."""

    health: Health  # of the node
    age: float  # s since the last message of its main input, NaN before the first
    jumps: int  # number of jumps of time back
    file_problem: str | None  # why the file was not used or not written, or None
    silent: str = ""  # publishers of its main input, and why their messages are not used


class Lately:
    """Counts in the last `LATELY` seconds, from counters since the start."""

    def __init__(self) -> None:
        self._looks: deque[tuple[float, Mapping[str, int]]] = deque([(-math.inf, {})])

    def update(self, now: float, counts: Mapping[str, int]) -> dict[str, int]:
        """Positive counts of the seconds before `now`, s of a monotonic clock."""
        self._looks.append((now, dict(counts)))
        while self._looks[1][0] <= now - LATELY:
            self._looks.popleft()
        before = self._looks[0][1]
        added = {reason: count - before.get(reason, 0) for reason, count in counts.items()}
        return {reason: count for reason, count in added.items() if count > 0}


def unused_notice(lately: Mapping[str, int]) -> str | None:
    """One line on recently lost or unused messages; None if there are at most `FEW`."""
    if sum(lately.values()) <= FEW:
        return None
    return "not used lately: " + ", ".join(f"{why} {n}" for why, n in sorted(lately.items()))


def with_health(status: Status, health: Health) -> Status:
    """A status with counters and notices of its node; an internal fault makes it an error."""
    counters = {"bad": health.bad, "fault": health.faults, "calls": health.calls}
    values = dict(status.values)
    for name, counts in counters.items():
        values |= flat(name, counts)
    if health.fault is None:
        text = "; ".join((status.text, *health.notices))
        level = max(status.level, Level.WARN) if health.notices else status.level
        return status._replace(level=level, text=text, values=values)
    text = f"internal fault: {health.fault}"
    return status._replace(level=Level.ERROR, text=text, values=values)


def flat(name: str, values: Mapping[str, object]) -> dict[str, object]:
    """Values of a status with keys `name.key`."""
    return {f"{name}.{reason}": value for reason, value in sorted(values.items())}


def rounded(number: float) -> object:
    """A number rounded to three decimals; NaN stays NaN."""
    return number if math.isnan(number) else round(number, 3)
