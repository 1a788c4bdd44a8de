"""Measured signals of an ASAM .mf4 as a long table, made by another process.

A file of frames of a CAN bus holds none; it is a CAN log (`evpinn_ros.can.logs`). asammdf reads
a file as a whole and can crash over a damaged one, so it runs apart and within limits:
`python -m evpinn_ros.drives.measurement IN OUT`.
"""

from __future__ import annotations

import csv
from pathlib import Path
import sys
from tempfile import TemporaryDirectory

import numpy as np

from evpinn_ros.can.logs import run_limited
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.quantities import may_be_of_use
from evpinn_ros.drives.text_table import TextTable

HEADER = ("seconds", "name", "value", "unit")


class MeasuredTable(TextTable):
    """The signals of an .mf4 that may be of use, in order of time, one value a row."""

    def __init__(self, path: Path) -> None:
        """Have them written as text.

        Raises:
            InputError: there is none, or it cannot be read; as a CAN log it gives the reason.
        """
        self._folder = TemporaryDirectory()  # lasts as long as the table
        signals = Path(self._folder.name) / "signals.csv"
        run_limited([sys.executable, "-m", __name__, str(path), str(signals)])
        if not signals.exists():
            self._folder.cleanup()
            raise InputError(f"{path}: no signal of a drive in it")
        super().__init__(signals)


def holds_signals(path: Path) -> bool:
    """True if an .mf4 holds measured signals that may be of use, and not only frames of a bus."""
    try:
        MeasuredTable(path)
    except InputError:
        return False
    return True


def write_signals(path: Path, out: Path) -> None:
    """Write the signals of an .mf4 that may be of use, in order of time; no file without any."""
    from asammdf import MDF  # a second to import, and an extra

    stamps, names, values = [], [], []
    found: list[tuple[str, str]] = []
    with MDF(path) as measured:
        start = measured.header.start_time.timestamp()
        channels = measured.channels_db.items()
        wanted = {place for name, places in channels if may_be_of_use(name) for place in places}
        for group, index in sorted(wanted):
            signal = measured.get(group=group, index=index)
            if signal.samples.dtype.kind not in "iuf" or signal.samples.ndim != 1:
                continue
            stamps.append(signal.timestamps + start)
            values.append(signal.samples.astype(np.float64))
            names.append(np.full(len(signal), len(found)))
            found.append((signal.name, signal.unit or ""))
    if not found:
        return
    order = np.argsort(np.concatenate(stamps), kind="stable")
    columns = (np.concatenate(each)[order] for each in (stamps, names, values))
    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for stamp, number, value in zip(*columns, strict=True):
            name, unit = found[number]
            writer.writerow((f"{stamp:.9f}", name, repr(float(value)), unit))


if __name__ == "__main__":
    write_signals(Path(sys.argv[1]), Path(sys.argv[2]))
