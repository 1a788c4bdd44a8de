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
from typing import Any

import numpy as np

from evpinn_ros.can.logs import run_limited
from evpinn_ros.drives.quantities import QUANTITIES, score

HEADER = ("seconds", "name", "value", "unit")


def write_signals(path: Path, out: Path) -> int:
    """Write the signals of an .mf4 that may be of use, in order of time; gives how many."""
    from asammdf import MDF  # a second to import, and an extra

    stamps, names, values = [], [], []
    found: list[tuple[str, str]] = []
    with MDF(path) as measured:
        start = measured.header.start_time.timestamp()
        for group, index in _wanted(measured):
            signal = measured.get(group=group, index=index)
            if signal.samples.dtype.kind not in "iuf" or signal.samples.ndim != 1:
                continue
            stamps.append(signal.timestamps + start)
            values.append(signal.samples.astype(np.float64))
            names.append(np.full(len(signal), len(found)))
            found.append((signal.name, signal.unit or ""))
    if found:
        order = np.argsort(np.concatenate(stamps), kind="stable")
        columns = (np.concatenate(each)[order] for each in (stamps, names, values))
        with out.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(HEADER)
            for stamp, name, value in zip(*columns, strict=True):
                writer.writerow(
                    (f"{stamp:.9f}", found[name][0], repr(float(value)), found[name][1])
                )
    return len(found)


def _wanted(measured: Any) -> list[tuple[int, int]]:
    """Places of the channels whose names speak for a quantity."""
    wanted = []
    for name, places in measured.channels_db.items():
        if any(score(quantity, name) > 0 for quantity in QUANTITIES if quantity != "time"):
            wanted += list(places)
    return sorted(set(wanted))


def signals_of(path: Path, folder: Path) -> Path | None:
    """The signals of an .mf4 as a long table in a folder; None when none can be read of it.

    The reason is given where it is read as a CAN log then.
    """
    out = folder / "signals.csv"
    run_limited([sys.executable, "-m", __name__, str(path), str(out)])
    return out if out.exists() else None


def holds_signals(path: Path) -> bool:
    """True if an .mf4 holds measured signals that may be of use, and not only frames of a bus."""
    with TemporaryDirectory() as folder:
        return signals_of(path, Path(folder)) is not None


if __name__ == "__main__":
    write_signals(Path(sys.argv[1]), Path(sys.argv[2]))
