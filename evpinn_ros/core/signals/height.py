"""Height of the road by the odometer: measured heights, averaged around a place."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.detector import ALTITUDE_STUCK, ONE_ALTITUDE

REACH = 75.0  # m to either side over which heights are averaged; GNSS and barometers stray
LEAST_STEP = 0.5  # m between two heights that are kept; a standing car adds none
MARGIN = 4.0 * REACH  # m of road kept behind, where a car may reverse
KNOWN_WITHIN = 300.0  # m of road after the last height, then height counts as unknown
STEEPEST = 0.3  # rise over run of the steepest streets
LEAP = 30.0  # m beyond `STEEPEST` between two altitudes; GNSS strays less once it has a fix


class Rise(NamedTuple):
    """Rise of the road, m, and the odometer where it began, m."""

    since: float
    height: float


@dataclass(frozen=True, slots=True)
class AltitudeDetector:
    """Detector of an altitude that is stuck; gives the rise of the road where it is not.

    A receiver without a fix repeats one altitude, often 0, and leaps once it has one. A logged
    altitude that never moves would otherwise make a hilly commute flat.

    Attributes:
        last: odometer and altitude, m; None before the first.
        moved_at: odometer where it last changed, m.
        stuck: verdict; True until the altitude first changes.
        rise: since the altitude before: 0 over a leap, None while it is stuck.
    """

    last: tuple[float, float] | None = None
    moved_at: float = -math.inf
    stuck: bool | None = True
    rise: Rise | None = None

    @property
    def detected(self) -> str | None:
        """`ALTITUDE_STUCK` or None."""
        return ALTITUDE_STUCK if self.stuck else None

    def after(self, odometer: float, altitude: float) -> AltitudeDetector:
        """The detector after an altitude, m, at an odometer reading, m."""
        place, before = self.last or (odometer, altitude)
        step = altitude - before
        moved_at = odometer if step else self.moved_at
        stuck = ONE_ALTITUDE.judge(self.stuck, odometer - moved_at)
        leaps = abs(step) > LEAP + STEEPEST * abs(odometer - place)
        rise = None if stuck else Rise(place, 0.0 if leaps else step)
        return AltitudeDetector((odometer, altitude), moved_at, stuck, rise)


class HeightProfile:
    """Heights by the odometer; their cumulative integral gives averages."""

    def __init__(self) -> None:
        """A profile without a height."""
        self._odometer: list[float] = []
        self._height: list[float] = []
        self._integral: list[float] = []  # of height along the way, m^2

    def add(self, odometer: float, height: float) -> None:
        """Add a height, m, at an odometer reading, m, beyond the last."""
        if self._odometer and odometer - self._odometer[-1] < LEAST_STEP:
            return
        integral = 0.0
        if self._odometer:
            step = odometer - self._odometer[-1]
            integral = self._integral[-1] + step * (height + self._height[-1]) / 2
        for column, value in zip(self._columns, (odometer, height, integral), strict=True):
            column.append(value)

    def forget_before(self, odometer: float) -> None:
        """Forget the heights that averages from this place on do not need."""
        surplus = bisect_left(self._odometer, odometer - MARGIN) - 1
        if surplus > 0:
            for column in self._columns:
                del column[:surplus]

    @property
    def seen(self) -> float:
        """Odometer up to which heights are known, m; -inf before the first."""
        return self._odometer[-1] if self._odometer else -math.inf

    def means_around(self, odometers: np.ndarray, seen: float) -> np.ndarray | None:
        """Heights averaged over up to `REACH` to either side of places, m, shape (n,).

        Uses heights up to `seen`; None if a place is more than `REACH` away from these.
        """
        count = bisect_right(self._odometer, seen)
        if not count:
            return None
        begin, end = self._odometer[0], self._odometer[count - 1]
        if odometers.min() < begin - REACH or odometers.max() > end + REACH:
            return None
        near = slice(max(0, bisect_left(self._odometer, odometers.min() - REACH) - 1), count)
        road, height, integral = (np.array(column[near]) for column in self._columns)
        low, high = np.maximum(odometers - REACH, begin), np.minimum(odometers + REACH, end)
        length = high - low
        mean = (np.interp(high, road, integral) - np.interp(low, road, integral)) / np.maximum(
            length, LEAST_STEP
        )
        return np.asarray(np.where(length < LEAST_STEP, np.interp(odometers, road, height), mean))

    @property
    def _columns(self) -> tuple[list[float], list[float], list[float]]:
        return self._odometer, self._height, self._integral
