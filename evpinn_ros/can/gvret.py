"""CSV logs of SavvyCAN and of GVRET firmware: a frame a row, hexadecimal.

`Time Stamp,ID,Extended,Dir,Bus,LEN,D1,...,D8`, times in microseconds; version 1 has no `Dir`
(SavvyCAN, framefileio.cpp, loadNativeCSVFile).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import csv

import can

HEADER = "Time Stamp,ID,Extended"
MICROSECOND = 1e-6


class GvretReader:
    """The frames of such a log, as python-can's readers give them."""

    def __init__(self, lines: Iterable[str]) -> None:
        """Read lines, the header first."""
        self._lines = lines

    def __iter__(self) -> Iterator[can.Message]:
        reader = csv.reader(self._lines)
        names = [name.strip("\ufeff ") for name in next(reader)]
        place = {name: names.index(name) for name in ("Time Stamp", "ID", "Extended", "LEN")}
        direction = names.index("Dir") if "Dir" in names else None
        bus = names.index("Bus") if "Bus" in names else None
        for row in reader:
            if not any(row):
                continue
            length = int(row[place["LEN"]])
            first = place["LEN"] + 1
            data = bytes(int(cell, 16) for cell in row[first : first + length])
            if len(data) < length:
                raise ValueError(f"{len(data)} of {length} bytes")
            yield can.Message(
                timestamp=int(row[place["Time Stamp"]]) * MICROSECOND,
                arbitration_id=int(row[place["ID"]], 16),
                is_extended_id=row[place["Extended"]].strip().lower() in ("true", "1"),
                is_rx=direction is None or row[direction].strip().lower() != "tx",
                channel=row[bus] if bus is not None else None,
                dlc=length,
                data=data,
                is_fd=length > 8,
            )
