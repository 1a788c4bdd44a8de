"""`evpinn vehicles`: lists and shows the cars that have priors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from evpinn_ros.cli.console import say, show, write_json
from evpinn_ros.cli.lazy import ReadableCommand, ReadableGroup
from evpinn_ros.cli.options import JsonOption, UnitsOption, complete_vehicle
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units, UnitSystem
from evpinn_ros.core.vehicle.certified import FRONTAL_AREA, certified_cars
from evpinn_ros.core.vehicle.files import Vehicle, find_vehicles, load_vehicle, vehicle_text
from evpinn_ros.core.vehicle.rated import cycle_energy, rated_cars

ECONOMY = "kwh_per_100_km"
COLUMNS = {
    "vehicle": "vehicle",
    "battery kWh": "battery_kwh",
    METRIC.economy: ECONOMY,
    "mass kg": "mass_kg",
    "CAN profile": "can_profile",
    "prior": "from",
}
"""JSON key by the title of its column in the table."""

vehicles = typer.Typer(cls=ReadableGroup, invoke_without_command=True)


@vehicles.callback()
def list_vehicles(context: typer.Context) -> None:
    """List the cars that --vehicle knows: vehicle files, certified and rated cars.

    The road load of a certified car was measured (US EPA). That of a rated car is estimated, from
    its mass, battery and WLTP range.

    Example: evpinn vehicles search leaf
    """
    if context.invoked_subcommand is None:
        search([])


@vehicles.command(cls=ReadableCommand)
def search(
    words: Annotated[list[str], typer.Argument(help="Words that the name must contain.")],
    json_file: JsonOption = None,
    units: UnitsOption = UnitSystem.METRIC,
) -> None:
    """List the cars whose names contain these words, with their WLTP consumption.

    Example: evpinn vehicles search model 3
    """
    cars = [load_vehicle(key) for key in find_vehicles(" ".join(words))]
    if not cars:
        raise InputError(
            f"no vehicle's name contains {' '.join(words)!r}; evpinn vehicles lists all. For "
            "another car use --vehicle generic, or see docs/guides/add_your_car.md"
        )
    lines = [_line(vehicle) for vehicle in cars]
    economy = units.units.economy
    titles = tuple(economy if title == METRIC.economy else title for title in COLUMNS)
    rows = [[_cell(units.units, name, line[name]) for name in COLUMNS.values()] for line in lines]
    table = PlainTable("Vehicles", titles, rows, words=("CAN profile", "prior"))
    show(table, at_least=108)
    if json_file is not None:
        write_json(json_file, lines)


@vehicles.command("show", cls=ReadableCommand)
def show_vehicle(
    vehicle: Annotated[
        str,
        typer.Argument(
            help="Name of the vehicle, words of its name, or path of a vehicle file.",
            autocompletion=complete_vehicle,
        ),
    ],
) -> None:
    """Print a vehicle file, with the source of every prior.

    Example: evpinn vehicles show "ioniq 5 rwd"
    """
    car = load_vehicle(vehicle)
    for line in vehicle_text(car, Path(vehicle).parent).splitlines():
        say(line)


def _cell(units: Units, name: str, value: str | float | None) -> str:
    if not isinstance(value, float):
        return value or ""
    if math.isnan(value):
        return ""
    if name == ECONOMY:
        return units.consumption(value * METRIC.rate_joules, 1.0).removesuffix(".0")
    return f"{value:.1f}".removesuffix(".0")


def _line(vehicle: Vehicle) -> dict[str, str | float | None]:
    key, start = vehicle.key, vehicle.initial
    return {
        "vehicle": key,
        "battery_kwh": vehicle.battery_capacity / JOULES_PER_KWH,
        ECONOMY: _consumption(vehicle),
        "mass_kg": start.mass,
        "c_rr": start.c_rr,
        "drag_area_m2": start.c_d * vehicle.frontal_area,
        "can_profile": vehicle.can_profile,
        "from": "certified"
        if key in certified_cars()
        else "rated"
        if key in rated_cars()
        else "file",
    }


def _consumption(vehicle: Vehicle) -> float:
    """WLTP consumption by the priors, kWh/100 km; NaN for a vehicle with a nominal speed."""
    if math.isfinite(vehicle.nominal_speed):
        return math.nan
    start = vehicle.initial
    c_d = start.c_d * vehicle.frontal_area / FRONTAL_AREA
    values = np.array([start.eta, start.mu, start.mass, start.c_rr, c_d])
    return cycle_energy(values) / METRIC.rate_joules
