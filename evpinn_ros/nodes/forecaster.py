"""Answers plans from the newest that is known of the car and its battery; knows no ROS."""

from __future__ import annotations

from dataclasses import dataclass
import math

from evpinn_ros.energy.forecast import Forecast, battery_after, forecast
from evpinn_ros.energy.plan import Plan
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable, identifiable

FIRST_RESIDUAL = 3000.0  # W, 1-sigma of power around the physics before any was seen
RESIDUAL_MEMORY = 300.0  # samples of power/smoothed over which that is averaged


@dataclass(frozen=True, slots=True)
class Answer:
    """The forecast of a plan, and the state of charge at its end, None while it is unknown."""

    forecast: Forecast
    state_of_charge: float | None


class Forecaster:
    """Holds what forecasts need.

    Attributes:
        learned: whether the car's combinations come from an estimate.
        state_of_charge: newest known, 0..1, NaN before.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Start from the vehicle's priors."""
        self._vehicle = vehicle
        self.reset()

    def reset(self) -> None:
        """Forget all that was heard."""
        self.learned = False
        self.state_of_charge = math.nan
        self._combined, self._sigmas = prior_identifiable(self._vehicle)
        self._residual_variance = FIRST_RESIDUAL**2

    def hear_identifiable(self, combined: Identifiable, sigmas: Identifiable) -> None:
        """Take an estimate of the car and its 1-sigma."""
        self._combined, self._sigmas, self.learned = combined, sigmas, True

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
        result = forecast(
            plan,
            self._combined,
            self._sigmas,
            self._vehicle,
            math.sqrt(self._residual_variance),
        )
        capacity = self._vehicle.battery_capacity
        return Answer(result, battery_after(result, self.state_of_charge, capacity))


def prior_identifiable(vehicle: Vehicle) -> tuple[Identifiable, Identifiable]:
    """The combinations of the vehicle's priors, and their 1-sigma to first order.

    Relative variances of products and quotients of independent quantities add up.
    """
    combined = identifiable(vehicle.initial, vehicle.frontal_area)
    relative = {
        name: prior.std / prior.value if prior.value else 0.0
        for name, prior in vehicle.priors.items()
    }
    sigmas = Identifiable(
        mass_over_eta=combined.mass_over_eta * math.hypot(relative["mass"], relative["eta"]),
        drag_area_over_eta=combined.drag_area_over_eta
        * math.hypot(relative["c_d"], relative["eta"]),
        c_rr=vehicle.priors["c_rr"].std,
        regeneration=combined.regeneration * math.hypot(relative["eta"], relative["mu"]),
        p_aux=vehicle.priors["p_aux"].std,
    )
    return combined, sigmas
