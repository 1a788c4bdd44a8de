"""Sources of a replay: bags, CAN logs and tables of drives, each as one stream of readings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol
import zlib

from evpinn_ros.bags.can_frames import BagFrames, CanLog, holds_frames, is_bag
from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.gvret import HEADER as GVRET_HEADER
from evpinn_ros.can.logs import LOG_SUFFIXES, LogFile
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_file import open_file
from evpinn_ros.common.unpacking import open_gzipped
from evpinn_ros.drives import open_drive
from evpinn_ros.drives.formats import MEASUREMENT_SUFFIX, is_table, suffix_of
from evpinn_ros.drives.measurement import holds_signals
from evpinn_ros.signals.readings import Reading
from evpinn_ros.topics.readings import Rotation
from evpinn_ros.vehicle.files import Vehicle

FRAME_COLUMN = "arbitration_id"  # tells a CAN log's CSV from a drive's


class Source(Protocol):
    """A recorded drive."""

    path: Path  # where it lies
    dropped: Counter[str]  # what was not used, by reason; complete once the readings are exhausted

    @property
    def seconds(self) -> float | None:
        """Length of the drive, s; None where only reading it tells."""

    @property
    def problem(self) -> str | None:
        """Unreadable part, in one line; None while all is well, final when exhausted."""

    def readings(self) -> Iterator[Reading]:
        """The readings in recorded order."""


class BagSource:
    """A rosbag2 folder, a bare `.mcap` or `.db3`."""

    def __init__(self, path: Path, mounting: Rotation | None = None) -> None:
        """Open the bag; InputError when it is none or has none of our topics."""
        self.path = path
        self._reader = BagReader(path)
        self._readings = BagReadings(self._reader, mounting=mounting)
        self.dropped = self._readings.dropped
        self.notes = self._readings.notes

    @property
    def seconds(self) -> float | None:
        """Length that the bag's metadata states, s."""
        return stated_seconds(self.path)

    @property
    def problem(self) -> str | None:
        """Losses of the bag, in one line."""
        return self._reader.problem

    def readings(self) -> Iterator[Reading]:
        """The readings in order of log time."""
        with self._reader:
            yield from self._readings


class CanLogSource:
    """A CAN log, or the raw frames of a bag, decoded by a profile."""

    def __init__(self, log: CanLog, bridge: CanBridge) -> None:
        self.path = log.path
        self.dropped: Counter[str] = Counter()
        self._log, self._bridge = log, bridge
        self._decoded = 0

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
        newest = 0
        for frame in self._log.frames():
            newest = max(newest, frame.stamp_ns)
            for reading in self._bridge.decode(frame):
                self._decoded += 1
                yield reading
            if self._bridge.refusal:
                break
        for reading in self._bridge.finish():
            self._decoded += 1
            yield reading
        status = self._bridge.status(newest)
        self.dropped.update(status.dropped)
        self.dropped.update(self._log.skipped)
        if self._decoded == 0:
            raise InputError(self.problem or f"{self.path}: {status.text}")


def open_source(
    path: Path,
    vehicle: Vehicle,
    can_profile: str | None = None,
    *,
    trust_profile: bool = False,
    columns: Sequence[str] = (),
    mounting: Rotation | None = None,
) -> Source:
    """Open a recorded drive of any kind.

    Args:
        path: of the drive.
        vehicle: whose drive it is.
        can_profile: of a CAN log, the vehicle's when None.
        trust_profile: read a CAN log also where it contradicts the profile.
        columns: of a CSV file that are given, see `evpinn_ros.drives.column.columns_by_name`.
        mounting: of the IMU in a bag, see `grade_reading`.

    Raises:
        InputError: no such file, no kind known, or a CAN log without a profile.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    log: CanLog
    if is_bag(path):
        # Recorded topics of ours; raw frames when asked by a profile, or if they are all there is.
        if can_profile is None or not holds_frames(path):
            try:
                return BagSource(path, mounting)
            except InputError:
                if not holds_frames(path):
                    raise
        log = BagFrames(path)
    elif is_drive_table(path):
        return open_drive(path, vehicle.nominal_voltage, columns)
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


def is_drive_table(path: Path) -> bool:
    """True if a path is that of a table which is not python-can's log of a bus.

    Raises:
        InputError: it cannot be read.
    """
    if path.is_dir() or not is_table(path):
        return False
    if suffix_of(path) == MEASUREMENT_SUFFIX:
        return holds_signals(path)
    if suffix_of(path) != ".csv":
        return True
    try:
        with open_gzipped(path) if path.suffix == ".gz" else open_file(path) as file:
            header = file.readline(10_000)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: {error}") from error
    return FRAME_COLUMN.encode() not in header and GVRET_HEADER.encode() not in header
