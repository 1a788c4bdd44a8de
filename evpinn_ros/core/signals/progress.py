"""Progress through items with stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import math
from operator import attrgetter
from typing import TypeVar

from evpinn_ros.core.signals.readings import NANOSECONDS

Item = TypeVar("Item")


def reported(
    items: Iterable[Item],
    progress: Callable[[float], None] | None,
    stamp_of: Callable[[Item], int] = attrgetter("stamp_ns"),
) -> Iterator[Item]:
    """Yields the items; reports the seconds since the first about once a second."""
    first_ns: int | None = None
    reported = -math.inf
    for item in items:
        stamp_ns = stamp_of(item)
        first_ns = stamp_ns if first_ns is None else first_ns
        seconds = (stamp_ns - first_ns) / NANOSECONDS
        if progress is not None and seconds - reported >= 1.0:
            progress(seconds)
            reported = seconds
        yield item
