"""Height of the road along the way: what was measured, averaged around a place."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

REACH = 75.0  # m to either side over which heights are averaged; GNSS and barometers stray
LEAST_STEP = 0.5  # m between two heights that are kept; a standing car adds none
LENGTH = 2000.0  # m of road kept
KNOWN_WITHIN = 300.0  # m since the last height, then the height counts as unknown


class HeightProfile:
    """Heights by the odometer, their average a moving integral."""

    def __init__(self) -> None:
        """Nothing known."""
        self._odometer: list[float] = []
        self._height: list[float] = []
        self._integral: list[float] = []  # of height along the way, m^2

    def add(self, odometer: float, height: float) -> None:
        """Take the height, m, where the odometer shows so many m, further on than the last."""
        if self._odometer and odometer - self._odometer[-1] < LEAST_STEP:
            return
        before = 0.0
        if self._odometer:
            step = odometer - self._odometer[-1]
            before = self._integral[-1] + step * (height + self._height[-1]) / 2
        for column, value in zip(self._columns, (odometer, height, before), strict=True):
            column.append(value)
        if self._odometer[len(self._odometer) // 2] < odometer - LENGTH:
            surplus = bisect_left(self._odometer, odometer - LENGTH)
            for column in self._columns:
                del column[:surplus]

    def known_at(self, odometer: float) -> bool:
        """True if heights are measured where the car is."""
        return bool(self._odometer) and odometer - self._odometer[-1] < KNOWN_WITHIN

    def reaches(self, odometer: float) -> bool:
        """True if heights are measured up to a place, so that its average changes no more."""
        return bool(self._odometer) and self._odometer[-1] >= odometer

    def mean_around(self, odometer: float) -> float | None:
        """Height averaged `REACH` to either side, m, as far as known; None where it is not."""
        if not self._odometer or not (
            self._odometer[0] - REACH <= odometer <= self._odometer[-1] + REACH
        ):
            return None
        low = max(odometer - REACH, self._odometer[0])
        high = min(odometer + REACH, self._odometer[-1])
        if high - low < LEAST_STEP:
            return float(np.interp(odometer, self._odometer, self._height))
        ends = np.interp((low, high), self._odometer, self._integral)
        return float(ends[1] - ends[0]) / (high - low)

    @property
    def _columns(self) -> tuple[list[float], list[float], list[float]]:
        return self._odometer, self._height, self._integral
