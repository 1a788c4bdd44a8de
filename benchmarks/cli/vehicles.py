"""`evpinn bench vehicles`: priors of cars before driving, against their certificates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.cli.output import table_of
from benchmarks.vehicles import CHARGING_LOSS, CycleEnergy, cycle_energies, prior_errors
from evpinn_ros.cli.console import progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.vehicle.certified import certified_cars
from evpinn_ros.vehicle.files import Vehicle, load_vehicle

# Certified cars that a vehicle file stands for too.
SAME_CARS = {
    "bmw_i4": "bmw_i4_edrive_40_gran_coupe_18_inch_2022",
    "chevrolet_bolt": "chevrolet_bolt_euv_2022",
    "nissan_leaf": "nissan_leaf_2022",
    "tesla_model_3_lr": "tesla_model_3_long_range_awd_2022",
    "tesla_model_s": "tesla_model_s_long_range_2022",
}


def vehicles(
    cycles: Annotated[
        Path | None, typer.Option(help="Folder of udds.csv and hwfet.csv: energies of cycles too.")
    ] = None,
    beside: Annotated[
        list[str] | None,
        typer.Option(help="A vehicle, or the path of its file, to judge too; may be repeated."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Judge priors: road load of withheld cars, energies of cycles.

    Example: evpinn bench vehicles --beside my_generic.yaml
    """
    others = {name: load_vehicle(name) for name in ("generic", *(beside or ()))}
    found: dict[str, Any] = {"beliefs": [each._asdict() for each in prior_errors(others)]}
    columns = (
        ("prior", "{0[name]}"),
        ("km/h", "{1:.0f}"),
        ("bias", "{0[bias]:+.1%}"),
        ("error", "{0[error]:.1%}"),
        ("in 90 %", "{0[inside]:.1%}"),
        ("after a drive", "{0[after]:.1%}"),
        ("in 90 %", "{0[after_inside]:.1%}"),
    )
    forces = [(row, 3.6 * row["speed"]) for row in found["beliefs"]]
    title = f"Force on {len(certified_cars())} cars that roll, against certificates"
    show(table_of(title, forces, columns), at_least=110)
    if cycles is not None:
        found["cycles"] = _cycles(cycles, others)
    if json_file is not None:
        write_json(json_file, found)


def _cycles(folder: Path, others: dict[str, Vehicle]) -> list[dict[str, Any]]:
    cars = certified_cars()
    rows: list[dict[str, Any]] = []
    with progress_bar("cars", total=len(cars) * (1 + len(others)), unit="cars") as progress:

        def energies(key: str, vehicle: Vehicle) -> list[CycleEnergy]:
            own = list(cycle_energies(folder, cars[key], vehicle))
            rows.extend(each._asdict() for each in own)
            progress(len(rows) / 2)
            return own

        groups = {
            "each car's own": [each for key in cars for each in energies(key, load_vehicle(key))]
        }
        for name, vehicle in others.items():
            groups[name] = [each for key in cars for each in energies(key, vehicle)]
        for name, key in SAME_CARS.items():
            groups[name] = energies(key, load_vehicle(name))
    figures = []
    for name, each in groups.items():
        errors = np.array([one.error for one in each])
        size = np.abs(errors)
        shares = np.median(errors), np.median(size), np.mean(size < 0.15)
        figures.append((name, len(errors), *map(float, shares)))
    columns = (
        ("prior", "{0}"),
        ("cycles", "{1}"),
        ("bias", "{2:+.1%}"),
        ("error", "{3:.1%}"),
        ("within 15 %", "{4:.0%}"),
    )
    show(table_of(f"Energy at the wall, {CHARGING_LOSS:.0%} lost in charging", figures, columns))
    return rows
