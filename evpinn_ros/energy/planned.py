"""A planned trip with its energy, and with what it would take driven otherwise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.energy.charge import ChargeGauge, Uncertain
from evpinn_ros.energy.forecast import Forecast
from evpinn_ros.energy.plan import Legs, Plan
from evpinn_ros.energy.power_model import PowerModel, Weather


class PlannedEnergy(NamedTuple):
    """Energy of a plan.

    Attributes:
        given: the plan as it was given.
        weather: on the way.
        trip: its points.
        found: its energy.
        charge: state of charge at each point, 0..1, and its 1-sigma, shape (2, n); NaN where
            unknown, below 0 where the battery is empty before.
        model: the car that it was found with.
        gauge: what is known of its battery.
    """

    given: Plan | Legs
    weather: Weather
    trip: Plan
    found: Forecast
    charge: np.ndarray
    model: PowerModel
    gauge: ChargeGauge


class Change(NamedTuple):
    """A trip driven otherwise: what, the energy it takes more, J, and the time, s."""

    words: str
    energy: Uncertain
    seconds: float
