"""Compares the measured energy of parts of a drive with forecasts made at their start."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.core.energy.driven import drive_plan
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import PlanError
from evpinn_ros.core.energy.power_model import PowerModel, Weather, combined_model, vehicle_model
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.driven import charged
from evpinn_ros.replays.history import Drive, KnownModel
from evpinn_ros.replays.scoring import Span, longest_step, measured_energy

SHORTEST = 30.0  # s, shortest part of a drive with a forecast


class ForecastOutcome(NamedTuple):
    """A part of a drive: measured energy, and the forecast at its start, J."""

    span: Span
    measured: float
    forecast: float
    sigma: float

    @property
    def covered(self) -> bool:
        """Whether the 90 % band of the forecast contains the measured energy."""
        return abs(self.forecast - self.measured) <= GAUSSIAN_QUANTILE * self.sigma


def forecast_outcomes(drive: Drive) -> list[ForecastOutcome]:
    """Outcomes of the parts of a drive, each forecast by the model known at its start."""
    ends = [*(known.time for known in drive.models), drive.duration][1:]
    outcomes = (
        forecast_outcome(drive, known, end) for known, end in zip(drive.models, ends, strict=False)
    )
    return [outcome for outcome in outcomes if outcome is not None]


def forecast_outcome(drive: Drive, known: KnownModel, end: float) -> ForecastOutcome | None:
    """The drive from a model up to `end`, s, as a plan; None if short, charged or with gaps."""
    span = Span(known.time, end)
    speed = _inside(drive.speed, span)
    battery = _inside(drive.measured, span)
    if end - known.time < SHORTEST or not (_whole(speed, span) and _whole(battery, span)):
        return None
    if charged(drive, span):
        return None
    try:
        plan = drive_plan(speed, _inside(drive.altitude, span))
    except PlanError:
        return None
    driven = Span(float(speed[0, 0]), float(speed[0, 0] + plan.time[-1]))
    model = PowerModel(known.model)
    result = forecast_plan(plan, model, Weather(model.density()))
    measured = measured_energy(drive, [driven])
    return ForecastOutcome(span, measured, float(result.energy[-1]), float(result.sigma[-1]))


def known_model(
    car: CarModel | None, parameters: ParameterSet | None, vehicle: Vehicle
) -> PowerModel:
    """The best available model: of the learner, of its parameters, or of the vehicle file."""
    if car is not None:
        return PowerModel(car)
    if parameters is None:
        return vehicle_model(vehicle)
    return combined_model(parameters.identifiable, parameters.identifiable_std, vehicle)


def _inside(rows: np.ndarray, span: Span) -> np.ndarray:
    inside: np.ndarray = rows[span.holds(rows[:, 0])]
    ordered: np.ndarray = inside[np.argsort(inside[:, 0], kind="stable")]
    return ordered


def _whole(rows: np.ndarray, span: Span) -> bool:
    times = np.concatenate(([span.begin], rows[:, 0], [span.end]))
    return len(rows) > 1 and bool(np.diff(times).max() <= longest_step(rows[:, 0]))
