"""`evpinn forecast`: forecasts the energy and charge of plans."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
import math
from pathlib import Path
from typing import Annotated, Any
import warnings

import typer

from evpinn_ros.cli.console import command_line, note, say, show, write_json
from evpinn_ros.cli.options import (
    JsonOption,
    ReportOption,
    UnitsOption,
    complete_vehicle,
    with_read_options,
)
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.units import JOULES_PER_KWH, Units, UnitSystem, fixed, kwh_digits
from evpinn_ros.common.writer import check_outputs
from evpinn_ros.core.energy.plan import MAX_SPEED
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE as QUANTILE
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions

MORE = "kWh more than the first"
SHOWN_ROAD = 100e3  # m, if the range of the car is unknown
CHARGE = 7  # column of the charge; left out if it is unknown for every plan
WIDE = 110  # characters of a table that compares plans
ENERGIES = ("energy_j", "sigma_j", "more_than_first_j", "more_than_first_sigma_j")


@with_read_options
def forecast(
    plans: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Plans: tables of speed over time or of legs, GPX, GeoJSON, the JSON of "
            "Valhalla, OSRM, GraphHopper or openrouteservice, or recorded drives. Without a plan, "
            "--speed and --charge give the range."
        ),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Name of the vehicle (evpinn vehicles lists them), or path of a vehicle file; "
            "if not given, that of the state, else generic.",
            autocompletion=complete_vehicle,
        ),
    ] = None,
    state: Annotated[
        Path | None, typer.Option(help="File that replay or run --state wrote.")
    ] = None,
    charge: Annotated[
        float | None, typer.Option(min=0.0, max=100.0, help="State of charge at the start, %.")
    ] = None,
    temperature: Annotated[
        float | None, typer.Option(min=-60.0, max=60.0, help="Outside temperature, degrees C.")
    ] = None,
    heating: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=20e3,
            help="Power of heating and air conditioning, W; 0 means switched off.",
        ),
    ] = None,
    speed: Annotated[
        str | None,
        typer.Option(
            help="Speed, such as 90km/h or 55mph, on a track without times and speeds; without a "
            "plan, on a level road.",
        ),
    ] = None,
    head_wind: Annotated[
        float | None,
        typer.Option(min=-60.0, max=60.0, help="Head wind, m/s; negative is a tail wind."),
    ] = None,
    payload: Annotated[
        float | None, typer.Option(min=0.0, max=5000.0, help="Additional people and luggage, kg.")
    ] = None,
    stood: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=10e3,
            help="Hours since the last drive; if not given, tyres and cabin are cold.",
        ),
    ] = None,
    prewarmed: Annotated[
        bool, typer.Option("--prewarmed", help="The cabin was heated or cooled while plugged in.")
    ] = False,
    steady: Annotated[
        bool | None,
        typer.Option(
            "--steady/--expected",
            help="Between distant points, the car follows the planned speeds exactly (steady), or "
            "varies around them as drivers do (expected: the default, except for drives, "
            "driving cycles and plans that a controller follows).",
        ),
    ] = None,
    read_options: ReadOptions = READ_DEFAULTS,
    report: ReportOption = None,
    units: UnitsOption = UnitSystem.METRIC,
    json_file: JsonOption = None,
) -> None:
    """Forecast the energy of plans, and the charge after each.

    Each plan is compared with the first one. Errors that both share cancel in the difference:
    those of the car's mass and, for plans of equal length (within 1 m), of the unknown road.
    docs/reference/inputs.md describes the files.

    Example: evpinn forecast route.json --state car.json --charge 80
    """
    # Imported here: pandas takes longer to import than everything else together.
    from evpinn_ros.api.estimator import Estimator
    from evpinn_ros.api.plan import (
        level_road,
        planned_energy,
        until_empty,
        what_if,
        with_state,
    )
    from evpinn_ros.core.energy.plan import PlanConditions
    from evpinn_ros.core.estimation.state_file import vehicle_of
    from evpinn_ros.core.vehicle.files import load_vehicle

    if vehicle is None:
        vehicle = (None if state is None else vehicle_of(state)) or "generic"
    paths = plans or []
    shown = units.units
    pace = None if speed is None else _metres_per_second(speed, shown)
    check_outputs((json_file, report), (*paths, state, Path(vehicle)))
    car = vehicle if state is None else Estimator(vehicle, state=state)
    given = PlanConditions(temperature, heating, head_wind, payload)
    given = with_state(given, charge, stood, prewarmed, steady)
    lasts: list[float | None] = []
    if paths:
        trips = _read(paths, load_vehicle(vehicle), replace(read_options, pace=pace))
    elif pace is None:
        raise typer.BadParameter("give a plan, or --speed and --charge")
    else:
        lasts = [until_empty(pace, car, given, sigmas) for sigmas in (0.0, -QUANTILE, QUANTILE)]
        name = f"{pace * shown.speeds:.4g} {shown.speed}"
        trips = [(name, level_road(pace, lasts[0] or SHOWN_ROAD))]
    forecasts = [planned_energy(plan, car, given) for _, plan in trips]
    check_outputs((json_file, report))  # now that every file of the inputs was opened
    rows = [
        _figures(path, planned, forecasts[0])
        for (path, _), planned in zip(trips, forecasts, strict=True)
    ]
    names = _names(paths) or [name for name, _ in trips]
    rows[0] |= dict.fromkeys(ENERGIES[2:], math.nan)
    columns = _columns(shown, compared=len(rows) > 1)
    texts = [
        [name, *_texts(row, shown)][: len(columns)] for name, row in zip(names, rows, strict=True)
    ]
    if not any(math.isfinite(row["charge_pct"]) for row in rows):
        columns = (*columns[:CHARGE], *columns[CHARGE + 1 :])
        texts = [[*cells[:CHARGE], *cells[CHARGE + 1 :]] for cells in texts]
    table = PlainTable("Forecast", columns, texts)
    show(table, at_least=WIDE if len(rows) > 1 else 0)
    if lasts and lasts[0] is not None:
        say(_how_far(100.0 * forecasts[0].charge[0, 0], lasts, shown))
    level: dict[str, list[str]] = {}
    for planned, name in zip(forecasts, names, strict=True):
        if uneven := planned.uneven_part:
            say(f"{name}: {uneven}; --steady leaves it out.")
        for text in (planned.no_heights(shown), planned.beyond_driven):
            if text is not None:
                level.setdefault(text, []).append(name)
    for text, alike in level.items():
        say(f"{', '.join(alike)}: {text}.")
    basis = "by its vehicle file alone" if state is None else f"as learned in {state}"
    better = "; --state FILE uses what earlier drives taught" if state is None else ""
    name = load_vehicle(vehicle).name
    say(f"{name}, {basis}{better}.")
    record = forecasts[0].record
    if record is not None:
        say(record)
    expected = _expected(given, forecasts[0].basis.model.car.celsius, shown)
    say(expected)
    battery = "" if charge is None else _battery(forecasts[0], vehicle)
    if battery:
        say(battery)
    else:
        note("evpinn: add --charge PERCENT (at the start) to see the charge at the end")
    if report is not None:
        from evpinn_ros.report.forecast_page import PlannedTrip, write_forecasts

        shown_trips = [
            PlannedTrip(name, planned, what_if(planned.given, car, given, shown))
            for name, planned in zip(names, forecasts, strict=True)
        ]
        assumed = [line for line in (f"{name}, {basis}.", record, expected, battery) if line]
        write_forecasts(report, shown_trips, assumed, command_line(), shown)
    if json_file is not None:
        write_json(json_file, rows)


def _read(paths: list[Path], vehicle: Any, options: ReadOptions) -> list[tuple[str, Any]]:
    """(path, plan) of each file; warnings of their readers become notes."""
    from evpinn_ros.logs.plans.read import read_plan

    trips = []
    for path in paths:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always", UserWarning)
            trips.append((str(path), read_plan(path, vehicle, options)))
        for warning in warned:
            if warning.category is UserWarning:
                note(f"evpinn: {path}: {warning.message}")
    return trips


def _names(paths: list[Path]) -> list[str]:
    """Names of the files, with folders if two names are equal."""
    from evpinn_ros.replays.drive_names import short_names

    names = [path.name for path in paths]
    return names if len(set(names)) == len(names) else [*short_names(paths)]


def _metres_per_second(text: str, units: Units) -> float:
    """Parse a speed, which without a unit is in `units`."""
    from evpinn_ros.logs.quantities import QUANTITIES

    unit = text.strip().lstrip("0123456789.")
    number, unit = text.strip().removesuffix(unit), unit.strip()
    names = QUANTITIES["speed"].units
    with suppress(KeyError, ValueError):
        factor = names[unit.lower()].factor if unit else 1.0 / units.speeds
        if 0.0 < (speed := float(number) * factor) <= MAX_SPEED:
            return speed
    raise typer.BadParameter(f"--speed {text}: give a speed with a unit, such as 90km/h")


def _how_far(charge: float, lasts: list[float | None], units: Units) -> str:
    """Sentence on how far a charge, %, lasts: a distance and its 90 % band, m, or None."""
    empty, *band = (
        "unknown" if place is None else f"{place / units.metres:.0f}" for place in lasts
    )
    return (
        f"{charge:.3g} % of charge last for {empty} {units.distance}: 9 times in 10 between "
        f"{band[0]} and {band[1]}."
    )


def _expected(given: Any, known_celsius: float | None, units: Units) -> str:
    celsius, since = given.temperature, ""
    if celsius is None:
        celsius, since = known_celsius, ", as last measured"
    air = "a mild day"
    if celsius is not None:
        air = f"{celsius * units.degrees + units.zero:.3g} {units.temperature}{since}"
    heating = "the heating that this makes likely"
    if given.heating is not None:
        heating = f"{given.heating:g} W of heating or cooling"
    wind = f"{given.head_wind:g} m/s of head wind" if given.head_wind else "no wind"
    load = f"{given.payload:g} kg more load" if given.payload else "the same load as before"
    start = "a cold start"
    if given.stood is not None:
        start = f"{given.stood / 3600:g} h after its last drive"
    cabin = ", the cabin prewarmed" if given.prewarmed else ""
    return f"Expected: {air}, {heating}, {wind}, {load}, {start}{cabin}."


def _battery(planned: Any, vehicle: str) -> str:
    from evpinn_ros.core.vehicle.certified import certified_cars

    if not planned.full.known:
        return (
            "The charge after a plan is unknown, because the capacity of the battery is unknown: "
            "write battery_capacity into the vehicle file (evpinn vehicles show prints one), or "
            "replay a drive that uses 10 % of the charge."
        )
    kwh, sigma = (joules / JOULES_PER_KWH for joules in planned.full)
    certified = certified_cars().get(vehicle)
    how = f"as {certified.pack_of} has it" if certified else "by its vehicle file"
    how = "as its drives showed" if planned.gauge.learned else how
    return f"Battery: {kwh:.1f} +- {sigma:.1f} kWh when full, {how}."


def _figures(path: str, planned: Any, first: Any) -> dict[str, Any]:
    trip, energies = planned.trip, planned.energies
    more = planned.basis.model.difference(energies.end, first.energies.end)
    charge, charge_sigma = (100 * planned.charge[:, -1]).tolist()
    return {
        "plan": path,
        "distance_m": float(trip.distance[-1]),
        "duration_s": float(trip.time[-1]),
        "energy_j": float(energies.energy[-1]),
        "sigma_j": float(energies.sigma[-1]),
        "uneven_j": planned.uneven,
        "without_height_m": energies.end.unseen,
        "charge_pct": max(charge, 0.0),
        "charge_sigma_pct": charge_sigma,
        "empty_at_m": planned.empty_at,
        "more_than_first_j": more.value,
        "more_than_first_sigma_j": more.sigma,
    }


def _columns(units: Units, *, compared: bool) -> tuple[str, ...]:
    columns = (
        *("plan", units.distance, "min", units.speed, "kWh", "1-sigma"),
        *(units.economy, "charge after"),
    )
    return (*columns, MORE) if compared else columns


def _texts(row: dict[str, Any], units: Units) -> list[str]:
    distance, hours, kwh, sigma, more, more_sigma = (
        row[key] / unit
        for key, unit in (
            ("distance_m", units.metres),
            ("duration_s", 3600.0),
            *((key, JOULES_PER_KWH) for key in ENERGIES),
        )
    )
    charge = f"{row['charge_pct']:.1f} +- {row['charge_sigma_pct']:.1f} %"
    if row["empty_at_m"] is not None:
        charge = f"empty at {row['empty_at_m'] / units.metres:.1f} {units.distance}"
    digits = kwh_digits(kwh, 3)
    return [
        f"{distance:.2f}",
        f"{60 * hours:.1f}",
        f"{distance / hours:.0f}",
        fixed(kwh, digits),
        f"{sigma:.{digits}f}",
        units.consumption(row["energy_j"], row["distance_m"]) if distance else "-",
        charge if math.isfinite(row["charge_pct"]) else "-",
        f"{fixed(more, digits, '+')} +- {more_sigma:.{digits}f}" if math.isfinite(more) else "",
    ]
