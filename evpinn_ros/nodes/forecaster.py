"""Answers plans from the newest that is known of the car and its battery; knows no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
import math

from evpinn_ros.energy.forecast import FIRST_RESIDUAL, Forecast, battery_after, forecast_plan
from evpinn_ros.energy.plan import Plan
from evpinn_ros.energy.power_model import PowerModel, combined_model, prior_identifiable
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable
from evpinn_ros.vehicle.linear_power import LinearPower

RESIDUAL_MEMORY = 300.0  # samples of power/smoothed over which that is averaged


@dataclass(frozen=True, slots=True)
class Answer:
    """The forecast of a plan, and the state of charge at its end, None while it is unknown."""

    forecast: Forecast
    state_of_charge: float | None


class Basis(str, Enum):
    """What forecasts rest on, and where it was heard; each is better than those before."""

    VEHICLE_FILE = "vehicle file"
    COMBINATIONS = "estimate/identifiable"
    MODEL = "estimate/model"


class Forecaster:
    """Holds what forecasts need.

    Attributes:
        basis: what they rest on.
        state_of_charge: newest known, 0..1, NaN before.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Start from the vehicle's priors."""
        self._vehicle = vehicle
        self.reset()

    def reset(self) -> None:
        """Forget all that was heard."""
        self.basis = Basis.VEHICLE_FILE
        self.state_of_charge = math.nan
        self._combined, self._sigmas = prior_identifiable(self._vehicle)
        self._model: PowerModel | None = None
        self._residual_variance = FIRST_RESIDUAL**2

    def hear_identifiable(self, combined: Identifiable, sigmas: Identifiable) -> None:
        """Take an estimate of the car and its 1-sigma."""
        self._combined, self._sigmas = combined, sigmas
        if self._model is None:
            self.basis = Basis.COMBINATIONS

    def hear_model(self, model: LinearPower) -> None:
        """Take all that is known of the car's power."""
        self._model, self.basis = PowerModel(model), Basis.MODEL

    def hear_battery(self, state_of_charge: float) -> None:
        """Take a state of charge; one that is NaN says nothing."""
        if math.isfinite(state_of_charge):
            self.state_of_charge = state_of_charge

    def hear_sigma(self, sigma: float) -> None:
        """Take the 1-sigma of one prediction of power, W; its mean square is what plans get."""
        if math.isfinite(sigma):
            self._residual_variance += (sigma**2 - self._residual_variance) / RESIDUAL_MEMORY

    def answer(self, plan: Plan) -> Answer:
        """The energy a plan takes."""
        result = forecast_plan(plan, self._model or self._simple(), self._vehicle.air_density)
        capacity = self._vehicle.battery_capacity
        return Answer(result, battery_after(result, self.state_of_charge, capacity))

    def _simple(self) -> PowerModel:
        residual = math.sqrt(self._residual_variance)
        return combined_model(self._combined, self._sigmas, self._vehicle, residual)
