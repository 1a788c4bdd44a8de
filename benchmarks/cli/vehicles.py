"""`evpinn bench vehicles`: priors of cars before driving, against their certificates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.vehicles import CycleEnergy, cycle_energies, prior_errors
from evpinn_ros.cli.console import progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.cli.tables import titled_table
from evpinn_ros.vehicle.certified import CHARGING_LOSS, certified_cars
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
        typer.Option(
            help="A vehicle, or the path of its file, to be judged too; may be repeated."
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Judge priors: road load of cars withheld from them, and energies of drive cycles.

    Example: evpinn bench vehicles --beside my_generic.yaml
    """
    others = {name: load_vehicle(name) for name in ("generic", *(beside or ()))}
    found: dict[str, Any] = {"beliefs": [each._asdict() for each in prior_errors(others)]}
    table = titled_table(f"Force on {len(certified_cars())} cars that roll, against certificates")
    for name in ("prior", "km/h", "bias", "error", "in 90 %", "after a drive", "in 90 %"):
        table.add_column(name, justify="left" if name == "prior" else "right")
    for row in found["beliefs"]:
        name, speed, *shares = row.values()
        table.add_row(
            name, f"{3.6 * speed:.0f}", f"{shares[0]:+.1%}", *map("{:.1%}".format, shares[1:])
        )
    show(table, at_least=110)
    if cycles is not None:
        found["cycles"] = _cycles(cycles, others)
    if json_file is not None:
        write_json(json_file, found)


def _cycles(folder: Path, others: dict[str, Vehicle]) -> list[dict[str, Any]]:
    cars = certified_cars()
    table = titled_table(f"Energy at the wall, {CHARGING_LOSS:.0%} lost in charging")
    for name in ("prior", "cycles", "bias", "error", "within 15 %"):
        table.add_column(name, justify="left" if name == "prior" else "right")
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
    for name, each in groups.items():
        errors = np.array([one.error for one in each])
        table.add_row(
            name,
            str(len(errors)),
            f"{np.median(errors):+.1%}",
            f"{np.median(np.abs(errors)):.1%}",
            f"{np.mean(np.abs(errors) < 0.15):.0%}",
        )
    show(table)
    return rows
