"""Peers of the learner: their interface, and baselines that learn nothing.

A peer predicts each sample first and learns from it after, in the order of the stream. All peers
get what the learner gets: speed, acceleration, grade, air density and known auxiliary loads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import Protocol

from benchmarks.kalman import FAST, FiveStateFilter
from evpinn_ros.estimation.learner import PowerPrediction
from evpinn_ros.reproduction.published import PREDICTED
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import combined_power, identifiable
from evpinn_ros.vehicle.physics import RegenForm


class OnlineMethod(Protocol):
    """A peer. Time enters only through the samples' stamps."""

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power at a sample from what was observed before, W; sigma NaN if it has none."""

    def observe(self, sample: Sample, power: float) -> None:
        """Learn from a sample whose battery power, W, was measured."""


class PriorOnly:
    """Physics at the priors of the vehicle file, the form and inertia of `mode: hybrid`."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._combined = identifiable(vehicle.initial, vehicle.frontal_area)
        self._rotating_mass_factor = vehicle.rotating_mass_factor

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power of the prior car, W."""
        power = combined_power(
            sample.speed,
            sample.acceleration,
            self._combined,
            air_density=sample.air_density,
            grade=sample.grade,
            rotating_mass_factor=self._rotating_mass_factor,
        )
        return PowerPrediction(float(power) + sample.known_auxiliary, math.nan)

    def observe(self, sample: Sample, power: float) -> None:
        """Nothing is learned."""


class PublishedParameters:
    """Eq. 21 with the parameters that the paper publishes for this car (Table V)."""

    def __init__(self, vehicle: Vehicle, form: RegenForm) -> None:
        """Take the published values; KeyError when there are none for this car."""
        self._parameters = PREDICTED[vehicle.key]
        self._vehicle, self._form = vehicle, form

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power of eq. 21, W."""
        power = self._vehicle.power(
            sample.speed,
            sample.acceleration,
            self._parameters,
            self._form,
            air_density=sample.air_density,
            grade=sample.grade,
        )
        return PowerPrediction(float(power) + sample.known_auxiliary, math.nan)

    def observe(self, sample: Sample, power: float) -> None:
        """Nothing is learned."""


PEERS: Mapping[str, Callable[[Vehicle], OnlineMethod]] = {
    "prior": PriorOnly,
    "table5_recovery": lambda vehicle: PublishedParameters(vehicle, RegenForm.RECOVERY),
    "table5_printed": lambda vehicle: PublishedParameters(vehicle, RegenForm.PRINTED),
    "ekf5": FiveStateFilter,
    "ekf5_fast": lambda vehicle: FiveStateFilter(vehicle, pace=FAST),
}


def peers(names: list[str], vehicle: Vehicle) -> dict[str, OnlineMethod]:
    """The peers of these names that exist for a car, each at its start."""
    published = vehicle.key in PREDICTED
    return {
        name: PEERS[name](vehicle)
        for name in names
        if name in PEERS and (published or not name.startswith("table5"))
    }
