"""Hills of the roads that a car drives, for those of which no height is known.

What a plan or a dropout without heights climbs is unknown; how far the car's drives with known
heights ended above or below their start tells how much that may be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Annotated

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.estimation.calibration import MOST_SUM

LEAST_METRES = 10e3  # of known heights, before they tell
MEMORY = 300e3  # m within which what was driven before is forgotten to a third


@dataclass(frozen=True, slots=True)
class Hills:
    """Sums over the parts of drives whose heights were known.

    Attributes:
        squares: of the climb of each earlier drive from start to end, m^2.
        metres: of their length, m.
        way: m of this drive.
        climb: m of this drive, up less down.
    """

    squares: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    metres: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    way: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    climb: Annotated[float, Range(-1e5, 1e5)] = 0.0

    @property
    def growth(self) -> float:
        """Variance of height per length of road, m; 0 while unknown."""
        return self.squares / self.metres if self.metres >= LEAST_METRES else 0.0

    def plus(self, way: float, climb: float) -> Hills:
        """With more of this drive, m, whose height was known."""
        return replace(self, way=self.way + way, climb=self.climb + climb)

    def next_drive(self) -> Hills:
        """At the start of another drive."""
        kept = math.exp(-self.way / MEMORY)
        squares, metres = kept * self.squares + self.climb**2, kept * self.metres + self.way
        return Hills(min(squares, MOST_SUM), min(metres, MOST_SUM))
