"""Open a drive of any format as a source of readings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.formats import (
    MEASUREMENT_SUFFIX,
    PARQUET_SUFFIXES,
    SHEET_SUFFIXES,
    TABLE_SUFFIXES,
    TEXT_SUFFIXES,
    suffix_of,
)
from evpinn_ros.signals.readings import Reading

if TYPE_CHECKING:
    from evpinn_ros.drives.survey import Table
    from evpinn_ros.drives.table_drive import TableDrive

NOMINAL_VOLTAGE = 350.0  # V, of a car that is not known


class DriveSource:
    """A table of a drive, as a source.

    Attributes:
        path: of the file.
        drive: what was found in it.
        dropped: what was not used, by reason; complete once the readings are exhausted.
    """

    def __init__(
        self, path: Path, drive: TableDrive, folder: TemporaryDirectory[str] | None = None
    ) -> None:
        """Wrap what was opened; the folder of what was unpacked is kept as long."""
        self.path, self.drive = path, drive
        self._folder = folder
        self.dropped: Counter[str] = drive.dropped
        self._problem: str | None = None

    @property
    def seconds(self) -> float | None:
        """Length of the drive, s."""
        return self.drive.seconds

    @property
    def problem(self) -> str | None:
        """Break in the file; rows that are wrong in themselves are dropped and counted."""
        return self._problem

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for a person on how it was read; complete once exhausted."""
        drive, notes = self.drive, []
        if drive.no_speed:
            notes.append("speed is 0 throughout while the odometer goes on, so it is not used")
        if drive.at_nominal_voltage:
            notes.append(
                f"{drive.at_nominal_voltage} battery readings hold power alone; their voltage is "
                f"the nominal {drive.nominal_voltage:g} V"
            )
        if drive.first_bad:
            notes.append(drive.first_bad)
        return tuple(notes)

    def readings(self) -> Iterator[Reading]:
        """The readings in order of time, up to where the file can be read.

        Raises:
            InputError: there is none in it.
        """
        begun = False
        try:
            for reading in self.drive.readings():
                begun = True
                yield reading
        except InputError as error:
            if not begun:
                raise
            self._problem = str(error)
        if not begun:
            reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(self.dropped.items()))
            nothing = f"{self.path}: no reading in it; dropped: {reasons or 'nothing'}"
            raise InputError(self.drive.first_bad or nothing)


def open_drive(
    path: Path, nominal_voltage: float = NOMINAL_VOLTAGE, columns: Sequence[str] = ()
) -> DriveSource:
    """Open a table of a drive: CSV and the like, a spreadsheet, Parquet, signals of an .mf4.

    Power alone becomes current at `nominal_voltage`, V; `columns` are those given, see
    `column.columns_by_name`.

    Raises:
        InputError: it cannot be read, or holds no drive.
    """
    # polars takes a quarter of a second: whoever opens no table does not wait for it.
    from evpinn_ros.drives.table_drive import TableDrive

    path = Path(path)
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: a folder, a pipe or a device, no file")
    table, folder = _table(path)
    try:
        return DriveSource(path, TableDrive(table, path, nominal_voltage, columns), folder)
    except InputError:
        if folder is not None:
            folder.cleanup()
        raise


def _table(path: Path) -> tuple[Table, TemporaryDirectory[str] | None]:
    """The rows of a file, and the folder that they need."""
    from evpinn_ros.drives.sheets import ParquetTable, SheetTable
    from evpinn_ros.drives.text_table import TextTable

    suffix = suffix_of(path)
    if suffix in TEXT_SUFFIXES:
        return TextTable(path), None
    if path.suffix.lower() == ".gz":
        raise InputError(f"{path}: unpack it first")
    if suffix in SHEET_SUFFIXES:
        return SheetTable(path), None
    if suffix in PARQUET_SUFFIXES:
        return ParquetTable(path), None
    if suffix == MEASUREMENT_SUFFIX:
        from evpinn_ros.drives.measurement import signals_of

        folder = TemporaryDirectory()
        if signals := signals_of(path, Path(folder.name)):
            return TextTable(signals), folder
        folder.cleanup()
        raise InputError(f"{path}: no signal of a drive in it")
    raise InputError(f"{path}: no table of a drive; known are {', '.join(TABLE_SUFFIXES)}")
