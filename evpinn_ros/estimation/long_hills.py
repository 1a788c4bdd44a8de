"""Hills longer than the filter's own: how far a road strays from the height it began at.

The filter's unseen height is bounded, so that it does not compete with rolling resistance; a home
on a hill is not. Over a kilometre and more, height is close to a random walk along the road. How
much it grows is learned where height is measured, and widens the energy predicted where it is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from evpinn_ros.signals.interval import Interval

GROWTH = 0.2**2  # m^2 of height per m of road, as in gentle country: 6 m over a kilometre
PRIOR_BLOCKS, BLOCKS_KEPT = 8.0, 60.0  # that this counts as, and that are remembered
BLOCK = 1000.0  # m of road


@dataclass(frozen=True, slots=True)
class LongHills:
    """Growth of height, learned; a value that is replaced.

    Attributes:
        growth: variance of height per length of road, m.
        blocks: of road that this was learned from, those of the prior among them.
        distance: into the present block, m.
        climb: in it, m.
    """

    growth: float
    blocks: float = PRIOR_BLOCKS
    distance: float = 0.0
    climb: float = 0.0

    def after(self, interval: Interval) -> LongHills:
        """The growth after one more interval; of one without height nothing is learned."""
        if not interval.height_known:
            return self.elsewhere()
        distance = self.distance + abs(interval.distance)
        climb = self.climb + float(interval.steps.climb.sum())
        if distance < BLOCK:
            return replace(self, distance=distance, climb=climb)
        blocks = min(self.blocks + 1.0, BLOCKS_KEPT)
        growth = self.growth + (climb**2 / distance - self.growth) / blocks
        return LongHills(growth, blocks)

    def unseen(self, interval: Interval) -> float:
        """Variance of the height that an interval gains, m^2, where none is known."""
        return 0.0 if interval.height_known else self.growth * abs(interval.distance)

    def elsewhere(self) -> LongHills:
        """The same where the road goes on at another place."""
        return LongHills(self.growth, self.blocks)
