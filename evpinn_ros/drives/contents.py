"""Contents of a recording: `evpinn info`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.column import Column
from evpinn_ros.drives.data_coverage import DataCoverage, ReadingFlow, data_coverage
from evpinn_ros.drives.formats import is_drive_table
from evpinn_ros.drives.sources import Source, open_source
from evpinn_ros.signals.progress import reported
from evpinn_ros.vehicle.files import load_vehicle

GENERIC = "generic"

Bar = Callable[[float | None], AbstractContextManager[Callable[[float], None] | None]]


@dataclass(frozen=True, slots=True)
class TopicContents:
    """A topic of a bag, with the log times of its messages."""

    name: str
    type_name: str
    flow: ReadingFlow


@dataclass(frozen=True, slots=True)
class Contents:
    """Contents of a recording."""

    path: Path  # of it
    kind: str  # `bag`, `CAN log` or `table`
    topics: tuple[TopicContents, ...] = ()  # of a bag
    columns: tuple[Column, ...] = ()  # of a table that are used
    unused: Mapping[str, str] = field(default_factory=dict)  # those that are not, and why
    # what tells the day of a table, see `Source`; None of what has stamps
    dated: str | None = None
    zoned: bool = True  # whether its clock is UTC or names its zone
    frames: int = 0  # of a CAN log or a bag, that were looked at for the profile; 0 without
    profile: str | None = None  # that fits the frames, None when none does, or without frames
    vehicles: tuple[str, ...] = ()  # whose profile that is
    # what the estimator can use, None when there is nothing of ours in it
    drive: DataCoverage | None = None
    dropped: Counter[str] | None = None  # what was not used of the drive, by reason
    notes: tuple[str, ...] = ()  # what could not be read or used, and why

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last time, of messages or else of readings; None when there is none."""
        flows = [topic.flow for topic in self.topics if topic.flow.count]
        if not flows and self.drive is not None:
            flows = [*self.drive.flows.values()]
        if not flows:
            return None
        return min(flow.first_ns for flow in flows), max(flow.last_ns for flow in flows)


def contents(
    path: Path, columns: Sequence[str] = (), bar: Bar = lambda _: nullcontext()
) -> Contents:
    """Look through a bag, a CAN log or a table.

    `columns` are those given of a table (see `column.columns_by_name`); `bar` takes the length of
    the drive, s, None while unknown, and gives what takes the seconds of it that are done.

    Raises:
        InputError: it is none of these, or nothing can be read.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if is_drive_table(path):
        return with_drive(Contents(path, "table"), None, columns, bar)
    # What reads buses takes half a second to import: who opens a table does not wait for it.
    from evpinn_ros.drives.bus_contents import bus_contents

    return bus_contents(path, bar)


def with_drive(found: Contents, profile: str | None, columns: Sequence[str], bar: Bar) -> Contents:
    """Add what the estimator can use."""
    try:
        source = _source(found, profile, columns)
        with bar(source.seconds) as progress:
            drive = data_coverage(reported(source.readings(), progress))
    except InputError as error:
        if found.kind != "bag":
            raise
        return replace(found, notes=(str(error),))
    return replace(
        found,
        columns=source.rules,
        unused=source.ignored,
        dated=source.dated,
        zoned=source.zoned,
        drive=drive,
        dropped=source.dropped,
        notes=(*source.notes, *filter(None, [source.problem])),
    )


def _source(found: Contents, profile: str | None, columns: Sequence[str]) -> Source:
    """The drive in a recording; topics of ours are preferred to the frames of a bag."""
    vehicle = load_vehicle(GENERIC)
    if found.kind == "bag":
        with suppress(InputError):
            return open_source(found.path, vehicle)
    return open_source(found.path, vehicle, profile, columns=columns)
