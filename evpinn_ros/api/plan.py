"""`forecast`: energy of plans; `edge_energies`: energy of the edges of a road network."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.optional import pandas
from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.core.energy import edges as energy_edges
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import UNKNOWN, ChargeGauge, Uncertain
from evpinn_ros.core.energy.forecast import (
    EMPTY,
    Change,
    Forecast,
    PlanBasis,
    PlannedEnergy,
    forecast_plan,
)
from evpinn_ros.core.energy.plan import (
    CONDITION_RANGES,
    LONGEST,
    MAX_POINTS,
    UNSAID,
    Legs,
    Plan,
    PlanConditions,
    PlanError,
    legs_of_trip,
    points_of,
)
from evpinn_ros.core.energy.power_model import PowerModel, vehicle_model
from evpinn_ros.core.estimation.terms import MILD_CELSIUS
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

TEMPERATURE_STEP = 10.0  # K, of `what_if`
LONG_ENOUGH, FULL_STEPS = 3.0, 3000  # multiple of the capacity that empties any battery; steps
FARTHEST = 3e6  # m; no car gets farther
ROUNDS = 20  # iterations of `until_empty`
CHARGES = ("charge_pct", "charge_sigma_pct")
TINY = 1e-9  # of a step; a remainder below it is rounding, and makes no row
AIR_DENSITIES = (0.3, 2.0)  # kg/m^3, from the highest road to an arctic winter


class KnownCar(Protocol):
    """A car with what is known of it: a `Result` or an `Estimator`."""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle file of the car."""

    @property
    def model(self) -> PowerModel:
        """The car as it is known now."""

    @property
    def next_model(self) -> PowerModel:
        """The car as it begins its next drive."""

    @property
    def account(self) -> EnergyAccount:
        """Its energy, with what is known of its battery."""


def forecast(
    plan: pd.DataFrame | pl.DataFrame | Mapping[str, Any] | str | os.PathLike[str] | Plan | Legs,
    car: str | Path | Vehicle | KnownCar = "generic",
    *,
    charge_pct: float | None = None,
    temperature_c: float | None = None,
    heating_w: float | None = None,
    head_wind: float | None = None,
    payload_kg: float | None = None,
    stood_h: float | None = None,
    prewarmed: bool = False,
    steady: bool | None = None,
    air_density: float | None = None,
    speed_kmh: float | None = None,
    every_m: float | None = None,
) -> pd.DataFrame:
    """Energy that a plan will take, and the charge along it, each with 1-sigma.

    Example:
        >>> import evpinn_ros as ev
        >>> plan = {"t_s": [0.0, 10.0, 290.0, 300.0], "speed_mps": [0.0, 20.0, 20.0, 0.0]}
        >>> energies = ev.forecast(plan, "bmw_i3", charge_pct=80.0)
        >>> print(*energies.columns)
        distance_m speed_mps elevation_m power_w energy_j sigma_j charge_pct charge_sigma_pct

    Args:
        plan: one of three. Speed over time: columns `t_s` (or the index), s, and `speed_mps`, m/s;
            optional `distance_m` (otherwise from the speeds), and `elevation_m` or `grade`
            (otherwise a flat road). Legs: columns with units in their names, two of `length_m`,
            `duration_s` and `speed_kmh`; optional `climb_m`, `grade`, or `start_elevation_m` and
            `end_elevation_m`. A warning names unused columns.
            Or the path of a file: such a table, a GPX or GeoJSON file, the JSON of a
            route service, or a recorded drive.
        car: name or file of a vehicle, or a `Vehicle`, of which nothing was learned; or the
            `Result` or `Estimator` that learned the car.
        charge_pct: state of charge at the start, percent; if not given, the last of the
            `Result` or `Estimator`.
        temperature_c: outside temperature, degrees Celsius; if not given, the last that the car
            measured.
        heating_w: power of heating and air conditioning, W; if not given, what the temperature
            makes likely.
        head_wind: head wind, m/s over ground.
        payload_kg: people and luggage in addition to those when the car was learned, kg.
        stood_h: hours since the last drive, in which tyres and cabin cool down; the plan starts a
            new drive. If not given, the plan continues the drive of a `Result` or `Estimator`;
            a car that has not driven yet starts cold.
        prewarmed: True if the cabin was heated or cooled before the start, while plugged in.
        steady: True: the car follows the planned speeds exactly. False: on lines and legs that
            last some seconds, it also speeds up and brakes as drivers usually do. If not given,
            True for recorded drives, and for paths and trajectories that a controller follows;
            otherwise False. Splitting a straight line or a leg changes nothing.
        air_density: kg/m^3; if not given, that of the vehicle file at the temperature outside.
        speed_kmh: speed on a track in a file without times and speeds, km/h.
        every_m: distance between the rows of the result, m; if not given, they are the points of
            the plan.

    Returns:
        One row for each point (and each 50 m of a track with heights), by `t_s`, s since the
        first: the plan; power, W (with the acceleration and slope that follow the point); energy
        since the first point, J, with its 1-sigma; and the state of charge, percent, with its
        1-sigma. The charge is NaN if it or the capacity is unknown, and 0 or less from where the
        battery would be empty.

    Raises:
        InputError: a column is missing, the vehicle does not exist, or the plan is invalid
            (`PlanError`).
    """
    given = PlanConditions(temperature_c, heating_w, head_wind, payload_kg)
    given = with_state(given, charge_pct, stood_h, prewarmed, steady)
    plan = as_plan(plan, known_car(car)[0], speed_kmh)
    planned = planned_energy(plan, car, given, air_density)
    time, columns = planned.rows if every_m is None else _grid(planned, every_m)
    pd = pandas()
    return pd.DataFrame(columns, index=pd.Index(time, name="t_s"))


def _grid(planned: PlannedEnergy, every: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """(times, s; columns) of a forecast every `every` m and at its end."""
    whole = planned.energies.on_curve
    if whole.curve is None or not whole.curve.distance[-1] > 0.0:
        return planned.rows  # the car stands
    along, length = whole.curve.distance, float(whole.curve.distance[-1])
    if not every > 0.0 or length > every * MAX_POINTS:
        raise PlanError(f"every {every:g} m of {length:.0f} m: at most {MAX_POINTS} rows")
    distance = np.append(np.arange(0.0, length - TINY * every, every), length)
    # Where the car stands, the row is that of its arrival.
    first = np.concatenate(([True], np.diff(along) > 0.0))
    time = np.interp(distance, along[first], whole.time[first])
    time[-1] = whole.time[-1]
    points, columns = planned.rows
    at = {name: np.interp(time, points, column) for name, column in columns.items()}
    if isinstance(planned.given, Legs):  # speeds of legs are means
        leg = np.clip(np.searchsorted(points, time, "right") - 1, 0, len(points) - 2)
        at["speed_mps"] = (planned.given.length / planned.given.duration)[leg]
    at["distance_m"] = distance
    for name, column in (("energy_j", whole.energy), ("sigma_j", whole.sigma)):
        at[name] = np.interp(time, whole.time, column)
    for name, column in zip(CHARGES, planned.course, strict=True):
        at[name] = np.interp(time, whole.time, 100.0 * column)
    power = np.diff(at["energy_j"]) / np.diff(time)
    at["power_w"] = np.append(power, power[-1:])
    return time, at


def with_state(
    given: PlanConditions,
    charge_pct: float | None,
    stood_h: float | None,
    prewarmed: bool,
    steady: bool | None,
) -> PlanConditions:
    """`given` with the state of the car and the manner of driving; PlanError if out of range."""
    if charge_pct is not None and not 0.0 <= charge_pct <= 100.0:
        raise PlanError(f"a state of charge of {charge_pct:g} is not within 0 to 100 percent")
    if stood_h is not None and not 0.0 <= stood_h <= CONDITION_RANGES["stood"][1] / 3600.0:
        raise PlanError(f"the car cannot have stood for {stood_h:g} h")
    return replace(
        given,
        charge=None if charge_pct is None else charge_pct / 100,
        stood=None if stood_h is None else 3600.0 * stood_h,
        prewarmed=float(prewarmed),
        steady=None if steady is None else float(steady),
    )


def planned_energy(
    plan: Any, car: Any, conditions: PlanConditions = UNSAID, air_density: float | None = None
) -> PlannedEnergy:
    """Forecast of a plan; arguments and errors as of `forecast`."""
    vehicle, model, account = known_car(car)
    if account is not None and conditions.stood is not None:  # the plan is another drive
        model = car.next_model
    battery, gauge = BatteryModel(math.nan), ChargeGauge(vehicle.battery_capacity)
    charge = UNKNOWN
    if account is not None:
        battery, gauge, charge = account.battery, account.gauge, account.charge()
    given = as_plan(plan, vehicle)
    basis = basis_of(model, conditions, air_density)
    energies = forecast_plan(given, *basis)
    course = battery.along(energies.on_curve, conditions.charge_from(charge), gauge.capacity)
    full = _when_full(battery, energies, gauge.capacity)
    return PlannedEnergy(given, points_of(given), basis, energies, course, full, gauge)


def _when_full(battery: BatteryModel, energies: Forecast, capacity: Uncertain) -> Uncertain:
    """Energy, J, that a full battery gives at the mean power of a plan until it is empty."""
    power = float(energies.energy[-1] / (energies.time[-1] - energies.time[0]))
    if not capacity.known or not power > 0.0:
        return capacity
    energy = np.linspace(0.0, LONG_ENOUGH * capacity.value, FULL_STEPS)
    steps = Forecast(energy / power, energy, np.full_like(energy, power), np.zeros_like(energy))
    charge, _ = battery.along(steps, Uncertain(1.0, 0.0), capacity)
    given = float(np.interp(0.0, charge[::-1], energy[::-1]))
    return Uncertain(given, capacity.sigma * given / capacity.value)


def level_road(speed: float, length: float = FARTHEST) -> Legs:
    """`length`, m, of an endless level road at a mean speed, m/s, cut to the longest trip."""
    length = min(length, 0.9 * LONGEST * speed)
    road = legs_of_trip(np.array([length]), np.array([length / speed]))
    return replace(road, onward=True)


def until_empty(
    speed: float, car: Any, conditions: PlanConditions, sigmas: float = 0.0
) -> float | None:
    """Length, m, of a level road at whose end the charge plus `sigmas` of its 1-sigma is 0.

    None if unknown or never; 0 if the charge does not suffice to reach the speed. Iterates,
    because energy is not proportional to length (uneven speed).
    """
    planned = planned_energy(level_road(speed), car, conditions)
    length = planned.used_up(sigmas)
    for _ in range(ROUNDS):
        if not length:
            break
        planned = planned_energy(level_road(speed, length), car, conditions)
        start, *_, end = planned.course[0] + sigmas * planned.course[1]
        if abs(end) < EMPTY:
            break
        length *= float(start / (start - end))
    return 0.0 if length is not None and length < 1.0 else length


def what_if(
    plan: Any, car: Any, conditions: PlanConditions = UNSAID, units: Units = METRIC
) -> list[Change]:
    """Changes of energy by a slower, faster, colder or warmer trip; errors as of `forecast`."""
    vehicle, model, _ = known_car(car)
    given = as_plan(plan, vehicle)
    base = planned_energy(given, car, conditions)
    mean = base.trip.distance[-1] / (base.trip.time[-1] - base.trip.time[0])
    celsius = conditions.temperature
    if celsius is None:
        celsius = MILD_CELSIUS if model.car.celsius is None else model.car.celsius
    cases: list[tuple[str, Any, PlanConditions]] = []
    for sign, word in ((-1, "slower"), (1, "faster")):
        share = 1.0 + sign * units.speed_step / (mean * units.speeds)
        if share > 0.5:
            with suppress(PlanError):  # faster than any car
                words = f"{units.speed_step:g} {units.speed} {word}"
                cases.append((words, given.quicker(share), conditions))
    for sign, word in ((-1, "colder"), (1, "warmer")):
        with suppress(PlanError):  # outside any weather
            words = f"{TEMPERATURE_STEP * units.degrees:g} {units.temperature} {word}"
            otherwise = replace(conditions, temperature=celsius + sign * TEMPERATURE_STEP)
            cases.append((words, given, otherwise))
    changes = []
    for words, other, expected in cases:
        changed = planned_energy(other, car, expected)
        energy = changed.basis.model.difference(changed.energies.end, base.energies.end)
        seconds = np.ptp(changed.trip.time) - np.ptp(base.trip.time)
        changes.append(Change(words, energy, float(seconds)))
    return changes


def known_car(car: Any) -> tuple[Vehicle, PowerModel, EnergyAccount | None]:
    """Vehicle, model and account (or None) of an argument `car`; TypeError for another value."""
    if isinstance(car, str | Path | Vehicle):
        vehicle = car if isinstance(car, Vehicle) else load_vehicle(car)
        return vehicle, vehicle_model(vehicle), None
    if hasattr(car, "account"):
        return car.vehicle, car.model, car.account
    raise TypeError(f"a car is a vehicle, a Result or an Estimator, not {type(car).__name__}")


def basis_of(
    model: PowerModel, conditions: PlanConditions, air_density: float | None
) -> PlanBasis:
    """Basis of a forecast by a plan's conditions; InputError for an impossible air density."""
    basis = PlanBasis.of(model, conditions, density=air_density)
    density = basis.weather.air_density
    if not AIR_DENSITIES[0] <= density <= AIR_DENSITIES[1]:
        least, most = AIR_DENSITIES
        raise InputError(f"air_density is {density:g}, not within {least:g} to {most:g} kg/m^3")
    return basis


def as_plan(plan: Any, vehicle: Vehicle, speed_kmh: float | None = None) -> Plan | Legs:
    """The plan in the arguments `plan` and `speed_kmh` of `forecast`; InputError if invalid."""
    if speed_kmh is not None and not isinstance(plan, str | os.PathLike):
        raise InputError("speed_kmh is of a track in a file; this plan has its own speeds")
    if isinstance(plan, Plan | Legs):
        return plan
    # Here, for polars, which reads tables, takes a quarter of a second to import.
    from evpinn_ros.logs.plans.read import read_plan, warn_if_fast
    from evpinn_ros.logs.plans.table import plan_of_columns
    from evpinn_ros.logs.read_options import ReadOptions

    if isinstance(plan, str | os.PathLike):
        pace = None if speed_kmh is None else speed_kmh / 3.6
        return read_plan(Path(plan), vehicle, ReadOptions(pace=pace))
    if _is_frame(plan) and plan.index.name == "t_s":
        plan = plan.reset_index()
    columns = plan_of_columns(columns_of(plan))
    warn_if_fast(columns)
    return columns


def _is_frame(table: Any) -> TypeGuard[pd.DataFrame]:
    """True for a DataFrame of pandas, without loading pandas for other types."""
    package = type(table).__module__.partition(".")[0]
    return package == "pandas" and isinstance(table, pandas().DataFrame)


def columns_of(table: Any) -> dict[str, Any]:
    """The columns of a DataFrame of pandas or polars, or of a mapping; TypeError for others."""
    if type(table).__module__.startswith("polars."):
        table = table.to_dict(as_series=False)
    if not (_is_frame(table) or isinstance(table, Mapping)):
        raise TypeError(f"a DataFrame, a dict or a file is needed, not {type(table).__name__}")
    return {str(column): table[column] for column in table}


class EdgeEnergies:
    """Energies of the edges of a road network, and of routes over them.

    Attributes:
        table: a row for each edge, by its index: `energy_j`, J, negative if the edge returns
            energy, and its 1-sigma, `sigma_j`.
    """

    def __init__(self, index: pd.Index, edges: energy_edges.Edges) -> None:
        self.table = pandas().DataFrame({"energy_j": edges.energy, "sigma_j": edges.sigma}, index)
        self._edges = edges

    def route(self, edges: Iterable[Hashable]) -> Uncertain:
        """Energy of a route, J, and its 1-sigma: the `forecast` of its edges as a trip.

        Unlike the sum of the table, it includes the start from standing (cold if the car is
        cold), the stop at the end, and changes of speed and slope between the edges.

        Args:
            edges: labels of the edges in the index, in the order in which they are driven.

        Raises:
            InputError: an edge is not in the table, or the edges make no trip (`PlanError`).
        """
        return self._edges.route(self._places(edges))

    def difference(self, route: Iterable[Hashable], other: Iterable[Hashable]) -> Uncertain:
        """Energy of one route minus that of another, J, and its 1-sigma without shared errors.

        Raises:
            InputError: an edge is not in the table.
        """
        return self._edges.difference(self._places(route), self._places(other))

    def _places(self, edges: Iterable[Hashable]) -> np.ndarray:
        labels = [*edges]
        places = self.table.index.get_indexer_for(pandas().Index(labels, tupleize_cols=True))
        if len(places) != len(labels) or (places < 0).any():
            raise InputError("a route has an edge that is not in the table, or is in it twice")
        return np.asarray(places)


def edge_energies(
    edges: pd.DataFrame | pl.DataFrame | Mapping[str, Any],
    car: str | Path | Vehicle | KnownCar = "generic",
    *,
    temperature_c: float | None = None,
    heating_w: float | None = None,
    head_wind: float = 0.0,
    payload_kg: float | None = None,
    steady: bool = False,
    air_density: float | None = None,
) -> EdgeEnergies:
    """Energies of all edges of a road network at once, for a router.

    Each edge is driven at its mean speed and takes, per metre, the energy of speeding up and
    braking that is usual at this speed. So edges add up: splitting one changes no sum. The table
    assumes warm tyres and cabin, and no change of speed or slope at the ends of an edge. A
    downhill edge may return energy, so a router needs the Bellman-Ford algorithm or potentials.

    Example:
        >>> import evpinn_ros as ev
        >>> edges = {"length_m": [500.0, 500.0], "speed_kmh": [50.0, 50.0], "climb_m": [25, -25]}
        >>> energies = ev.edge_energies(edges, "bmw_i3")
        >>> bool(energies.table.energy_j[0] > 0 > energies.table.energy_j[1])
        True

    Args:
        edges: one row for each edge. Columns, with the unit in each name: two of `length_m`,
            `duration_s` and `speed_kmh`; and `climb_m`, or `start_elevation_m` and
            `end_elevation_m`. Without heights the sigma includes an unknown climb.
        car: name or file of a vehicle, or a `Vehicle`, of which nothing was learned; or the
            `Result` or `Estimator` that learned the car.
        temperature_c: outside temperature, degrees Celsius; if not given, the last that the car
            measured.
        heating_w: power of heating and air conditioning, W; if not given, what the temperature
            makes likely.
        head_wind: head wind on every edge, m/s over ground.
        payload_kg: people and luggage in addition to those when the car was learned, kg.
        steady: True if edges and routes are driven evenly.
        air_density: kg/m^3; if not given, that of the vehicle file at the temperature outside.

    Raises:
        InputError: a column is missing, the vehicle does not exist, or an edge is impossible
            (`PlanError`).
    """
    # Here, for polars, which reads tables, takes a quarter of a second to import.
    from evpinn_ros.logs.plans.table import edges_of_columns

    _, model, _ = known_car(car)
    given = PlanConditions(temperature_c, heating_w, head_wind, payload_kg)
    legs = edges_of_columns(columns_of(edges))
    basis = basis_of(model, given, air_density)
    of_edges = energy_edges.edge_energies(
        legs, basis.model, basis.weather, basis.head_wind, steady=steady
    )
    counted = pandas().RangeIndex(len(legs.length))
    index = edges.index if _is_frame(edges) else counted
    return EdgeEnergies(index, of_edges)
