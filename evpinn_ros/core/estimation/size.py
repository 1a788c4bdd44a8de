"""Vehicles of another size than a passenger car: learned as the car that is similar to them.

The one equation (`estimation.terms`) is linear in energy: with mass, drag area and loads times k
the energy of the same driving is k times as much. So priors of loads, noise and thresholds of
detectors, all of cars in W, N, J and kg, hold for a robot of 60 kg as well, once its energies are
multiplied by the mass of a car over its own. `Similarity` scales readings on the way into the
estimator and estimates on the way out; in between everything is a car. Speeds and accelerations
stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar, overload

import numpy as np

from evpinn_ros.core.estimation.breakdown import Breakdowns
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet, PowerEstimate
from evpinn_ros.core.estimation.learner import LearnerReport
from evpinn_ros.core.estimation.posterior import initial_state
from evpinn_ros.core.estimation.states import SIZE, State
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.signals.block import FIELDS, Block
from evpinn_ros.core.signals.readings import (
    AuxiliaryReading,
    BatteryReading,
    MotorReading,
    Reading,
)
from evpinn_ros.core.vehicle.files import EXTENSIVE, Vehicle

Value = TypeVar("Value")
EXTENSIVE_FIELDS: Mapping[type[Reading], tuple[str, ...]] = {
    BatteryReading: ("current", "power_std"),
    AuxiliaryReading: ("heating", "others"),
    MotorReading: ("torque",),
}
EXTENSIVE_SUMS = ("mass_over_eta", "drag_area_over_eta", "p_aux")


class Similarity:
    """Conversion of a vehicle to the car that it is learned as, and back.

    Attributes:
        car: the similar car.
        size: energy of the vehicle over that of this car.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """See `Vehicle.similar_car`; nothing changes for a vehicle of size 1."""
        self._vehicle, self.car, self.size = vehicle, vehicle.similar_car, vehicle.relative_size
        self._states = np.full(SIZE, self.size)  # vehicle over car
        self._states[[state for state in State if state.unit.startswith("1")]] = 1.0

    def block(self, block: Block) -> Block:
        """Readings of the vehicle, scaled to the car."""
        if self.size == 1.0:
            return block
        for kind, names in EXTENSIVE_FIELDS.items():
            if kind in block.rows:
                rows = block.rows[kind]
                values = rows.values.copy()
                values[[FIELDS[kind].index(name) for name in names]] *= 1.0 / self.size
                block = block.with_rows(kind, rows._replace(values=values))
        return block

    @overload
    def estimate(self, estimate: PowerEstimate) -> PowerEstimate: ...

    @overload
    def estimate(self, estimate: ParameterSet) -> ParameterSet: ...

    def estimate(self, estimate: PowerEstimate | ParameterSet) -> PowerEstimate | ParameterSet:
        """An estimate of the car, scaled to the vehicle."""
        if isinstance(estimate, PowerEstimate):
            return _scaled(estimate, self.size, "power", "sigma", "energy", "energy_sigma")
        if self.size == 1.0:
            return estimate
        parameters = dict(estimate.parameters)
        for name in EXTENSIVE:
            parameters[name] = _scaled(
                parameters[name], self.size, "value", "std", "lower", "upper"
            )
        return replace(
            estimate,
            parameters=parameters,
            identifiable=_scaled(estimate.identifiable, self.size, *EXTENSIVE_SUMS),
            identifiable_std=_scaled(estimate.identifiable_std, self.size, *EXTENSIVE_SUMS),
        )

    def model(self, model: CarModel) -> CarModel:
        """The model of the car, scaled to the vehicle."""
        if self.size == 1.0:
            return model
        return replace(
            _scaled(model, self.size**2, "noise", "load_variance"),
            equation=equation_of(self._vehicle, model.equation.seed),
            mean=self._states * model.mean,
            covariance=np.outer(self._states, self._states) * model.covariance,
            record=_scaled(model.record, self.size, "measured", "learned", "file"),
        )

    def breakdowns(self, breakdowns: Breakdowns) -> Breakdowns:
        """Breakdowns of the car, scaled to the vehicle."""
        drives = (_scaled(parts, self.size, "measured") for parts in breakdowns.drives)
        square = self.size**2
        return Breakdowns(
            self.size * breakdowns.energy,
            square * breakdowns.covariance,
            tuple(_scaled(parts, square, "measured_variance", "noise") for parts in drives),
        )

    def report(self, report: LearnerReport) -> LearnerReport:
        """A report on the car, with the change of payload scaled to the vehicle."""
        change = report.payload_change
        if change is None:
            return report
        return report._replace(payload_change=_scaled(change, self.size, "delta_mass", "std"))


def _scaled(value: Value, size: float, *fields: str) -> Value:
    """A dataclass or named tuple with some of its numbers times a size."""
    if size == 1.0 or not fields:
        return value
    record: Any = value
    numbers = {name: size * getattr(record, name) for name in fields}
    changed: Value = (
        record._replace(**numbers) if isinstance(value, tuple) else replace(record, **numbers)
    )
    return changed


def model_of_file(vehicle: Vehicle, seed: int = 0) -> CarModel:
    """The model of a vehicle file, before anything is learned."""
    similarity = Similarity(vehicle)
    equation = equation_of(similarity.car, seed)
    return similarity.model(initial_state(equation).model(equation))
