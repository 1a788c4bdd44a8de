"""Sources of a replay: bags, CAN logs and tables of drives, each as one stream of readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

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
from evpinn_ros.vehicle.files import Vehicle

if TYPE_CHECKING:
    from evpinn_ros.drives.table_drive import TableDrive
    from evpinn_ros.drives.terrain import Terrain
    from evpinn_ros.topics.readings import Rotation

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


def open_source(
    path: Path,
    vehicle: Vehicle,
    can_profile: str | None = None,
    *,
    trust_profile: bool = False,
    columns: Sequence[str] = (),
    mounting: Rotation | None = None,
    battery: bool = True,
    terrain: Terrain | None = None,
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
        terrain: heights to take in place of those recorded, where the place is known.

    Raises:
        InputError: no such file, no kind known, or a CAN log without a profile.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if is_drive_table(path):
        voltage = vehicle.nominal_voltage
        return open_drive(path, voltage, columns, battery=battery, terrain=terrain)
    # What reads buses takes half a second to import: who opens a table does not wait for it.
    from evpinn_ros.drives.bus_sources import open_bus_source

    return open_bus_source(
        path,
        vehicle,
        can_profile,
        trust_profile=trust_profile,
        mounting=mounting,
        terrain=terrain,
    )


def open_drive(
    path: Path,
    nominal_voltage: float = NOMINAL_VOLTAGE,
    columns: Sequence[str] = (),
    *,
    battery: bool = True,
    terrain: Terrain | None = None,
) -> TableDrive:
    """Open a table of a drive: CSV and the like, a spreadsheet, Parquet, signals of an .mf4.

    Power alone becomes current at `nominal_voltage`, V; `columns` are those given, see
    `column.columns_by_name`; without `battery` none of its columns is needed; `terrain` has
    heights of its places.

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
    return TableDrive(table, path, nominal_voltage, columns, battery=battery, terrain=terrain)
