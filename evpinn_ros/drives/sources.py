"""Opens recorded drives: bags, CAN logs and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.formats import (
    CONVERTERS,
    TABLE_SUFFIXES,
    TEXT_SUFFIXES,
    is_drive_table,
    suffix_of,
)
from evpinn_ros.drives.source import Source
from evpinn_ros.drives.text_table import ConvertedTable, TextTable
from evpinn_ros.vehicle.files import Vehicle

if TYPE_CHECKING:
    from evpinn_ros.drives.table_drive import TableDrive
    from evpinn_ros.drives.terrain import Terrain
    from evpinn_ros.topics.readings import Rotation

NOMINAL_VOLTAGE = 350.0  # V, of a car that is not known


def open_source(
    path: Path,
    vehicle: Vehicle,
    can_profile: str | None = None,
    *,
    trust_profile: bool = False,
    columns: Sequence[str] = (),
    car: str | None = None,
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
        car: the one to read, where a table or a bag holds several: what the table's column of cars
            has, or the namespace of its topics.
        mounting: of the IMU in a bag, see `grade_reading`.
        battery: False for a table that needs no columns of a battery.
        terrain: heights to take in place of those recorded, where the place is known.

    Raises:
        InputError: no such file, no kind known, a CAN log without a profile, or several cars of
            which none is chosen.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if is_drive_table(path):
        voltage = vehicle.nominal_voltage
        return open_drive(path, voltage, columns, car=car, battery=battery, terrain=terrain)
    # What reads buses takes half a second to import: who opens a table does not wait for it.
    from evpinn_ros.drives.bus_sources import open_bus_source

    return open_bus_source(
        path,
        vehicle,
        can_profile,
        trust_profile=trust_profile,
        car=car,
        mounting=mounting,
        terrain=terrain,
    )


def open_drive(
    path: Path,
    nominal_voltage: float = NOMINAL_VOLTAGE,
    columns: Sequence[str] = (),
    *,
    car: str | None = None,
    battery: bool = True,
    terrain: Terrain | None = None,
) -> TableDrive:
    """Open a table of a drive: CSV and the like, a spreadsheet, Parquet, signals of an .mf4.

    Power alone becomes current at `nominal_voltage`, V; `columns` are those given, see
    `column.columns_by_name`; `car` is the one to read, of several; without
    `battery` none of its columns is needed; `terrain` has heights of its places.

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
    return TableDrive(
        table, path, nominal_voltage, columns, car=car, battery=battery, terrain=terrain
    )
