"""Height of the road along the way: what was measured, averaged around a place."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import numpy as np

REACH = 75.0  # m to either side over which heights are averaged; GNSS and barometers stray
LEAST_STEP = 0.5  # m between two heights that are kept; a standing car adds none
LENGTH = 2000.0  # m of road kept
KNOWN_WITHIN = 300.0  # m since the last height, then the height counts as unknown
STUCK_AFTER = 1000.0  # m with one altitude; even a flat road is not that level to the digit
STEEPEST = 0.3  # rise over run of the steepest streets
LEAP = 30.0  # m more than that between two altitudes; GNSS strays less once it has a fix


class Rise(NamedTuple):
    """Rise of the road, m, and the odometer where it began, m."""

    since: float
    height: float


class AltitudeCheck:
    """Rise of the road from one altitude to the next, and only where they are measured.

    A receiver without a fix repeats one altitude, often 0, and leaps once it has one. A logged
    altitude that never moves would otherwise make a hilly commute flat.
    """

    def __init__(self) -> None:
        """Start without an altitude."""
        self._last: tuple[float, float] | None = None  # odometer and altitude, m
        self._moved_at: float | None = None  # odometer where it last changed, m

    @property
    def moves(self) -> bool:
        """True while the altitude changes along the road."""
        if self._last is None or self._moved_at is None:
            return False
        return self._last[0] - self._moved_at <= STUCK_AFTER

    def rise(self, odometer: float, altitude: float) -> Rise | None:
        """Rise since the last altitude: 0 over a leap, None while the altitude is stuck."""
        place, before = self._last or (odometer, altitude)
        self._last, found = (odometer, altitude), altitude - before
        if found:
            self._moved_at = odometer
        if not self.moves:
            return None
        leaps = abs(found) > LEAP + STEEPEST * abs(odometer - place)
        return Rise(place, 0.0 if leaps else found)


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
