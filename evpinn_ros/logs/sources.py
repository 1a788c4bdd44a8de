"""Opens recorded drives: bags, CAN logs and tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from evpinn_ros.bags.names import is_bag
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.logs.formats import (
    CONVERTERS,
    TABLE_SUFFIXES,
    TEXT_SUFFIXES,
    is_drive_table,
    suffix_of,
)
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.source import Source

if TYPE_CHECKING:
    from evpinn_ros.logs.table_drive import TableDrive

NOMINAL_VOLTAGE = 350.0  # V, of an unknown car


def open_source(path: Path, vehicle: Vehicle, options: ReadOptions = READ_DEFAULTS) -> Source:
    """Open a recorded drive; InputError: unknown kind, no CAN profile, or no choice of a car."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if is_drive_table(path):
        return open_drive(path, vehicle.nominal_voltage, options)
    # Imported here: readers of bags and buses load slowly, and tables do not need them.
    if is_bag(path):
        from evpinn_ros.logs.bag_source import bag_of_topics

        if (bag := bag_of_topics(path, options)) is not None:
            return bag
    from evpinn_ros.logs.bus_sources import open_bus_source

    return open_bus_source(path, vehicle, options)


def open_drive(
    path: Path,
    nominal_voltage: float = NOMINAL_VOLTAGE,
    options: ReadOptions = READ_DEFAULTS,
) -> TableDrive:
    """Open a table of a drive; InputError if it is none.

    Power becomes current at `nominal_voltage`, V, in a table without voltage.
    """
    # Imported here: polars takes a quarter of a second to load.
    from evpinn_ros.logs.table_drive import TableDrive
    from evpinn_ros.logs.text_table import ConvertedTable, TextTable

    path = Path(path)
    suffix = suffix_of(path)
    if path.suffix.lower() == ".gz" and suffix not in TEXT_SUFFIXES:
        raise InputError(f"{path}: only {', '.join(TEXT_SUFFIXES)} are read as .gz; unpack it")
    if suffix not in TABLE_SUFFIXES:
        raise InputError(f"{path}: no table of a drive; supported are {', '.join(TABLE_SUFFIXES)}")
    converter = CONVERTERS.get(suffix)
    table = TextTable(path) if converter is None else ConvertedTable(path, converter)
    return TableDrive(table, path, nominal_voltage, options)
