"""`evpinn bench fleet`: many short drives on one and two workers, and priors that are known."""

from __future__ import annotations

from dataclasses import asdict
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Annotated, Any

import typer

from evpinn_ros.bench.fleet import Recovered, Scaling, many_drives, recovered, scaling
from evpinn_ros.cli.console import results, write_json
from evpinn_ros.cli.options import JsonOption, VehicleOption
from evpinn_ros.cli.tables import titled_table
from evpinn_ros.fleet.tables import require_parquet
from evpinn_ros.vehicle.files import load_vehicle

SEED = 4000


def fleet(
    drives: Annotated[int, typer.Option(min=0, help="Short drives, 0 for none.")] = 10_000,
    seconds: Annotated[float, typer.Option(min=10.0, help="Length of each, s.")] = 20.0,
    workers: Annotated[list[int] | None, typer.Option(min=1, help="May be repeated.")] = None,
    cars: Annotated[int, typer.Option(min=0, help="Cars of a known population, 0 for none.")] = 24,
    minutes: Annotated[float, typer.Option(min=1.0, help="Each of these drives.")] = 10.0,
    vehicle: VehicleOption = "nissan_leaf",
    json_file: JsonOption = None,
) -> None:
    """Measure `evpinn fleet` on simulated drives: drives a second, memory, and the priors found.

    Example: evpinn bench fleet --drives 1000 --cars 12
    """
    require_parquet()
    car, load = load_vehicle(vehicle), os.getloadavg()[0]
    counts = workers or [1, 2]
    found: dict[str, Any] = {}
    with TemporaryDirectory() as folder:
        base = Path(folder)
        if drives:
            many = many_drives(base / "many", car, drives, seconds)
            runs = [scaling(many, base / f"on_{n}", n, time.perf_counter) for n in counts]
            found["scaling"] = [asdict(run) for run in runs]
            _show_scaling(runs)
        if cars:
            known = recovered(base / "known", car, cars, 60.0 * minutes, max(counts), SEED)
            found["population"] = [asdict(one) for one in known]
            _show_population(known)
    results.print(f"Load of the machine at the start: {load:.1f}")
    if json_file is not None:
        write_json(json_file, {"load_average": load, **found})


def _show_scaling(runs: list[Scaling]) -> None:
    table = titled_table(f"{runs[0].drives} drives")
    for name in (
        "workers",
        "drives/s",
        "times",
        "ms CPU",
        "ms a drive",
        "MB",
        "start s",
        "tables s",
    ):
        table.add_column(name, justify="right")
    for run in runs:
        table.add_row(
            str(run.workers),
            f"{run.drives_per_s:.2f}",
            f"{run.drives_per_s / runs[0].drives_per_s:.2f}",
            f"{1e3 * run.cpu_s:.0f}",
            " -> ".join(f"{1e3 * each:.0f}" for each in run.tenths_s),
            " -> ".join(f"{each:.0f}" for each in run.rss_mb),
            f"{run.start_s:.1f}",
            f"{run.tables_s:.1f}",
        )
    results.print(table)
    results.print("a -> b: in the first tenth of the cars, and in the last")


def _show_population(known: list[Recovered]) -> None:
    table = titled_table("Cars of a known population")
    table.add_column("", no_wrap=True)
    for name in ("mean", "found", "off by", "spread", "found", "off by"):
        table.add_column(name, justify="right")
    for one in known:
        told = one.told
        table.add_row(
            one.name,
            f"{one.mean:.4g}",
            f"{told.mean:.4g} +- {told.mean_std:.2g}",
            f"{(told.mean - one.mean) / told.mean_std:+.1f} sigma",
            f"{one.spread:.3g}",
            f"{told.spread:.3g} +- {told.spread_std:.2g}",
            f"{(told.spread - one.spread) / told.spread_std:+.1f} sigma",
        )
    results.print(table)
    results.print("Logarithms, p_aux in W")
