"""Thins series to an even grid that keeps their peaks, and packs them into two bytes a number."""

from __future__ import annotations

import base64
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.replays.scoring import longest_step

LEVELS = 65534  # of 16 bits, without `NO_VALUE`
NO_VALUE = -32768  # NaN
LARGEST = 1e12  # of any unit; larger values could overflow the arithmetic of the levels
PER_BUCKET = 2  # points kept of a bucket: its least and greatest value


class Grid(NamedTuple):
    """Buckets of equal duration."""

    width: float  # of a bucket, s
    buckets: int  # their number

    @property
    def times(self) -> dict[str, float | int]:
        """Start, step, s, and count of the kept points, as `browser/drive.js` reads them."""
        step = self.width / PER_BUCKET
        return {"start": step / 2, "step": step, "count": PER_BUCKET * self.buckets}


def grid_for(time: np.ndarray, duration: float, points: int) -> Grid:
    """A grid over `duration`, s, that keeps every sample, or at most `points` points."""
    steps = np.diff(np.unique(time))
    period = float(np.median(steps)) if len(steps) else 1.0
    span = max(duration, period)
    buckets = int(min(max(span / (PER_BUCKET * period), 1), points // PER_BUCKET))
    return Grid(span / buckets, buckets)


def thinned(time: np.ndarray, values: np.ndarray, grid: Grid) -> np.ndarray:
    """Least and greatest value of each bucket in order of time, shape (PER_BUCKET * buckets,).

    Empty buckets are interpolated over at most `longest_step`; others hold NaN.
    """
    bucket = np.floor(time / grid.width).astype(np.int64)
    bucket[time == grid.width * grid.buckets] = grid.buckets - 1
    kept = np.isfinite(values) & (bucket >= 0) & (bucket < grid.buckets)
    order = np.flatnonzero(kept)[np.argsort(time[kept], kind="stable")]
    time, values, bucket = time[order], values[order], bucket[order]
    extremes_of_bucket = np.full((grid.buckets, PER_BUCKET), np.nan)
    if len(time):
        by_value = np.lexsort((values, bucket))
        filled, first = np.unique(bucket[by_value], return_index=True)
        last = np.append(first[1:], len(by_value)) - 1
        extremes = np.sort(np.stack((by_value[first], by_value[last])), axis=0)
        extremes_of_bucket[filled] = values[extremes].T
        _join(extremes_of_bucket, time, values, grid)
    return extremes_of_bucket.reshape(-1)


def _join(extremes: np.ndarray, time: np.ndarray, values: np.ndarray, grid: Grid) -> None:
    """Interpolate, in place, empty buckets between values at most `longest_step` apart."""
    empty = np.flatnonzero(np.isnan(extremes[:, 0]))
    middle = (empty + 0.5) * grid.width
    after = np.searchsorted(time, middle)
    inside = (after > 0) & (after < len(time))
    empty, middle, after = empty[inside], middle[inside], after[inside]
    near = time[after] - time[after - 1] <= longest_step(time)
    extremes[empty[near]] = np.interp(middle[near], time, values)[:, None]


def packed(values: np.ndarray) -> dict[str, Any]:
    """Numbers as base64 of little-endian 16-bit levels: value = low + step * (level + 32767)."""
    values = np.clip(values, -LARGEST, LARGEST)
    finite = np.isfinite(values)
    low = float(values[finite].min()) if finite.any() else 0.0
    high = float(values[finite].max()) if finite.any() else 0.0
    step = (high - low) / LEVELS or 1.0
    levels = np.full(len(values), NO_VALUE, dtype="<i2")
    levels[finite] = np.round((values[finite] - low) / step) - LEVELS // 2
    return {"low": low, "step": step, "levels": base64.b64encode(levels.tobytes()).decode()}
