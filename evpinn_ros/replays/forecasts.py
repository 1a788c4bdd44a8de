"""Forecast against outcome: parts of a drive as plans, by the car as it was known before each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from evpinn_ros.energy.forecast import forecast_plan
from evpinn_ros.energy.plan import Plan, PlanError, plan_from_speed_profile
from evpinn_ros.energy.power_model import (
    PowerModel,
    Weather,
    combined_model,
    vehicle_model,
)
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.estimate import ParameterSet
from evpinn_ros.estimation.posterior import CarModel
from evpinn_ros.replays.driven import charged
from evpinn_ros.replays.history import Drive, KnownModel
from evpinn_ros.replays.scoring import Span, longest_step, measured_energy
from evpinn_ros.vehicle.files import Vehicle

PLAN_STEP = 1.0  # s between points of a plan
ELEVATION_STEP = 5.0  # m
ELEVATION_SMOOTHING = 50.0  # m, 1-sigma: a logged altitude comes in steps of a metre
SHORTEST = 30.0  # s of a part of a drive that is worth a forecast


class ForecastOutcome(NamedTuple):
    """A part of a drive: energy measured, and as it was forecast at its begin, J."""

    span: Span
    measured: float
    forecast: float
    sigma: float

    @property
    def covered(self) -> bool:
        """True if the 90 % band of the forecast holds what was measured."""
        return abs(self.forecast - self.measured) <= GAUSSIAN_QUANTILE * self.sigma


def forecast_outcomes(drive: Drive, air_density: float) -> list[ForecastOutcome]:
    """The drive from model to model, each part forecast by the model of its begin."""
    ends = [*(known.time for known in drive.models), drive.duration][1:]
    found = (
        forecast_outcome(drive, known, end, air_density)
        for known, end in zip(drive.models, ends, strict=False)
    )
    return [one for one in found if one is not None]


def forecast_outcome(
    drive: Drive, known: KnownModel, end: float, air_density: float
) -> ForecastOutcome | None:
    """The drive up to `end`, s, as a plan that was driven to the letter.

    None where it cannot be compared: it is short, speed or battery has a gap in it, or the car was
    charged, which is no plan's.
    """
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
    result = forecast_plan(plan, PowerModel(known.model), Weather(air_density))
    measured = measured_energy(drive, [driven])
    return ForecastOutcome(span, measured, float(result.energy[-1]), float(result.sigma[-1]))


def drive_plan(speed: np.ndarray, altitude: np.ndarray) -> Plan:
    """The plan that a drive would have been: speed once a second, and elevation.

    Args:
        speed: time, s, rising, and m/s, shape (n, 2), some seconds long.
        altitude: time, s, and m, shape (m, 2); empty for a flat road.
    """
    time, speeds = speed[:, 0] - speed[0, 0], speed[:, 1]
    grid = np.arange(0.0, time[-1], PLAN_STEP)
    at = np.maximum(np.interp(grid, time, speeds), 0.0)
    # Distance as the plan's speeds make it, so that both agree.
    distance = np.concatenate(([0.0], np.cumsum(np.diff(grid) * (at[1:] + at[:-1]) / 2)))
    if not len(altitude):
        return plan_from_speed_profile(grid, distance, at)
    travelled = np.concatenate(([0.0], np.cumsum(np.diff(time) * (speeds[1:] + speeds[:-1]) / 2)))
    road = np.arange(0.0, travelled[-1] + ELEVATION_STEP, ELEVATION_STEP)
    seen = np.interp(altitude[:, 0] - speed[0, 0], time, travelled)
    first = np.concatenate(([True], np.diff(seen) > 0))
    smooth = gaussian_filter1d(
        np.interp(road, seen[first], altitude[first, 1]), ELEVATION_SMOOTHING / ELEVATION_STEP
    )
    return plan_from_speed_profile(grid, distance, at, np.interp(distance, road, smooth))


def known_model(
    car: CarModel | None, parameters: ParameterSet | None, vehicle: Vehicle
) -> PowerModel:
    """The best model there is: of the learner, of its parameters, of the vehicle file."""
    if car is not None:
        return PowerModel(car)
    if parameters is None:
        return vehicle_model(vehicle)
    return combined_model(parameters.identifiable, parameters.identifiable_std, vehicle)


def _inside(rows: np.ndarray, span: Span) -> np.ndarray:
    """Rows of a series within a span, by time."""
    inside: np.ndarray = rows[span.holds(rows[:, 0])]
    ordered: np.ndarray = inside[np.argsort(inside[:, 0], kind="stable")]
    return ordered


def _whole(rows: np.ndarray, span: Span) -> bool:
    """True if a series has no gap anywhere in the span."""
    times = np.concatenate(([span.begin], rows[:, 0], [span.end]))
    return len(rows) > 1 and bool(np.diff(times).max() <= longest_step(rows[:, 0]))
