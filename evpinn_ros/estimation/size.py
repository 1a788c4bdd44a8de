"""Vehicles of another size than a passenger car: learned as the car that is similar to them.

The one equation (`estimation.terms`) is linear in energy: with mass, drag area and loads times k
the energy of the same driving is k times as much. So what is known of cars in W, N, J and kg (the
priors of loads, noise, the thresholds of detectors) holds for a robot of 60 kg as well, once its
energies are taken times the mass of a car over its own. `Similarity` does that at both ends of the
estimator: readings on the way in, estimates on the way out. What lies between knows cars alone.
Speeds and accelerations stay as they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import overload

import numpy as np

from evpinn_ros.estimation.breakdown import Breakdowns, Totals
from evpinn_ros.estimation.car_model import CarModel
from evpinn_ros.estimation.estimate import ParameterEstimate, ParameterSet, PowerEstimate
from evpinn_ros.estimation.learner import LearnerReport
from evpinn_ros.estimation.posterior import initial_state
from evpinn_ros.estimation.states import SIZE, State
from evpinn_ros.estimation.terms import equation_of
from evpinn_ros.signals.readings import AuxiliaryReading, BatteryReading, MotorReading, Reading
from evpinn_ros.vehicle.files import EXTENSIVE, Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable

PURE = ("1", "1/(10 K)")  # units of states that are the same of all sizes
EXTENSIVE_SUMS = ("mass_over_eta", "drag_area_over_eta", "p_aux")


class Similarity:
    """Way from a vehicle to the car that it is learned as, and back.

    Attributes:
        car: the similar car.
        size: energy of the vehicle over that of this car.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """See `Vehicle.similar_car`; nothing changes for a vehicle of size 1."""
        self._vehicle, self.car, self.size = vehicle, vehicle.similar_car, vehicle.relative_size
        self._states = np.full(SIZE, self.size)  # vehicle over car
        self._states[[state for state in State if state.unit in PURE]] = 1.0

    def reading(self, reading: Reading) -> Reading:
        """A reading of the vehicle as the car would have given it."""
        if self.size == 1.0:
            return reading
        more = 1.0 / self.size
        match reading:
            case BatteryReading():
                current, coarse = more * reading.current, more * reading.power_std
                return replace(reading, current=current, power_std=coarse)
            case AuxiliaryReading():
                heating, others = more * reading.heating, more * reading.others
                return replace(reading, heating=heating, others=others)
            case MotorReading():
                return replace(reading, torque=more * reading.torque)
        return reading

    @overload
    def estimate(self, found: PowerEstimate) -> PowerEstimate: ...

    @overload
    def estimate(self, found: ParameterSet) -> ParameterSet: ...

    def estimate(self, found: PowerEstimate | ParameterSet) -> PowerEstimate | ParameterSet:
        """An estimate of the car as one of the vehicle."""
        if self.size == 1.0:
            return found
        if isinstance(found, PowerEstimate):
            power, sigma = self.size * found.power, self.size * found.sigma
            energy, spread = self.size * found.energy, self.size * found.energy_sigma
            return replace(found, power=power, sigma=sigma, energy=energy, energy_sigma=spread)
        parameters = dict(found.parameters)
        for name in EXTENSIVE:
            parameters[name] = self._parameter(parameters[name])
        return replace(
            found,
            parameters=parameters,
            identifiable=self._combinations(found.identifiable),
            identifiable_std=self._combinations(found.identifiable_std),
        )

    def model(self, found: CarModel) -> CarModel:
        """The car as forecasts take it, with the equation of the vehicle."""
        if self.size == 1.0:
            return found
        square, uneven = self.size**2, found.unevenness
        return replace(
            found,
            equation=equation_of(self._vehicle, found.equation.seed),
            mean=self._states * found.mean,
            covariance=np.outer(self._states, self._states) * found.covariance,
            noise=square * found.noise,
            load_variance=square * found.load_variance,
            unevenness=replace(uneven, rows=self.size / self._states * uneven.rows),
        )

    def breakdowns(self, found: Breakdowns) -> Breakdowns:
        """Energies of drives by part."""
        return Breakdowns(
            self.size * found.energy,
            self.size**2 * found.covariance,
            tuple(self._totals(each) for each in found.drives),
        )

    def report(self, found: LearnerReport) -> LearnerReport:
        """Changes of payload, in kg of the vehicle."""
        change = found.payload_change
        if change is None:
            return found
        mass, std = self.size * change.delta_mass, self.size * change.std
        return found._replace(payload_change=replace(change, delta_mass=mass, std=std))

    def _parameter(self, found: ParameterEstimate) -> ParameterEstimate:
        scaled = {
            field: self.size * getattr(found, field)
            for field in ("value", "std", "lower", "upper")
        }
        return replace(found, **scaled)

    def _combinations(self, found: Identifiable) -> Identifiable:
        scaled = {name: self.size * getattr(found, name) for name in EXTENSIVE_SUMS}
        return found._replace(**scaled)

    def _totals(self, totals: Totals) -> Totals:
        return replace(
            totals,
            measured=self.size * totals.measured,
            measured_variance=self.size**2 * totals.measured_variance,
            noise=self.size**2 * totals.noise,
        )


def model_of_file(vehicle: Vehicle, seed: int = 0) -> CarModel:
    """The car of a vehicle file, of which nothing was learned yet."""
    similarity = Similarity(vehicle)
    equation = equation_of(similarity.car, seed)
    return similarity.model(initial_state(equation).model(equation))
