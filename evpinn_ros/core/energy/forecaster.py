"""Answers plans by the newest model of the car and its battery."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.core.energy.forecast import Air, Forecast, PlanBasis, forecast_plan, is_steady
from evpinn_ros.core.energy.plan import UNNAMED, UNSAID, Plan, PlanConditions, Question
from evpinn_ros.core.energy.plausible import car_is_possible
from evpinn_ros.core.energy.power_model import PlanEnd, PowerModel, combined_model, vehicle_model
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    PressureReading,
    TemperatureReading,
    WindReading,
)
from evpinn_ros.core.signals.road import WIND_STALE_AFTER
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import Identifiable

MOST_POINTS_TOGETHER = 100_000  # of all plans that are kept for comparisons


STALE_AFTER = Air(1800.0, 1800.0, WIND_STALE_AFTER)
"""Age of each value, s, after which it counts as unknown."""


@dataclass(frozen=True, slots=True)
class PlanAnswer:
    """The forecast of a plan; state of charge, 0..1, and voltage, V or NaN, at its end.

    Attributes:
        forecast: of the plan.
        charge: state of charge at its end, 0..1.
        voltage: at its end, V or NaN.
        differences: its energy less that of each plan asked together with it, by name, J.
        conditions: names of the conditions that a planner gave.
        assumed: conditions that the forecast used, by name, without unknown ones.
    """

    forecast: Forecast
    charge: Uncertain
    voltage: float
    differences: Mapping[str, Uncertain]
    conditions: tuple[str, ...] = ()
    assumed: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class PlanLog:
    """Counts of plans, and the outcome of the last.

    Attributes:
        answered: number of answered plans.
        refused: number of refused plans.
        problem: why the last plan was refused, None if it was answered.
        charge_after: state of charge, 0..1, at the end of the last answered plan.
    """

    answered: int = 0
    refused: int = 0
    problem: str | None = None
    charge_after: Uncertain = UNKNOWN

    def answer(self, charge: Uncertain) -> None:
        """Count a plan that was answered, with the state of charge at its end."""
        self.answered, self.problem, self.charge_after = self.answered + 1, None, charge

    def refuse(self, reason: str) -> None:
        """Count a plan that was refused."""
        self.refused, self.problem = self.refused + 1, reason


class Basis(str, Enum):
    """Basis of forecasts: the vehicle file, or a topic."""

    VEHICLE_FILE = "vehicle file"
    COMBINATIONS = "estimate/identifiable"
    MODEL = "estimate/model"


class Forecaster:
    """Holds the model of the car, air and conditions, and answers plans with them.

    Attributes:
        basis: source of the model.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Start from the vehicle's priors."""
        self._vehicle = vehicle
        self.reset()

    def reset(self) -> None:
        """Return to the vehicle file, without air, conditions and plans."""
        self.basis = Basis.VEHICLE_FILE
        self._model = vehicle_model(self._vehicle)
        self._air: dict[str, tuple[float, int]] = {}  # value and time of receipt, ns, by name
        self._conditions = UNSAID
        self._together: Hashable = None
        self._others: dict[str, tuple[Plan, PlanEnd]] = {}
        self._compared_with: object = None

    def set_identifiable(self, combined: Identifiable, sigmas: Identifiable) -> None:
        """Take identifiable combinations and their 1-sigma; ignored once there is a model.

        Raises:
            ValueError: the car is impossible; the model stays.
        """
        if self.basis is Basis.MODEL:
            return
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow is refused below
            given = combined_model(combined, sigmas, self._vehicle)
            possible = car_is_possible(given.car)
        if not possible:
            raise ValueError("out_of_range")
        self._model, self.basis = given, Basis.COMBINATIONS

    def set_model(self, car: CarModel) -> None:
        """Take the model of the car's power."""
        self._model, self.basis = PowerModel(car), Basis.MODEL

    def set_air(
        self, reading: TemperatureReading | PressureReading | WindReading, now_ns: int
    ) -> None:
        """Take a reading of the air, received at `now_ns`."""
        for name in Air._fields:
            if hasattr(reading, name):
                self._air[name] = getattr(reading, name), now_ns

    def set_conditions(self, conditions: PlanConditions) -> None:
        """Replace the conditions of all later plans."""
        self._conditions = conditions

    def air(self, now_ns: int) -> Air:
        """Values of the air that are not stale; a clock that goes back makes none younger."""
        fresh = {
            name: value
            for name, (value, received_ns) in self._air.items()
            if abs(now_ns - received_ns) <= getattr(STALE_AFTER, name) * NANOSECONDS
        }
        return Air(**fresh)

    def answer(
        self,
        plan: Plan,
        charge: Uncertain,
        capacity: Uncertain,
        now_ns: int,
        battery: BatteryModel,
        asked: Question = UNNAMED,
    ) -> PlanAnswer:
        """The energy of a plan, and the battery at its end.

        Args:
            plan: one trip.
            charge: state of charge now, 0..1.
            capacity: energy of the full battery, J.
            now_ns: by the clock of `set_air`.
            battery: predicts its end better than the capacity, once it has learned enough.
            asked: the question; conditions that it leaves out are those of `set_conditions`.

        Raises:
            PlanError: there is no finite answer.
        """
        given = asked.conditions.or_else(self._conditions)
        basis = PlanBasis.of(self._model, given, self.air(now_ns))
        charge = given.charge_from(charge)
        result = forecast_plan(plan, *basis, along=asked.along)
        differences = self._compare(asked, plan, result.end, basis)
        celsius = basis.weather.celsius
        taken = {
            "temperature": self._model.car.celsius if celsius is None else celsius,
            "heating": given.heating,
            "head_wind": basis.head_wind,
            "payload": given.payload or 0.0,
            "charge": charge.value if charge.known else None,
            "stood": given.stood,
            "prewarmed": given.prewarmed or 0.0,
            "steady": float(is_steady(plan, basis.steady)),
        }
        assumed = {name: value for name, value in taken.items() if value is not None}
        end = battery.after(result.on_curve, charge, capacity)
        return PlanAnswer(result, *end, differences, given.given, assumed)

    def _compare(
        self, asked: Question, plan: Plan, end: PlanEnd, basis: PlanBasis
    ) -> dict[str, Uncertain]:
        """Energy of a plan less that of each plan asked together with it, by name, J."""
        if asked.together is None or asked.together != self._together:
            self._together, self._others = asked.together, {}
        if basis != self._compared_with:  # the others were answered on another basis
            self._compared_with = basis
            for name, (other, _) in self._others.items():
                self._others[name] = other, forecast_plan(other, *basis, along=False).end
        differences = {
            name: basis.model.difference(end, other)
            for name, (_, other) in self._others.items()
            if name != asked.name
        }
        points = sum(other.time.size for other, _ in self._others.values())
        if asked.together is not None and points + plan.time.size <= MOST_POINTS_TOGETHER:
            self._others[asked.name] = plan, end
        return differences
