"""Contents of a recording: `evpinn info`."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from evpinn_ros.bags.names import is_bag
from evpinn_ros.can.log_names import LOG_SUFFIXES
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.progress import reported
from evpinn_ros.core.signals.readings import MOST_STAMP
from evpinn_ros.core.vehicle.files import GENERIC, load_vehicle, vehicle_names
from evpinn_ros.logs.column import Column
from evpinn_ros.logs.data_coverage import DataCoverage, ReadingFlow, data_coverage
from evpinn_ros.logs.formats import is_drive_table, suffix_of, unknown_kind
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_source

Bar = Callable[[float | None], AbstractContextManager[Callable[[float], None] | None]]


@dataclass(frozen=True, slots=True)
class TopicContents:
    """A topic of a bag, with the log times of its messages, ns."""

    name: str
    type_name: str
    flow: ReadingFlow


@dataclass(frozen=True, slots=True)
class Contents:
    """Contents of a recording."""

    path: Path  # of the recording
    kind: str  # `bag`, `CAN log` or `table`
    topics: tuple[TopicContents, ...] = ()  # of a bag
    columns: tuple[Column, ...] = ()  # of a table that are used
    unused: Mapping[str, str] = field(default_factory=dict)  # reasons of unused columns
    # origin of a table's day, see `Source`; None for recordings with stamps
    dated: str | None = None
    zoned: bool = True  # True if its clock is UTC or names its zone
    frames: int = 0  # frames of a CAN log or a bag used to find the profile; 0 without
    profile: str | None = None  # given, or fitting the frames; None if none does
    vehicles: tuple[str, ...] = ()  # vehicles with this profile
    # data that the estimator can use; None if there are none
    drive: DataCoverage | None = None
    dropped: Counter[str] | None = None  # unused values of the drive, by reason
    notes: tuple[str, ...] = ()  # unreadable or unusable parts, with reasons

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last time of messages, or else of readings, ns; None if there are none."""
        flows = [topic.flow for topic in self.topics if topic.flow.count]
        if not flows and self.drive is not None:
            flows = [*self.drive.flows.values()]
        if not flows:
            return None
        return min(flow.first_ns for flow in flows), max(flow.last_ns for flow in flows)


def contents(
    path: Path, options: ReadOptions = READ_DEFAULTS, bar: Bar = lambda _: nullcontext()
) -> Contents:
    """Examine a bag, a CAN log or a table, or raise InputError; `bar` gets its length, s."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if is_drive_table(path):
        return _with_drive(Contents(path, "table"), options, bar)
    # Imported here: readers of bags and buses load slowly, and tables do not need them.
    from evpinn_ros.logs.bag_source import holds_frames

    recording = Contents(path, "CAN log")
    if is_bag(path):
        recording = Contents(path, "bag", topics=_topics(path))
        if not holds_frames(path, options.car):
            return _with_drive(recording, options, bar)
    elif suffix_of(path) not in LOG_SUFFIXES:
        raise unknown_kind(path)
    from evpinn_ros.logs import bus_sources

    report = bus_sources.inspected(bus_sources.open_can_log(path, options.car))
    fitting = report.best.fit.profile if report.best is not None else None
    profile = options.can_profile or fitting
    cars = map(load_vehicle, vehicle_names())
    names = tuple(car.key for car in cars if profile and car.can_profile == profile)
    recording = replace(recording, frames=report.frames, profile=profile, vehicles=names)
    if profile is None and recording.kind != "bag":
        return replace(
            recording, notes=(f"no known CAN profile fits: evpinn can inspect {path} says why",)
        )
    return _with_drive(recording, options, bar)


def _topics(path: Path) -> tuple[TopicContents, ...]:
    from evpinn_ros.bags.reader import BagReader

    with BagReader(path) as reader:
        times = {name: array("q") for name in reader.topics}
        for name, log_time_ns in reader.log_times():
            times[name].append(min(log_time_ns, MOST_STAMP))  # a broken one may exceed 64 bits
        return tuple(
            TopicContents(name, info.type_name, ReadingFlow.of(np.asarray(times[name], np.int64)))
            for name, info in reader.topics.items()
        )


def _with_drive(recording: Contents, options: ReadOptions, bar: Bar) -> Contents:
    try:
        source = _source(recording, options)
        with bar(source.seconds) as progress:
            drive = data_coverage(reported(source.blocks(), progress, _begin_ns))
    except InputError as error:
        if recording.kind != "bag":
            raise
        return replace(recording, notes=(str(error),))
    return replace(
        recording,
        columns=source.rules,
        unused=source.ignored,
        dated=source.dated,
        zoned=source.zoned,
        drive=drive,
        dropped=source.dropped,
        notes=(*source.notes, *filter(None, [source.problem])),
    )


def _begin_ns(block: Block) -> int:
    return int(block.stamps()[0])


def _source(recording: Contents, options: ReadOptions) -> Source:
    """The drive in a recording; a bag with both is read by our topics, not its frames."""
    vehicle = load_vehicle(GENERIC)
    if recording.kind == "bag":
        from evpinn_ros.logs.bag_source import bag_of_topics

        if (bag := bag_of_topics(recording.path, options)) is not None:
            return bag
    return open_source(recording.path, vehicle, replace(options, can_profile=recording.profile))
