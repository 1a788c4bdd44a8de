"""A drive in a CSV file: the columns that `evpinn convert` takes, as readings.

`t_s` and `speed_mps`, then `voltage_v` and `current_a` or `power_w`, and optionally `elevation_m`,
`ambient_c`, `heating_w`, `aircon_w`, `soc_pct`, the state of charge, and `motor_torque_nm` with
`motor_speed_rad_s`. Here current and power are positive while the battery discharges, torque while
it drives the car forward. Columns of other names are guessed
(`evpinn_ros.bags.csv_columns`) or ignored.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
import csv
import gzip
import io
from itertools import chain, islice
import math
from pathlib import Path
from typing import IO
import zlib

from evpinn_ros.bags.csv_columns import QUANTITIES, columns_of
from evpinn_ros.errors import InputError
from evpinn_ros.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.text_lines import bounded_lines

LOOKED_AT = 20_000  # rows that tell units and signs, half an hour at 10 Hz
LONGEST_HEADER = 100_000  # characters
LONGEST_LIST = 200  # characters of column names in a message

# Where a drive whose time starts near zero is placed, 2020-01-01T00:00:00Z: header stamps must
# not be zero, and the same file must give the same bag.
DRIVE_START_NS = 1_577_836_800 * NANOSECONDS
LAST_TIME_S = 2.0**31  # the end of ROS time, in 2038
RELATIVE_BELOW_S = 1e8  # a first `t_s` below this (3 years) counts from the start of the drive

READ_ERRORS = (OSError, EOFError, zlib.error, ValueError, csv.Error)  # ValueError: no text


class CsvDrive:
    """A CSV file of a drive, plain or `.gz`.

    Attributes:
        columns: of the file that are used.
        rules: how each of them is read, in their order.
        ignored: columns of the file that are not.
        dropped: rows and cells that `readings` left out, by reason; complete at its end.
        at_nominal_voltage: battery readings made from power alone; likewise.
    """

    def __init__(
        self, path: Path | str, nominal_voltage: float, chosen: Sequence[str] = ()
    ) -> None:
        """Read the header, and of a file with other names than ours the first rows.

        Args:
            path: of the file.
            nominal_voltage: V, taken where a row has power alone.
            chosen: columns that are told, see `columns_of`.

        Raises:
            InputError: not there, empty, not text, columns are missing, or a choice is wrong.
        """
        self.path = Path(path)
        self.dropped: Counter[str] = Counter()
        self.at_nominal_voltage = 0
        self._nominal_voltage = nominal_voltage
        rows = self._rows()
        self._header = [name.strip() for name in next(rows, [])]
        if not self._header:
            raise InputError(f"{self.path}: the file is empty")
        self.rules = columns_of(self._header, self._first(rows), chosen)
        self._rules = {rule.name: rule for rule in self.rules}
        self.columns = tuple(rule.name for rule in self.rules)
        self.ignored = tuple(name for name in self._header if name not in self._rules)
        self._check_columns()

    def readings(self) -> Iterator[Reading]:
        """The readings row by row, in time order; an empty cell makes none.

        Raises:
            InputError: the file can not be read to its end.
        """
        self.dropped.clear()
        self.at_nominal_voltage = 0
        offset_ns: int | None = None
        before_ns = -math.inf
        rows = self._rows()
        next(rows)  # the header
        for row in rows:
            if len(row) != len(self._header):
                self.dropped["wrong_number_of_cells"] += 1
                continue
            cells = self._numbers(row)
            if "t_s" not in cells:
                self.dropped["no_time"] += 1
                continue
            if abs(cells["t_s"]) >= LAST_TIME_S:
                self.dropped["time_out_of_range"] += 1
                continue
            if offset_ns is None:
                offset_ns = DRIVE_START_NS if cells["t_s"] < RELATIVE_BELOW_S else 0
            stamp_ns = offset_ns + _nanoseconds(cells["t_s"])
            if stamp_ns <= before_ns:
                self.dropped["time_not_increasing"] += 1
                continue
            before_ns = stamp_ns
            yield from self._readings_of(cells, stamp_ns)

    def _readings_of(self, cells: dict[str, float], stamp_ns: int) -> Iterator[Reading]:
        if "speed_mps" in cells:
            yield SpeedReading(stamp_ns, cells["speed_mps"])
        if battery := self._battery(cells, stamp_ns):
            yield battery
        if "elevation_m" in cells:
            yield AltitudeReading(stamp_ns, cells["elevation_m"])
        if "ambient_c" in cells:
            yield TemperatureReading(stamp_ns, cells["ambient_c"])
        if "heating_w" in cells or "aircon_w" in cells:
            yield AuxiliaryReading(
                stamp_ns, cells.get("heating_w", 0.0), cells.get("aircon_w", 0.0)
            )

        if "motor_torque_nm" in cells:
            speed = cells.get("motor_speed_rad_s", math.nan)
            yield MotorReading(stamp_ns, cells["motor_torque_nm"], speed)

    def _battery(self, cells: dict[str, float], stamp_ns: int) -> BatteryReading | None:
        """Voltage and current as measured; where one is missing, the current from power."""
        voltage = cells.get("voltage_v", self._nominal_voltage)
        if voltage <= 0:
            self.dropped["voltage_not_positive"] += 1
            return None
        charge = self._charge(cells)
        if "voltage_v" in cells and "current_a" in cells:
            return BatteryReading(stamp_ns, voltage, -cells["current_a"], charge)
        if "power_w" in cells:
            self.at_nominal_voltage += "voltage_v" not in cells
            return BatteryReading(stamp_ns, voltage, -cells["power_w"] / voltage, charge)
        if "voltage_v" in cells or "current_a" in cells:
            self.dropped["voltage_or_current_alone"] += 1
        return None

    def _charge(self, cells: dict[str, float]) -> float:
        """State of charge, 0..1, NaN where there is none."""
        if "soc_pct" not in cells:
            return math.nan
        percent = cells["soc_pct"]
        if percent < 0 or percent > 100:
            self.dropped["soc_pct_out_of_range"] += 1
            return math.nan
        return percent / 100

    def _numbers(self, row: list[str]) -> dict[str, float]:
        """The numbers of the used, not empty cells of a row by column."""
        numbers = {}
        for name, cell in zip(self._header, row, strict=True):
            rule = self._rules.get(name)
            if rule is None or not cell.strip():
                continue
            column, value = QUANTITIES[rule.quantity].column, rule.value(cell)
            if math.isfinite(value):
                numbers[column] = value
            else:
                self.dropped[f"{column}_not_a_number"] += 1
        return numbers

    def _first(self, rows: Iterator[list[str]]) -> Iterator[list[str]]:
        """The whole ones among the first rows; where the file breaks off is told on reading."""
        with suppress(InputError):
            yield from (row for row in islice(rows, LOOKED_AT) if len(row) == len(self._header))

    def _rows(self) -> Iterator[list[str]]:
        """The rows that are not blank, the header first."""
        line = 0
        try:
            with _open(self.path) as file:
                lines = bounded_lines(file)
                first = next(lines, "")
                delimiter = max(",;\t|", key=first.count)
                reader = csv.reader(chain((first,), lines), delimiter=delimiter)
                for row in reader:
                    line = reader.line_num
                    if row:
                        yield row
        except READ_ERRORS as error:
            where = f"{self.path}:{line + 1}" if line else str(self.path)
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{where}: {reason}") from error

    def _check_columns(self) -> None:
        if len(set(self.columns)) < sum(name in self.columns for name in self._header):
            raise InputError(f"{self.path}: a column is there twice")
        found = {rule.quantity for rule in self.rules}
        there = f"there are {', '.join(self._header)[:LONGEST_LIST]}"
        if missing := [name for name in ("time", "speed") if name not in found]:
            say = " ".join(f"--column {name}=NAME" for name in missing)
            raise InputError(
                f"{self.path}: no column of {' and '.join(missing)}; {there}; say {say}"
            )
        if "power" not in found and not {"voltage", "current"} <= found:
            raise InputError(
                f"{self.path}: no columns of voltage and current, and none of power; {there}; "
                "say --column power=NAME"
            )


def _nanoseconds(seconds: float) -> int:
    """Exact to the nanosecond for what a float can tell apart, years after 1970 too."""
    whole = math.floor(seconds)
    return whole * NANOSECONDS + round((seconds - whole) * NANOSECONDS)


def _open(path: Path) -> IO[str]:
    """The text of the file; a byte order mark is skipped."""
    opener = gzip.open if path.suffix == ".gz" else Path.open
    start = b""
    with opener(path, "rb") as file, suppress(EOFError):
        start = file.readline(LONGEST_HEADER)
    return io.TextIOWrapper(opener(path, "rb"), encoding=_encoding(start), newline="")


def _encoding(start: bytes) -> str:
    """UTF-8, or Windows' own where a degree sign shows that it is not."""
    try:
        start.decode("utf-8-sig")
    except UnicodeDecodeError:
        return "cp1252" if b"\0" not in start else "utf-8-sig"
    return "utf-8-sig"
