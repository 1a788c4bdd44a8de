"""`evpinn bench fleet`: many short drives on one and two workers, and priors that are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Annotated, Any

import typer

from benchmarks.cli.output import table_of
from benchmarks.fleet import Recovered, Scaling, many_drives, recovered, scaling
from evpinn_ros.cli.console import progress_bar, say, show, write_json
from evpinn_ros.cli.interruption import Interruption
from evpinn_ros.cli.options import JsonOption, VehicleOption
from evpinn_ros.fleet.manifest import CarDrives
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
    """Measure `evpinn fleet` on simulated drives: speed and priors.

    10 000 drives take 0.3 s of a core each, with each number of workers. What is stopped tells how
    far it came.

    Example: evpinn bench fleet --drives 1000 --cars 12
    """
    require_parquet()
    car, load = load_vehicle(vehicle), os.getloadavg()[0]
    counts = workers or [1, 2]
    found: dict[str, Any] = {"load_average": load}
    with Interruption() as interruption, TemporaryDirectory() as folder:
        base, stopped = Path(folder), partial(getattr, interruption, "asked")
        if drives:
            runs = _scaled(base, many_drives(base / "many", car, drives, seconds), counts, stopped)
            found["scaling"] = [asdict(run) for run in runs]
        if cars and not interruption.asked:
            with progress_bar("known cars", 2 * cars, "steps") as progress:
                known = recovered(
                    base / "known", car, cars, 60 * minutes, max(counts), SEED, progress, stopped
                )
            found["population"] = [asdict(one) for one in known]
            for row in found["population"]:
                row["told"] = row.pop("learned")  # the key of before
            if known:
                _show_population(known)
        say(f"Load of the machine at the start: {load:.1f}")
        if json_file is not None:
            write_json(json_file, found)


def _scaled(
    base: Path, cars: list[CarDrives], counts: list[int], stopped: Callable[[], bool]
) -> list[Scaling]:
    """All runs, the one that was stopped too as far as it came."""
    runs = []
    drives = sum(len(car.drives) for car in cars)
    for n in counts:
        with progress_bar(f"{n} at a time", drives, "drives") as progress:
            run = scaling(cars, base / f"on_{n}", n, time.perf_counter, progress, stopped)
        if run is not None:
            runs.append(run)
        if stopped():
            break
    if runs:
        _show_scaling(runs)
    return runs


def _show_scaling(runs: list[Scaling]) -> None:
    columns = (
        ("workers", "{0.workers}"),
        ("drives", "{0.drives}"),
        ("a second", "{0.drives_per_s:.2f}"),
        ("times", "{1:.2f}"),
        ("ms CPU", "{2:.0f}"),
        ("ms a drive", "{3:.0f} -> {4:.0f}"),
        ("MB", "{0.rss_mb[0]:.0f} -> {0.rss_mb[1]:.0f}"),
    )
    rows = []
    for run in runs:
        milliseconds = (1e3 * each for each in (run.cpu_s, *run.quarters_s))
        rows.append((run, run.drives_per_s / runs[0].drives_per_s, *milliseconds))
    show(table_of("Many drives", rows, columns, left=0))
    say("a -> b: in the first quarter of the cars, and in the last")


def _show_population(known: list[Recovered]) -> None:
    columns = (
        ("", "{0.name}"),
        ("mean", "{0.mean:.4g}"),
        ("found", "{0.learned.mean:.4g} +- {0.learned.mean_std:.2g}"),
        ("sigma", "{0.mean_off:+.1f}"),
        ("spread", "{0.spread:.3g}"),
        ("found", "{0.learned.spread:.3g} +- {0.learned.spread_std:.2g}"),
        ("sigma", "{0.spread_off:+.1f}"),
    )
    show(table_of("Cars of a known population", known, columns))
    say("Logarithms, p_aux in W; sigma: by how many of its own what was found is off")
