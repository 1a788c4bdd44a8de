"""Recorded buses: CAN logs, and bags of raw frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeAlias

from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.bags.names import is_bag
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.frame import CanFrame, FirstBus
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.inspection import BusReport, Inspection
from evpinn_ros.can.log_names import LOG_SUFFIXES
from evpinn_ros.can.logs import LogFile
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import Reading
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.logs.bag_source import frame_topics
from evpinn_ros.logs.battery_watch import BatteryWatch
from evpinn_ros.logs.formats import suffix_of, unknown_kind
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.topics import FRAME_TYPE

BITRATE = 500_000  # bit/s; irrelevant here, as the load of the bus is not used
INSPECTED = 200_000  # frames used to find the profile, a minute of a full bus


class BagFrames:
    """Frames of a bag's `can_msgs/Frame` topics, by their headers' stamps or else the log time."""

    def __init__(self, path: Path, car: str | None = None) -> None:
        """Find the topics of this car or of all; InputError if there is no bag or no frame."""
        self.path = path  # of the file or folder
        self.count = 0  # frames read so far
        self.skipped: Counter[str] = Counter()  # remote, error and impossible frames, by kind
        self._reader = BagReader(path)
        self._topics = frame_topics(self._reader, car)
        if not self._topics:
            of_car = f" of the car {car!r}" if car else ""
            raise InputError(f"{path}: no CAN frames ({FRAME_TYPE}){of_car} in this bag")

    @property
    def seconds(self) -> float | None:
        """Length that the bag's metadata states, s."""
        return stated_seconds(self.path)

    @property
    def problem(self) -> str | None:
        """Losses of the bag, in one line."""
        return self._reader.problem

    @property
    def notes(self) -> tuple[str, ...]:
        """A line for each file beside the bag that is not read; no message is lost by it."""
        return self._reader.notes

    def frames(self) -> Iterator[CanFrame]:
        """Every data frame in order of log time; InputError when there is none."""
        first_bus = FirstBus()
        with self._reader:
            for record in self._reader.records(self._topics):
                message = record.message
                if message.is_error or message.is_rtr:
                    self.skipped["error_frame" if message.is_error else "remote_frame"] += 1
                elif not first_bus.takes(
                    (message.id, message.is_extended), record.topic, bytes(message.data)
                ):
                    self.skipped["other_bus"] += 1
                    if first_bus.cars:
                        raise InputError(f"{self.path}: {first_bus.cars}")
                else:
                    self.count += 1
                    yield CanFrame.of_ros(message, record.log_time_ns)
        self.skipped.update(self._reader.dropped)
        if self.count == 0:
            raise InputError(self.problem or f"{self.path}: no CAN data frame in it")


CanLog: TypeAlias = LogFile | BagFrames
"""A recorded bus; its `frames()` can be read once."""


def open_can_log(path: Path, car: str | None = None) -> CanLog:
    """Open a CAN log, or a bag with frames; only one car or bus if `car` is given.

    InputError names the file and the reason.
    """
    return BagFrames(path, car) if is_bag(path) else LogFile(path, car)


def inspected(log: CanLog) -> BusReport:
    """Report on the first frames of a log, with the bundled profile that fits them, if any."""
    inspection = Inspection(bundled_profiles(), BITRATE)
    for frame in islice(log.frames(), INSPECTED):
        inspection.add_frame(frame)
    return inspection.report()


class CanLogSource(Source):
    """A CAN log, or the raw frames of a bag, decoded by a profile."""

    def __init__(
        self, open_log: Callable[[], CanLog], make_bridge: Callable[[], CanBridge]
    ) -> None:
        self._open_log, self._make_bridge = open_log, make_bridge
        self._log, self._bridge = open_log(), make_bridge()
        super().__init__(self._log.path)
        self._watch = BatteryWatch(self.dropped)

    @property
    def seconds(self) -> float | None:
        """Length of the log, s."""
        return self._log.seconds

    @property
    def problem(self) -> str | None:
        """Damage of the log, or how it contradicts the profile and what to do."""
        if self._bridge.refusal:
            better = self._bridge.better_profile
            other = f"use --can-profile {better}, or " if better else ""
            return f"{self.path}: {self._bridge.refusal}; {other}--trust-profile to keep this one"
        return self._log.problem

    @property
    def notes(self) -> tuple[str, ...]:
        """Unread files beside the log, and implausible battery values."""
        return *self._log.notes, *self._watch.notes

    @property
    def doubts(self) -> tuple[str, ...]:
        """Implausible battery values that make totals of energy uncertain."""
        return self._watch.doubts

    def read(self) -> Iterator[Block]:
        """Readings until the log contradicts the profile; InputError if there are none."""
        self._log, self._bridge = self._open_log(), self._make_bridge()
        self._watch = BatteryWatch(self.dropped)
        self.dropped.clear()
        yield from self._watch.on(self._decoded())

    def _decoded(self) -> Iterator[Reading]:
        newest, decoded = 0, 0
        for frame in self._log.frames():
            newest = max(newest, frame.stamp_ns)
            readings = self._bridge.decode(frame)
            decoded += len(readings)
            yield from readings
            if self._bridge.refusal:
                break
        readings = self._bridge.finish()
        yield from readings
        status = self._bridge.status(newest)
        self.dropped.update(status.dropped)
        self.dropped.update(self._log.skipped)
        if not decoded and not readings:
            raise InputError(self.problem or f"{self.path}: {status.text}{self._fitting()}")

    def _fitting(self) -> str:
        """Sentence on the profile that fits the first frames; empty if none does."""
        best = inspected(self._open_log()).best
        if best is None:
            return f"; evpinn can inspect {self.path} shows the traffic"
        return f"; --can-profile {best.fit.profile} fits"


def open_bus_source(path: Path, vehicle: Vehicle, options: ReadOptions) -> Source:
    """Open a CAN log, or a bag's raw frames; InputError if neither, or without a profile."""
    if not is_bag(path) and suffix_of(path) not in LOG_SUFFIXES:
        raise unknown_kind(path)
    name = options.can_profile or vehicle.can_profile
    if name is None:
        raise InputError(
            f"{path}: vehicle '{vehicle.key}' names no CAN profile; "
            "use --can-profile, or --vehicle of a car that has one"
        )
    profile = load_profile(name)

    def bridge() -> CanBridge:
        trusted = options.trust_profile
        guard = None if trusted else FitGuard(profile, bundled_profiles(), patient=True)
        return CanBridge(profile, guard=guard)

    return CanLogSource(partial(open_can_log, path, options.car), bridge)
