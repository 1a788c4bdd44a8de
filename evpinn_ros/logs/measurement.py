"""Converts signals of an .mf4 to a long CSV by asammdf in another process, as it may crash."""

from __future__ import annotations

from contextlib import suppress
import csv
from pathlib import Path

import numpy as np

from evpinn_ros.common.opener import open_file
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.writer import new_table
from evpinn_ros.logs.quantities import may_be_of_use

with suppress(ImportError):  # imported first, since limits of the process count from then on
    import asammdf  # noqa: F401

HEADER = ("seconds", "name", "value", "unit")


def write_signals(path: Path, out: Path) -> None:
    """Write the useful signals of an .mf4 in time order; no file if there are none."""
    with optional_imports():
        from asammdf import MDF
    stamps, names, values = [], [], []
    signals: list[tuple[str, str]] = []
    with open_file(path) as file, MDF(file) as measured:
        start = measured.header.start_time.timestamp()
        channels = measured.channels_db.items()
        wanted = {place for name, places in channels if may_be_of_use(name) for place in places}
        for group, index in sorted(wanted):
            signal = measured.get(group=group, index=index)
            if signal.samples.dtype.kind not in "iuf" or signal.samples.ndim != 1:
                continue
            stamps.append(signal.timestamps + start)
            values.append(signal.samples.astype(np.float64))
            names.append(np.full(len(signal), len(signals)))
            signals.append((signal.name, signal.unit or ""))
    if not signals:
        return
    order = np.argsort(np.concatenate(stamps), kind="stable")
    columns = (np.concatenate(parts)[order] for parts in (stamps, names, values))
    with new_table(out) as table:
        writer = csv.writer(table)
        writer.writerow(HEADER)
        for stamp, number, value in zip(*columns, strict=True):
            name, unit = signals[number]
            writer.writerow((f"{stamp:.9f}", name, repr(float(value)), unit))
