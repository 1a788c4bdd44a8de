"""A car as predictions take it: what was learned of it, without what goes on learning."""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np

from evpinn_ros.core.estimation.bands import PredictedEnergy
from evpinn_ros.core.estimation.journey import Journey, wandered
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.estimation.unevenness import Unevenness
from evpinn_ros.core.vehicle.physics import GRAVITY


@dataclass(frozen=True, slots=True, eq=False)
class CarModel:
    """A car as predictions take it: what a dropout, a forecast and a planner need to know.

    Attributes:
        equation: of the car.
        mean: of the states over all hypotheses, shape (SIZE,).
        covariance: shape (SIZE, SIZE).
        noise: scales of what no state explains, by its kinds (`noise_of`), shape (3,).
        load_variance: of the wandering load, W^2.
        growth: variance of unseen height per length of road, m.
        trust: factor of the variance of energy, by rehearsals: of whole drives before anything
            was learned in this one, else of dropouts.
        seconds: of this drive so far.
        celsius: temperature outside, the last known, or None.
        reports: whether the car reports its heating.
        unevenness: what uneven speed takes beyond even.
        last_drive: s of the drive before.
    """

    equation: Equation
    mean: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray
    load_variance: float
    growth: float
    trust: float
    seconds: float
    celsius: float | None
    reports: bool
    unevenness: Unevenness = field(default_factory=Unevenness.none)
    last_drive: float = 0.0

    @property
    def weight_over_eta(self) -> float:
        """Weight of the car over eta, N."""
        return GRAVITY * float(self.mean[State.MASS])

    def energy(self, journey: Journey) -> PredictedEnergy:
        """Energy of a journey from here on, without any battery."""
        _, integral, rest = wandered(journey.seconds)
        row = journey.row.copy()
        row[State.LOAD] = integral
        variance = float(row @ self.covariance @ row) + self.load_variance * rest
        variance += float(self.noise @ journey.noise)
        hills = self.weight_over_eta**2 * journey.unseen
        return PredictedEnergy(float(row @ self.mean), variance, hills)

    def predicted(self, journey: Journey) -> tuple[float, float]:
        """Energy of a journey from here on, J, and its 1-sigma, J, as far as to be trusted."""
        energy = self.energy(journey)
        variance = self.trust * energy.with_hills(self.growth)
        return energy.mean, math.sqrt(max(variance, 0.0))
