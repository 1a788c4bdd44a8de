"""Hills of the roads that a car drives, for those of which no height is known.

What a plan or a dropout without heights climbs is unknown; how far the car's drives with known
heights ended above or below their start tells how much that may be.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.estimation.calibration import MOST_SUM
from evpinn_ros.estimation.unevenness import Path

LEAST_METRES = 10e3  # of known heights, before they tell
MEMORY = 300e3  # m within which what was driven before is forgotten to a third


@dataclass(frozen=True, slots=True)
class Hills:
    """Sums over drives with known heights.

    Attributes:
        squares: of the climb of each from start to end, m^2.
        metres: of their length, m.
    """

    squares: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    metres: Annotated[float, Range(0.0, MOST_SUM)] = 0.0

    @property
    def growth(self) -> float:
        """Variance of height per length of road, m; 0 while unknown."""
        return self.squares / self.metres if self.metres >= LEAST_METRES else 0.0

    def after(self, drive: Path) -> Hills:
        """With one more drive; a step that climbs exactly nothing has no known height."""
        metres = float(abs(drive.distance)[drive.climb != 0.0].sum())
        kept = math.exp(-metres / MEMORY)
        square = float(drive.climb.sum()) ** 2
        return Hills(kept * self.squares + square, kept * self.metres + metres)
