"""Sources of a replay: bags, CAN logs and tables of drives, each as one stream of readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from evpinn_ros.bags.can_frames import BagFrames, CanLog, holds_frames, is_bag
from evpinn_ros.bags.convert import BagReadings
from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.logs import LOG_SUFFIXES, LogFile
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.column import Column
from evpinn_ros.drives.formats import (
    CONVERTERS,
    TABLE_SUFFIXES,
    TEXT_SUFFIXES,
    is_drive_table,
    suffix_of,
)
from evpinn_ros.drives.text_table import ConvertedTable, TextTable
from evpinn_ros.signals.readings import Reading
from evpinn_ros.topics.readings import Rotation
from evpinn_ros.vehicle.files import Vehicle

if TYPE_CHECKING:
    from evpinn_ros.drives.table_drive import TableDrive

NOMINAL_VOLTAGE = 350.0  # V, of a car that is not known


class Source(ABC):
    """A recorded drive.

    Attributes:
        path: where it lies.
        dropped: what was not used, by reason; complete once the readings are exhausted.
        rules: columns of a table that are used, in the order of the file.
        ignored: names of those that are not, each with the reason.
        dated: what tells the day of a table: `log`, `name` of the file, "" for nothing; None of
            what has stamps.
        zoned: the clock is UTC or names its zone.
    """

    rules: tuple[Column, ...] = ()
    ignored: Mapping[str, str] = MappingProxyType({})
    dated: str | None = None
    zoned = True

    def __init__(self, path: Path) -> None:
        """Nothing was dropped yet."""
        self.path = path
        self.dropped: Counter[str] = Counter()

    @property
    @abstractmethod
    def seconds(self) -> float | None:
        """Length of the drive, s; None where only reading it tells."""

    @property
    @abstractmethod
    def problem(self) -> str | None:
        """Unreadable part, in one line; None while all is well, final when exhausted."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for a person on how it was read; complete once exhausted."""
        return ()

    @abstractmethod
    def readings(self) -> Iterator[Reading]:
        """The readings in recorded order, up to where the drive can be read.

        Raises:
            InputError: there is none in it.
        """


class BagSource(Source):
    """A rosbag2 folder, a bare `.mcap` or `.db3`."""

    def __init__(self, path: Path, mounting: Rotation | None = None) -> None:
        """Open the bag; InputError when it is none or has none of our topics."""
        super().__init__(path)
        self._reader = BagReader(path)
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
            yield from self._readings


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


def open_source(
    path: Path,
    vehicle: Vehicle,
    can_profile: str | None = None,
    *,
    trust_profile: bool = False,
    columns: Sequence[str] = (),
    mounting: Rotation | None = None,
    battery: bool = True,
) -> Source:
    """Open a recorded drive of any kind.

    Args:
        path: of the drive.
        vehicle: whose drive it is.
        can_profile: of a CAN log, the vehicle's when None.
        trust_profile: read a CAN log also where it contradicts the profile.
        columns: of a table that are given, see `evpinn_ros.drives.column.columns_by_name`.
        mounting: of the IMU in a bag, see `grade_reading`.
        battery: False for a table that needs no columns of a battery.

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
        return open_drive(path, vehicle.nominal_voltage, columns, battery=battery)
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


def open_drive(
    path: Path,
    nominal_voltage: float = NOMINAL_VOLTAGE,
    columns: Sequence[str] = (),
    *,
    battery: bool = True,
) -> TableDrive:
    """Open a table of a drive: CSV and the like, a spreadsheet, Parquet, signals of an .mf4.

    Power alone becomes current at `nominal_voltage`, V; `columns` are those given, see
    `column.columns_by_name`; without `battery` none of its columns is needed.

    Raises:
        InputError: it cannot be read, or holds no drive.
    """
    # polars takes a quarter of a second: whoever opens no table does not wait for it.
    from evpinn_ros.drives.table_drive import TableDrive

    path = Path(path)
    suffix = suffix_of(path)
    if path.suffix.lower() == ".gz" and suffix not in TEXT_SUFFIXES:
        raise InputError(f"{path}: unpack it first")
    if suffix not in TABLE_SUFFIXES:
        raise InputError(f"{path}: no table of a drive; known are {', '.join(TABLE_SUFFIXES)}")
    apart = CONVERTERS.get(suffix)
    table = TextTable(path) if apart is None else ConvertedTable(path, apart)
    return TableDrive(table, path, nominal_voltage, columns, battery=battery)
