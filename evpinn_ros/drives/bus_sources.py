"""Sources of a replay that come from a bus: bags of our topics or of raw frames, CAN logs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.bags.names import is_bag
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.log_names import LOG_SUFFIXES
from evpinn_ros.can.logs import LogFile
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.can_logs import BagFrames, CanLog, holds_frames
from evpinn_ros.drives.formats import suffix_of
from evpinn_ros.drives.sources import Source
from evpinn_ros.drives.terrain import Terrain
from evpinn_ros.signals.readings import Reading
from evpinn_ros.topics.readings import Rotation
from evpinn_ros.vehicle.files import Vehicle


class BagSource(Source):
    """A rosbag2 folder, a bare `.mcap` or `.db3`."""

    def __init__(
        self, path: Path, mounting: Rotation | None = None, terrain: Terrain | None = None
    ) -> None:
        """Open the bag; InputError when it is none or has none of our topics."""
        super().__init__(path)
        self._reader, self._terrain = BagReader(path), terrain
        self._readings = BagReadings(self._reader, mounting=mounting)
        self.dropped = self._readings.dropped

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
        """Topics that are nearly those that are missing."""
        return self._readings.notes

    def readings(self) -> Iterator[Reading]:
        """The readings in order of log time."""
        with self._reader:
            found = iter(self._readings)
            yield from found if self._terrain is None else self._terrain.on(found)


class CanLogSource(Source):
    """A CAN log, or the raw frames of a bag, decoded by a profile."""

    def __init__(self, log: CanLog, bridge: CanBridge) -> None:
        super().__init__(log.path)
        self._log, self._bridge = log, bridge

    @property
    def seconds(self) -> float | None:
        """Length of the log, s."""
        return self._log.seconds

    @property
    def problem(self) -> str | None:
        """Break of the log, or the point from where on it contradicts the profile."""
        if self._bridge.refusal:
            return f"{self.path}: {self._bridge.refusal}; --trust-profile overrules this"
        return self._log.problem

    def readings(self) -> Iterator[Reading]:
        """The readings frame by frame, up to where the log contradicts the profile.

        Raises:
            InputError: it does from the start, or no frame of the whole log gave a reading.
        """
        newest, decoded = 0, 0
        for frame in self._log.frames():
            newest = max(newest, frame.stamp_ns)
            found = self._bridge.decode(frame)
            decoded += len(found)
            yield from found
            if self._bridge.refusal:
                break
        found = self._bridge.finish()
        yield from found
        status = self._bridge.status(newest)
        self.dropped.update(status.dropped)
        self.dropped.update(self._log.skipped)
        if not decoded and not found:
            raise InputError(self.problem or f"{self.path}: {status.text}")


def open_bus_source(
    path: Path,
    vehicle: Vehicle,
    can_profile: str | None,
    *,
    trust_profile: bool,
    mounting: Rotation | None,
    terrain: Terrain | None,
) -> Source:
    """Open a bag or a CAN log; the arguments are those of `sources.open_source`.

    Raises:
        InputError: it is neither, or a CAN log without a profile.
    """
    log: CanLog
    if is_bag(path):
        # Recorded topics of ours; raw frames when asked by a profile, or if they are all there is.
        if can_profile is None or not holds_frames(path):
            try:
                return BagSource(path, mounting, terrain)
            except InputError:
                if not holds_frames(path):
                    raise
        log = BagFrames(path)
    elif suffix_of(path) in LOG_SUFFIXES:
        log = LogFile(path)
    else:
        known = ", ".join(LOG_SUFFIXES)
        raise InputError(f"{path}: neither a bag, a CAN log ({known}) nor a table")
    return CanLogSource(log, _bridge(path, vehicle, can_profile, trust_profile))


def _bridge(
    path: Path, vehicle: Vehicle, can_profile: str | None, trust_profile: bool
) -> CanBridge:
    name = can_profile or vehicle.can_profile
    if name is None:
        raise InputError(
            f"{path}: vehicle '{vehicle.key}' names no CAN profile; "
            "give the --vehicle of a car that does, or --can-profile"
        )
    profile = load_profile(name)
    guard = None if trust_profile else FitGuard(profile, bundled_profiles(), patient=True)
    return CanBridge(profile, guard=guard)
