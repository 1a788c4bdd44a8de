"""Energy of a plan from Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd

from evpinn_ros.common.errors import InputError
from evpinn_ros.energy.forecast import FIRST_RESIDUAL, forecast_plan
from evpinn_ros.energy.plan import Plan, plan_from_speed_profile
from evpinn_ros.energy.power_model import PowerModel, vehicle_model
from evpinn_ros.signals.road import MAX_WIND
from evpinn_ros.vehicle.files import Vehicle, load_vehicle

AIR_DENSITIES = (0.3, 2.0)  # kg/m^3, from the highest road to an arctic winter


class KnownCar(Protocol):
    """A car with what is known of it: a `Result` or an `Estimator`."""

    @property
    def vehicle(self) -> Vehicle:
        """The car."""

    @property
    def model(self) -> PowerModel:
        """The car as it is known now."""


def forecast(
    plan: pd.DataFrame | Mapping[str, Any] | Plan,
    car: str | Path | Vehicle | KnownCar = "generic",
    *,
    air_density: float | None = None,
    head_wind: float = 0.0,
) -> pd.DataFrame:
    """Energy that a plan will take, and how sure that is.

    Example:
        >>> import evpinn_ros as ev
        >>> plan = {"t_s": [0.0, 10.0, 290.0, 300.0], "speed_mps": [0.0, 20.0, 20.0, 0.0]}
        >>> found = ev.forecast(plan, "bmw_i3")
        >>> list(found.columns)
        ['distance_m', 'speed_mps', 'elevation_m', 'power_w', 'energy_j', 'sigma_j']

    Args:
        plan: columns `t_s` (or the index), s, and `speed_mps`, m/s; `distance_m`, else as the
            speeds make it; `elevation_m`, else a flat road.
        car: a vehicle, by name or file, of which nothing was learned yet; or the `Result` or
            `Estimator` that learned it.
        air_density: kg/m^3, the vehicle's if not given.
        head_wind: against the car, m/s over ground.

    Returns:
        A row a point, by `t_s` since the first: what was planned, power (with the acceleration
        and slope that follow), energy since the first point, and the 1-sigma of that energy.

    Raises:
        InputError: a column is missing, no such vehicle, or (`PlanError`) the plan is no trip.
    """
    if isinstance(car, str | Path | Vehicle):
        vehicle = car if isinstance(car, Vehicle) else load_vehicle(car)
        model = vehicle_model(vehicle, FIRST_RESIDUAL)
    else:
        vehicle, model = car.vehicle, car.model
    trip = plan if isinstance(plan, Plan) else _trip(plan)
    density = vehicle.air_density if air_density is None else air_density
    if not (AIR_DENSITIES[0] <= density <= AIR_DENSITIES[1] and abs(head_wind) <= MAX_WIND):
        raise InputError(f"no air: {density:g} kg/m^3, {head_wind:g} m/s of wind")
    found = forecast_plan(trip, model, density, head_wind)
    columns = {
        "distance_m": trip.distance,
        "speed_mps": trip.speed,
        "elevation_m": trip.elevation,
        "power_w": found.power,
        "energy_j": found.energy,
        "sigma_j": found.sigma,
    }
    return pd.DataFrame(columns, index=pd.Index(found.time, name="t_s"))


def _trip(plan: pd.DataFrame | Mapping[str, Any]) -> Plan:
    if isinstance(plan, pd.DataFrame) and plan.index.name == "t_s":
        plan = plan.reset_index()
    missing = [name for name in ("t_s", "speed_mps") if name not in plan]
    if missing:
        raise InputError(f"the plan has no column {' and '.join(missing)}")
    names = ("t_s", "speed_mps", "distance_m", "elevation_m")
    try:
        given = {
            name: np.atleast_1d(np.asarray(plan[name], float)) for name in names if name in plan
        }
    except (TypeError, ValueError) as error:
        raise InputError(f"the plan holds what is no number: {error}") from error
    time, speed = given["t_s"], given["speed_mps"]
    if "distance_m" not in given and time.shape == speed.shape:
        legs = np.diff(time) * (speed[1:] + speed[:-1]) / 2
        given["distance_m"] = np.concatenate(([0.0], np.cumsum(legs)))
    distance = given.get("distance_m", time)
    return plan_from_speed_profile(time, distance, speed, given.get("elevation_m"))
