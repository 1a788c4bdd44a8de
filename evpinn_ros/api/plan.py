"""Energy of a plan from Python."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
import math
import os
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import pandas as pd

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.drives.text_table import TextTable
from evpinn_ros.energy.account import EnergyAccount
from evpinn_ros.energy.charge import FIRST_STEP, UNKNOWN, ChargeGauge, Uncertain
from evpinn_ros.energy.forecast import FIRST_RESIDUAL, Forecast, battery_along, forecast_plan
from evpinn_ros.energy.plan import MAX_POINTS, Plan, plan_from_speed_profile
from evpinn_ros.energy.power_model import PowerModel, vehicle_model
from evpinn_ros.signals.road import MAX_WIND
from evpinn_ros.vehicle.files import Vehicle, load_vehicle

AIR_DENSITIES = (0.3, 2.0)  # kg/m^3, from the highest road to an arctic winter
LONGEST_NUMBER = 40  # characters
FEW = 8  # names that an error lists
NEEDED, OPTIONAL = ("t_s", "speed_mps"), ("distance_m", "elevation_m")


class KnownCar(Protocol):
    """A car with what is known of it: a `Result` or an `Estimator`."""

    @property
    def vehicle(self) -> Vehicle:
        """The car."""

    @property
    def model(self) -> PowerModel:
        """The car as it is known now."""

    @property
    def account(self) -> EnergyAccount:
        """Its energy, with what is known of its battery."""


class PlannedEnergy(NamedTuple):
    """Energy of a plan.

    Attributes:
        trip: the plan.
        found: its energy.
        charge: state of charge at each point, 0..1, and its 1-sigma, shape (2, n); NaN where
            unknown, below 0 where the battery is empty before.
        model: the car that it was found with.
        gauge: what is known of its battery.
    """

    trip: Plan
    found: Forecast
    charge: np.ndarray
    model: PowerModel
    gauge: ChargeGauge


def forecast(
    plan: pd.DataFrame | Mapping[str, Any] | str | os.PathLike[str] | Plan,
    car: str | Path | Vehicle | KnownCar = "generic",
    *,
    charge_pct: float | None = None,
    air_density: float | None = None,
    head_wind: float = 0.0,
) -> pd.DataFrame:
    """Energy that a plan will take, what it leaves in the battery, and how sure that is.

    Example:
        >>> import evpinn_ros as ev
        >>> plan = {"t_s": [0.0, 10.0, 290.0, 300.0], "speed_mps": [0.0, 20.0, 20.0, 0.0]}
        >>> found = ev.forecast(plan, "bmw_i3", charge_pct=80.0)
        >>> print(*found.columns)
        distance_m speed_mps elevation_m power_w energy_j sigma_j charge_pct charge_sigma_pct

    Args:
        plan: columns `t_s` (or the index), s, and `speed_mps`, m/s; `distance_m`, else as the
            speeds make it; `elevation_m`, else a flat road. Or the CSV file of such a table.
        car: a vehicle, by name or file, of which nothing was learned yet; or the `Result` or
            `Estimator` that learned it.
        charge_pct: state of charge at the start, percent; if not given the last that the
            `Result` or `Estimator` saw.
        air_density: kg/m^3, the vehicle's if not given.
        head_wind: against the car, m/s over ground.

    Returns:
        A row a point, by `t_s` since the first: what was planned, power (with the acceleration
        and slope that follow), energy since the first point with its 1-sigma, and the state of
        charge, percent, with its own: NaN where that or the capacity is unknown, negative where
        the battery is empty before.

    Raises:
        InputError: a column is missing, no such vehicle, or (`PlanError`) the plan is no trip.
    """
    trip, found, charge, *_ = planned_energy(plan, car, charge_pct, air_density, head_wind)
    columns = {
        "distance_m": trip.distance,
        "speed_mps": trip.speed,
        "elevation_m": trip.elevation,
        "power_w": found.power,
        "energy_j": found.energy,
        "sigma_j": found.sigma,
        "charge_pct": 100 * charge[0],
        "charge_sigma_pct": 100 * charge[1],
    }
    return pd.DataFrame(columns, index=pd.Index(found.time, name="t_s"))


def planned_energy(
    plan: Any,
    car: Any,
    charge_pct: float | None = None,
    air_density: float | None = None,
    head_wind: float = 0.0,
) -> PlannedEnergy:
    """The basis of the table of `forecast`, whose arguments and errors are these."""
    charge = UNKNOWN
    if charge_pct is not None:
        if not 0.0 <= charge_pct <= 100.0:
            raise InputError(f"charge_pct is {charge_pct:g}, not 0 to 100")
        charge = Uncertain(charge_pct / 100, FIRST_STEP / math.sqrt(12))  # as a display rounds
    account = None
    if isinstance(car, str | Path | Vehicle):
        vehicle = car if isinstance(car, Vehicle) else load_vehicle(car)
        model = vehicle_model(vehicle, FIRST_RESIDUAL)
    elif hasattr(car, "account"):
        vehicle, model, account = car.vehicle, car.model, car.account
        charge = charge if charge.known else account.charge()
    else:
        raise InputError(f"a car is a vehicle, a Result or an Estimator, not {_kind(car)}")
    trip = plan if isinstance(plan, Plan) else _trip(plan)
    density = vehicle.air_density if air_density is None else air_density
    if not AIR_DENSITIES[0] <= density <= AIR_DENSITIES[1]:
        raise InputError(f"air_density is {density:g}, not {AIR_DENSITIES} kg/m^3")
    if not abs(head_wind) <= MAX_WIND:
        raise InputError(f"head_wind is {head_wind:g}, not -{MAX_WIND:g} to {MAX_WIND:g} m/s")
    found = forecast_plan(trip, model, density, head_wind)
    gauge = ChargeGauge(vehicle.battery_capacity) if account is None else account.gauge
    along = None if account is None else account.battery.along(found, charge)
    if along is None:
        along = battery_along(found, charge, gauge.capacity)
    return PlannedEnergy(trip, found, along, model, gauge)


def _trip(plan: Any) -> Plan:
    if isinstance(plan, str | os.PathLike):
        path = Path(plan)
        with as_input_error(path, InputError):
            return _trip(_read(path))
    if not isinstance(plan, pd.DataFrame | Mapping):
        raise InputError(f"a plan is a DataFrame, a dict or a CSV file, not {_kind(plan)}")
    if isinstance(plan, pd.DataFrame) and plan.index.name == "t_s":
        plan = plan.reset_index()
    for name in NEEDED:
        if name not in plan:
            there = ", ".join([*map(str, plan)][:FEW]) or "none"
            raise InputError(f"a plan has the columns {' and '.join(NEEDED)}; there are: {there}")
    given = {name: _numbers(name, plan[name]) for name in (*NEEDED, *OPTIONAL) if name in plan}
    time, speed = given["t_s"], given["speed_mps"]
    return plan_from_speed_profile(time, given.get("distance_m"), speed, given.get("elevation_m"))


def _numbers(name: str, values: Any) -> np.ndarray:
    found = np.atleast_1d(np.asarray(values))
    if found.dtype.kind in "mM":
        raise InputError(f"{name} holds dates; a plan's are seconds, as of dt.total_seconds()")
    with as_input_error(f"{name} holds what is no number", TypeError, ValueError):
        numbers = np.array(found.tolist(), float)
    if numbers.ndim > 1:
        raise InputError(f"{name} has the shape {numbers.shape}; a plan is one trip")
    return numbers


def _read(path: Path) -> dict[str, list[str]]:
    """The columns of a plan in a CSV file, of more points than a plan may have the first ones."""
    rows = TextTable(path, separator=",").rows()
    names = [name.strip() for name in next(rows, (0, [""]))[1]]
    if len(names) < 2:
        raise InputError("no table with commas and decimal points")
    known = {name: names.index(name) for name in (*NEEDED, *OPTIONAL) if name in names}
    if not set(NEEDED) <= set(known):
        return {name: [] for name in names}
    table: dict[str, list[str]] = {name: [] for name in known}
    for number, row in islice(rows, MAX_POINTS + 1):
        if len(row) <= max(known.values()):
            raise InputError(f"line {number} has {len(row)} cells, not {len(names)}")
        for name, place in known.items():
            table[name].append(row[place][:LONGEST_NUMBER].strip())
    return table


def _kind(value: Any) -> str:
    return "None" if value is None else type(value).__name__
