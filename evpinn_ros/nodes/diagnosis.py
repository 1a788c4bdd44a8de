"""Status of a node, as /diagnostics shows it, by pure functions in a module for each node."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import NamedTuple

from evpinn_ros.topics.messages import Level

MISSING_AFTER = 3.0  # s without a message of the leading input
LATELY = 10.0  # s for which something that happened is shown
FEW = 3  # messages lost lately that are not worth a warning


class Status(NamedTuple):
    """One status of /diagnostics: of which part, how bad, one sentence, and the numbers."""

    name: str
    level: Level
    text: str
    values: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Health:
    """Faults of a node."""

    bad: Mapping[str, int]  # messages not used, by reason
    faults: Mapping[str, int]  # of our own, by text
    notices: tuple[str, ...] = ()  # what a person should know now, a few words each
    fault: str | None = None  # the newest of our own, None when it is longer ago than `LATELY`
    calls: Mapping[str, int] = field(default_factory=dict)  # of services, by name


WELL = Health({}, {})


class Condition(NamedTuple):
    """Condition of a node whose core is kept in a file."""

    health: Health  # of the node
    age: float  # s since the last message of its leading input, NaN before the first
    jumps: int  # times that time went back
    file_problem: str | None  # why the file was not used or not written, None if all is well
    silent: str = ""  # who publishes its leading input, and why nothing of it is used


class Lately:
    """Counters of the last seconds, from counters since the start."""

    def __init__(self) -> None:
        self._looks: deque[tuple[float, Mapping[str, int]]] = deque([(-math.inf, {})])

    def update(self, now: float, counts: Mapping[str, int]) -> dict[str, int]:
        """Counts added in the last `LATELY` seconds by `now`, s, of a monotonic clock."""
        self._looks.append((now, dict(counts)))
        while self._looks[1][0] <= now - LATELY:
            self._looks.popleft()
        before = self._looks[0][1]
        added = {reason: count - before.get(reason, 0) for reason, count in counts.items()}
        return {reason: count for reason, count in added.items() if count > 0}


def unused_notice(lately: Mapping[str, int]) -> str | None:
    """One line of what was lost or not used lately, None where that is next to nothing."""
    if sum(lately.values()) <= FEW:
        return None
    return "not used lately: " + ", ".join(f"{why} {n}" for why, n in sorted(lately.items()))


def with_health(status: Status, health: Health) -> Status:
    """A status with counters and notices of its node; a fault of our own outweighs all else."""
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
    """Counters and the like as values of a status: `name.reason`."""
    return {f"{name}.{reason}": value for reason, value in sorted(values.items())}


def rounded(number: float) -> object:
    """A number as people read it."""
    return number if math.isnan(number) else round(number, 3)
