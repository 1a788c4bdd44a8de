"""Contents of what was recorded from a bus: bags and CAN logs."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

from evpinn_ros.bags.names import is_bag
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.inspection import Inspection
from evpinn_ros.can.profile import bundled_profiles
from evpinn_ros.drives.can_logs import BagFrames, CanLog, holds_frames, open_can_log
from evpinn_ros.drives.contents import Bar, Contents, TopicContents, with_drive
from evpinn_ros.drives.data_coverage import ReadingFlow
from evpinn_ros.vehicle.files import load_vehicle, vehicle_names

BITRATE = 500_000  # bit/s; the load of the bus is not known here
INSPECTED = 200_000  # frames that tell the profile, a minute of a full bus


def bus_contents(path: Path, bar: Bar) -> Contents:
    """Look through a bag or a CAN log, see `contents.contents`.

    Raises:
        InputError: it is neither, or nothing can be read.
    """
    if not is_bag(path):
        return _with_frames(Contents(path, "CAN log"), open_can_log(path), bar)
    found = Contents(path, "bag", topics=_topics(path))
    if holds_frames(path):
        return _with_frames(found, BagFrames(path), bar)
    return with_drive(found, None, (), bar)


def _topics(path: Path) -> tuple[TopicContents, ...]:
    with BagReader(path) as reader:
        flows = {name: ReadingFlow() for name in reader.topics}
        for name, log_time_ns in reader.log_times():
            flows[name].add(log_time_ns)
        return tuple(
            TopicContents(name, info.type_name, flows[name])
            for name, info in reader.topics.items()
        )


def _with_frames(found: Contents, log: CanLog, bar: Bar) -> Contents:
    """Add the profile that fits, and what the drive is by it."""
    inspection = Inspection(bundled_profiles(), BITRATE)
    for frame in islice(log.frames(), INSPECTED):
        inspection.add_frame(frame)
    report = inspection.report()
    profile = report.best.fit.profile if report.best is not None else None
    names = tuple(
        car.key
        for car in map(load_vehicle, vehicle_names())
        if profile and car.can_profile == profile
    )
    found = replace(found, frames=report.frames, profile=profile, vehicles=names)
    if profile is None and found.kind != "bag":
        return replace(found, notes=("no known CAN profile fits: evpinn can inspect says why",))
    return with_drive(found, profile, (), bar)
