"""The learned car as a value for predictions, without what is needed to go on learning."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.bands import PredictedEnergy, TrackRecord
from evpinn_ros.core.estimation.journey import Journey, wandered
from evpinn_ros.core.estimation.states import SIZE, State
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.estimation.unevenness import Unevenness
from evpinn_ros.core.signals.readings import TEMPERATURES
from evpinn_ros.core.vehicle.physics import GRAVITY

MOST_NUMBER = 1e20  # of a state or covariance, in its unit, so that products stay finite
MOST_TRUST = 1e4  # factor of a variance
MOST_SECONDS = 1e9  # of a drive


@dataclass(frozen=True, slots=True, eq=False)
class CarModel:
    """A car for predictions: of dropouts, forecasts and planners.

    Attributes:
        equation: of the car.
        mean: of the states over all hypotheses, shape (SIZE,).
        covariance: shape (SIZE, SIZE).
        noise: scales of the kinds of unexplained energy (`noise_of`), shape (3,).
        load_variance: of the wandering load, W^2.
        growth: variance of unseen height per length of road, m.
        trust: factor of the variance of energy, by rehearsals of whole drives, or of dropouts once
            an interval of this drive was learned from.
        seconds: length of this drive so far, s.
        celsius: last known temperature outside, degrees Celsius, or None.
        unevenness: energy of uneven speed beyond even speed.
        last_drive: length of the drive before, s; 0 if unknown.
        record: errors of earlier drives, predicted at their start.
    """

    equation: Equation
    mean: Annotated[np.ndarray, Range(-MOST_NUMBER, MOST_NUMBER, shape=(SIZE,))]
    covariance: Annotated[np.ndarray, Range(-MOST_NUMBER, MOST_NUMBER, shape=(SIZE, SIZE))]
    noise: Annotated[np.ndarray, Range(0.0, MOST_NUMBER, shape=(3,))]
    load_variance: Annotated[float, Range(0.0, MOST_NUMBER)]
    growth: Annotated[float, Range(0.0, MOST_NUMBER)]
    trust: Annotated[float, Range(0.0, MOST_TRUST)]
    seconds: Annotated[float, Range(0.0, MOST_SECONDS)]
    celsius: Annotated[float, Range(*TEMPERATURES)] | None
    unevenness: Unevenness = field(default_factory=Unevenness.none)
    last_drive: Annotated[float, Range(0.0, MOST_SECONDS)] = 0.0
    record: TrackRecord = field(default_factory=TrackRecord)

    @property
    def weight_over_eta(self) -> float:
        """Weight of the car over eta, N."""
        return GRAVITY * float(self.mean[State.MASS_OVER_ETA])

    def energy(self, journey: Journey) -> PredictedEnergy:
        """Energy of a journey, or of several, from here on, without battery readings."""
        _, integral, rest = wandered(journey.seconds)
        row = journey.row.copy()
        row[..., State.LOAD] = integral
        variance = ((row @ self.covariance) * row).sum(axis=-1) + self.load_variance * rest
        variance = variance + journey.noise @ self.noise
        hills = self.weight_over_eta**2 * journey.unseen
        return PredictedEnergy(row @ self.mean, variance, hills)

    def predicted(self, journey: Journey) -> tuple[Any, Any]:
        """Energy of a journey, or of several, and 1-sigma with `trust` and unseen hills, J."""
        energy = self.energy(journey)
        variance = self.trust * energy.with_hills(self.growth)
        return energy.mean, np.sqrt(np.maximum(variance, 0.0))
