"""Rows of a table put in order of time, some thousand at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.signals.readings import NANOSECONDS

STRAGGLING_NS = 10 * NANOSECONDS  # rows that are late by less are put in order


class RowOrder:
    """Takes rows batch by batch and gives those that are not too late, by their stamps.

    Attributes:
        dropped: rows that were too late, or alone in the future.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._newest = -1

    def sorted(self, stamps: NDArray[np.int64], rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Some rows in order, none older than those of the batches before.

        `stamps`, ns, shape (n,), are those of all rows of the batch; `rows` those that have one.
        """
        kept = rows[~_alone(stamps[rows])]
        times = stamps[kept]
        newest = np.maximum.accumulate(times) if times.size else times
        late = (times < newest - STRAGGLING_NS) | (times < self._newest)
        kept = kept[~late]
        kept = kept[np.argsort(stamps[kept], kind="stable")]
        if kept.size:
            self._newest = int(stamps[kept[-1]])
        self.dropped += rows.size - kept.size
        return kept


def _alone(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """True if a row is in the future of its neighbours: one broken digit of a date."""
    found = np.zeros(times.size, dtype=bool)
    if times.size > 2:
        ahead = times[1:-1] - times[2:] > STRAGGLING_NS
        found[1:-1] = ahead & (times[2:] >= times[:-2])
    return found
