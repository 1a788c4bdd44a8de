"""`evpinn bench carried`: what a drive costs, forecast by a car that learned on those before."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
import time
from typing import Annotated

import typer

from benchmarks.carried import CarriedBenchmark, CarriedForecast, energy_errors
from benchmarks.cli.output import number
from benchmarks.logs import find_logs
from evpinn_ros.cli.console import note, progress_bar, say, show, write_json
from evpinn_ros.cli.options import JsonOption, VehicleOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.drives.sources import open_source
from evpinn_ros.vehicle.files import load_vehicle


def carried(
    path: Annotated[
        str, typer.Argument(metavar="PATH", help="Folder of one car's drives, in order of names.")
    ],
    vehicle: VehicleOption,
    speed_only: Annotated[
        bool, typer.Option("--speed-only", help="Hide grade, temperature and auxiliary loads.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Forecast each drive from its speed alone, the battery withheld, then learn from it.

    What is learned is carried from drive to drive. The first is forecast from the priors and does
    not count in the totals.

    Example: evpinn bench carried $DATA/bmw_i3 --vehicle bmw_i3
    """
    limit_blas_threads()
    car = load_vehicle(vehicle)
    benchmark = CarriedBenchmark(car, time.thread_time, speed_only=speed_only)
    found: dict[str, CarriedForecast] = {}
    logs = find_logs(path, vehicle)
    try:
        with progress_bar("drives", len(logs), unit="drives") as progress:
            for done, log in enumerate(logs, start=1):
                source = open_source(log.path, car, log.can_profile)
                try:
                    found[str(log.path)] = benchmark.drive(source.readings)
                except InputError as error:
                    note(f"evpinn: {error}")
                    continue
                finally:
                    progress(done)
                if source.problem is not None:
                    note(f"evpinn: {source.problem}")
    finally:  # Ctrl-C leaves the drives so far
        if found:
            _report(found, json_file)
    if not found:
        raise InputError(f"{path}: nothing could be read")


def _report(found: dict[str, CarriedForecast], json_file: Path | None) -> None:
    show(_table(found))
    errors = energy_errors(found.values())
    if errors is not None:
        say(f"Energy error after the first: median {errors[0]:.1f} %, mean {errors[1]:.1f} %")
    if json_file is not None:
        write_json(json_file, {name: asdict(one) for name, one in found.items()})


def _table(found: dict[str, CarriedForecast]) -> PlainTable:
    columns = ("drive", "measured Wh", "forecast Wh", "error %", "RMSE W", "in 90 % band")
    table = PlainTable("", columns)
    for name, one in found.items():
        numbers = (
            (one.measured_j and one.measured_j / 3600.0, ".0f"),
            (one.predicted_j and one.predicted_j / 3600.0, ".0f"),
            (one.error_percent, "+.1f"),
            (one.rmse_w, ".0f"),
            (one.coverage_90, ".1%"),
        )
        table.add_row(Path(name).name, *(number(value, form) for value, form in numbers))
    return table
