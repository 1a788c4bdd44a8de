"""How a node is doing, as /diagnostics tells it, decided without ROS.

Each node has a module beside this one with its pure function: state in, `Status` out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import NamedTuple

from evpinn_ros.nodes.messages import Level

SILENT_AFTER = 3.0  # s without a message of the leading input


class Status(NamedTuple):
    """One status of /diagnostics: of which part, how bad, one sentence, and the numbers."""

    name: str
    level: Level
    text: str
    values: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Health:
    """What went wrong in a node: messages not used by reason, faults of our own by text."""

    bad: Mapping[str, int]
    faults: Mapping[str, int]


def with_health(status: Status, health: Health) -> Status:
    """A status with the counters of its node; a fault of our own outweighs all else."""
    values = {**status.values, **flat("bad", health.bad), **flat("fault", health.faults)}
    if not health.faults:
        return status._replace(values=values)
    newest = list(health.faults)[-1]
    return status._replace(level=Level.ERROR, text=f"internal fault: {newest}", values=values)


def flat(name: str, values: Mapping[str, object]) -> dict[str, object]:
    """Counters and the like as values of a status: `name.reason`."""
    return {f"{name}.{reason}": value for reason, value in sorted(values.items())}


def rounded(number: float) -> object:
    """A number as people read it."""
    return number if math.isnan(number) else round(number, 3)


def recorder_status(
    folder: str, counts: Mapping[str, int], problem: str | None, health: Health
) -> Status:
    """The health of the recording: `counts` of what is in the bag, `problem` that ended it."""
    text = f"{counts['messages']} messages and {counts['frames']} CAN frames in {folder}"
    level = Level.OK if problem is None else Level.ERROR
    return with_health(Status("bag", level, problem or text, dict(counts)), health)
