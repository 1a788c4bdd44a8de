"""Dropouts of the battery that did not happen: how far the sigma of energy is to be trusted.

While the battery is measured, a copy of the filter goes on without it for `LENGTH` of driving.
Then its prediction is compared with the energy drawn, and the next copy begins. The sigma of a
real dropout is scaled by how these errors spread (`calibration.Chance`): roads, weather and polled
signals err in ways of their own that no variance of the filter holds.
"""

from __future__ import annotations

import copy
from dataclasses import replace
import math

from evpinn_ros.estimation.calibration import Chance
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.signals.interval import Interval

LENGTH = 200.0  # s
LEAST_DISTANCE = 500.0  # m; a car that stands proves nothing
MOST_DEVIATE = 3.0  # sigmas, one odd road counts no more


class Rehearsal:
    """See the module's text.

    Attributes:
        chance: how far the energies of the dropouts strayed, in sigmas.
    """

    def __init__(self) -> None:
        """No dropout was rehearsed."""
        self.chance = Chance()
        self.end()

    def end(self) -> None:
        """Leave the present one out: of a drive or road that ended, or of a real dropout."""
        self._without: CarFilter | None = None
        self._drawn = self._seconds = self._distance = 0.0

    def copy(self) -> Rehearsal:
        """An independent copy."""
        other = copy.copy(self)
        other.chance = replace(self.chance)
        other._without = None if self._without is None else self._without.copy()
        return other

    def learn(self, now: CarFilter, interval: Interval) -> None:
        """Take the next interval, with the filter as it was before it."""
        if math.isnan(interval.energy):
            self.end()
            return
        without = self._without = self._without or now.copy()
        without.parts = None
        without.learn(replace(interval, energy=math.nan))
        self._drawn += interval.energy
        self._seconds += interval.duration
        self._distance += abs(interval.distance)
        if self._seconds >= LENGTH and self._distance >= LEAST_DISTANCE:
            predicted, sigma = without.unmeasured()
            self.chance.learn(min(abs(self._drawn - predicted) / sigma, MOST_DEVIATE))
            self.end()
