"""Cells that repeat a signal's last value, in rows that were written for another signal.

A logger that writes a row whenever anything is new, and fills the other cells with what was last
known (the Vehicle Energy Dataset), makes steps of a speed: the change of a second seems to happen
within a tenth. Where rows come unevenly, a fine signal that repeats to the last digit was not
measured again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.drives.units_by_values import Signal

MAY_BE_HELD = ("speed", "current", "power")
UNEVEN = 0.5  # of the usual step between rows: one step in twenty is shorter
LEAST_REPEATS = 0.1  # of the steps
FINE = 10.0  # resolutions that a signal usually changes by
LEAST_ROWS = 100
LONGEST_NS = 1_500_000_000  # a value that lasts longer is taken again, as of a steady car

FloatArray = NDArray[np.float64]


def held_columns(signals: Mapping[str, Signal]) -> frozenset[str]:
    """Quantities whose cells repeat the last value where nothing was measured."""
    return frozenset(name for name in MAY_BE_HELD if name in signals and _is_held(signals[name]))


def _is_held(signal: Signal) -> bool:
    time, value = signal.points()
    steps = np.diff(time)
    if len(steps) < LEAST_ROWS or np.quantile(steps, 0.05) > UNEVEN * np.median(steps):
        return False
    changes = np.abs(np.diff(value))
    changed = changes[changes > 0.0]
    if not changed.size or np.mean((changes == 0.0) & (value[1:] != 0.0)) < LEAST_REPEATS:
        return False
    resolution = np.quantile(np.diff(np.unique(value)), 0.05)
    return bool(np.median(changed) > FINE * resolution)


class HeldSignals:
    """Takes repeated cells out of held columns, batch by batch."""

    def __init__(self, names: Iterable[str]) -> None:
        """Begin, for these quantities."""
        self._last: dict[str, tuple[int, float]] = dict.fromkeys(names, (0, np.nan))

    def drop_repeats(
        self, stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: NDArray[np.intp]
    ) -> None:
        """Set repeated cells to NaN.

        Args:
            stamps: of all rows of the batch, ns, shape (n,).
            values: of these, by quantity; changed here.
            rows: those that are used, in order of time.
        """
        for name, (since_ns, last) in self._last.items():
            for row in rows.tolist():
                value, stamp_ns = float(values[name][row]), int(stamps[row])
                if value == last and stamp_ns - since_ns < LONGEST_NS:
                    values[name][row] = np.nan
                elif value == value:
                    since_ns, last = stamp_ns, value
            self._last[name] = since_ns, last
