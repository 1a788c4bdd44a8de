"""Open a drive of any format as a source of readings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from evpinn_ros.drives.formats import is_table
from evpinn_ros.errors import InputError
from evpinn_ros.signals.readings import Reading

if TYPE_CHECKING:
    from evpinn_ros.drives.table_drive import TableDrive

NOMINAL_VOLTAGE = 350.0  # V, of a car that is not known


class DriveSource:
    """A table of a drive, as a source.

    Attributes:
        path: of the file.
        drive: what was found in it.
        dropped: what was not used, by reason; complete once the readings are exhausted.
    """

    def __init__(self, path: Path, drive: TableDrive) -> None:
        """Wrap what was opened."""
        self.path, self.drive = path, drive
        self.dropped: Counter[str] = drive.dropped
        self._problem: str | None = None

    @property
    def problem(self) -> str | None:
        """Where the file breaks off; rows that are wrong in themselves are dropped and counted."""
        return self._problem

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
            raise InputError(self.drive.first_bad or f"{self.path}: {self._nothing()}")

    def _nothing(self) -> str:
        reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(self.dropped.items()))
        return f"no reading in it; dropped: {reasons or 'nothing'}"


def open_drive(
    path: Path, nominal_voltage: float = NOMINAL_VOLTAGE, columns: Sequence[str] = ()
) -> DriveSource:
    """Open a table of a drive: CSV and the like, a spreadsheet, Parquet.

    Args:
        path: of the file.
        nominal_voltage: V; power alone becomes current at it.
        columns: that are told, see `evpinn_ros.drives.column.columns_by_name`.

    Raises:
        InputError: it cannot be read, or holds no drive.
    """
    # polars takes a quarter of a second: whoever opens no table does not wait for it.
    from evpinn_ros.drives.table_drive import TableDrive
    from evpinn_ros.drives.text_table import TextTable

    path = Path(path)
    if not is_table(path):
        raise InputError(f"{path}: no table of a drive")
    return DriveSource(path, TableDrive(TextTable(path), path, nominal_voltage, columns))
