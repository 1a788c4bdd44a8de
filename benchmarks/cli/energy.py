"""`evpinn bench energy`: counting energy, the battery at the end, and how quick forecasts are."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from importlib.util import find_spec
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.cli.integration import battery, counting
from benchmarks.cli.output import figures_table, json_at_the_end, table_of
from benchmarks.energy_library import (
    BATCH,
    POINTS,
    CycleRow,
    ForecastThroughput,
    compare_cycles,
    measure_throughput,
)
from benchmarks.fastsim_peer import fastsim_version
from benchmarks.logs import find_logs
from evpinn_ros.cli.console import note, progress_bar, show
from evpinn_ros.cli.options import JsonOption, complete_vehicle
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.vehicle.files import load_vehicle

TOGETHER = 12  # plans
CAR = "tesla_model_3_lr"  # of the figures of speed
JOULES_PER_WH = 3600.0


class MeasuredPart(str, Enum):
    """Part that can be measured by itself."""

    COUNTING = "counting"
    LIBRARY = "library"
    BATTERY = "battery"
    PLANS = "plans"


def energy(
    paths: Annotated[
        list[str],
        typer.Argument(metavar="PATH...", help="Each one car's drives: PATH or PATH=VEHICLE."),
    ],
    vehicle: Annotated[
        str,
        typer.Option(
            help="Whose drives, where PATH does not say.", autocompletion=complete_vehicle
        ),
    ] = CAR,
    cycles: Annotated[Path | None, typer.Option(help="Folder of drive cycles.")] = None,
    parts: Annotated[
        list[MeasuredPart],
        typer.Option("--part", show_default="all", help="Measure this alone; may be given again."),
    ] = [*MeasuredPart],  # noqa: B006
    plans: Annotated[int, typer.Option(min=10, help="Plans asked for over DDS.")] = 1000,
    json_file: JsonOption = None,
) -> None:
    """Count the energy of drives, and time forecasts.

    The drives of a PATH are one car's, in order of names. Counting: the battery at 1 Hz with gaps,
    silent for ten minutes, silent all along; it takes as long as a fifth of all drives. Battery:
    the end of each drive of known power, by energy over capacity and by the battery's state,
    learned on the drives before. Library and plans: speed of forecasts, in numpy and torch, beside
    FASTSim, and over DDS. Cycles are udds.csv, hwfet.csv and us06.csv. For how good forecasts
    are, see `evpinn bench plans`.

    Example: evpinn bench energy $DATA/bmw_i3=bmw_i3 --cycles $DATA/drive_cycles
    """
    limit_blas_threads()
    cars = [find_logs(path, vehicle) for path in paths]
    found: dict[str, Any] = {"load_average": os.getloadavg()[0]}
    with json_at_the_end(json_file, lambda: found):
        if MeasuredPart.COUNTING in parts:
            found["counting"] = counting(cars)
        if MeasuredPart.BATTERY in parts:
            found["battery"] = [battery(logs) for logs in cars]
        if MeasuredPart.LIBRARY in parts:
            found |= _library(cycles)
        if MeasuredPart.PLANS in parts and find_spec("rclpy") is None:
            note("rclpy is not installed: plans over DDS are left out")
        elif MeasuredPart.PLANS in parts:
            found["plans"] = _plans(plans)


def _library(cycles: Path | None) -> dict[str, Any]:
    throughput = measure_throughput(load_vehicle(CAR))
    _show_throughput(throughput)
    found: dict[str, Any] = {"library": throughput._asdict()}
    if cycles is not None:
        found["cycles"] = _cycles(cycles)
    return found


def _show_throughput(found: ForecastThroughput) -> None:
    rows = [
        ("vehicle file, numpy", f"{found.vehicle_file_ms:.0f} ms", "100 ms"),
        ("learned model, numpy", f"{found.learned_ms:.0f} ms", "100 ms"),
        ("learned model, torch", f"{found.torch_ms:.0f} ms", ""),
        ("  with the gradient", f"{found.torch_gradient_ms:.0f} ms", ""),
    ]
    show(figures_table(f"{BATCH} profiles of {POINTS} points, one core", rows))


def _cycles(folder: Path) -> Any:
    """Beside FASTSim; None without it."""
    installed = fastsim_version()
    if installed is None:
        note("fastsim is not installed: no comparison (benchmarks/fastsim_peer.py says how)")
        return None
    rows = list(compare_cycles(folder, load_vehicle(CAR)))
    columns = (
        ("cycle", "{0.cycle}"),
        ("fastsim Wh/km", "{1:.1f}"),
        ("same car", "{2:.1f}"),
        ("vehicle file", "{3:.1f}"),
        ("fastsim a step", "{0.fastsim_us:.1f} us"),
        ("ours", "{0.ours_us:.3f} us"),
        ("times", "{4:.0f}"),
    )
    show(
        table_of(
            f"Beside fastsim {installed}, Model 3, flat",
            [(row, *_wh_per_km(row), row.fastsim_us / row.ours_us) for row in rows],
            columns,
        )
    )
    return {"fastsim": installed, "rows": [row._asdict() for row in rows]}


def _wh_per_km(row: CycleRow) -> Iterator[float]:
    for joules in (row.fastsim_j, row.same_car_j, row.vehicle_file_j):
        yield joules / JOULES_PER_WH / (row.distance_m / 1e3)


def _plans(plans: int) -> dict[str, Any]:
    # Imported here: the rest works where no ROS is.
    from benchmarks.plan_load import measure_plans, measure_rounds

    with progress_bar("plans", total=plans, unit="plans") as progress:
        load = measure_plans(plans, POINTS, progress)
    rows = [
        ("p50", f"{load.p50_ms:.1f} ms", ""),
        ("p99", f"{load.p99_ms:.1f} ms", "20 ms"),
        ("largest", f"{load.largest_ms:.1f} ms", ""),
        ("the node's processor", f"{load.node_ms:.1f} ms", ""),
    ]
    show(
        figures_table(
            f"A plan of {POINTS} points, request to answer over DDS, {plans} times", rows
        )
    )
    with progress_bar("rounds", total=plans // 10, unit="rounds") as progress:
        rounds = measure_rounds(max(plans // 10, 1), TOGETHER, POINTS, progress)
    rows = [
        (f"{TOGETHER} plans, p50", f"{rounds.p50_ms:.1f} ms", ""),
        (f"{TOGETHER} plans, p99", f"{rounds.p99_ms:.1f} ms", "60 ms"),
        ("a refusal, p50", f"{rounds.refusal_p50_ms:.1f} ms", ""),
        ("a refusal, p99", f"{rounds.refusal_p99_ms:.1f} ms", "100 ms"),
    ]
    show(figures_table(f"Plans asked together, with all differences, {rounds.rounds} times", rows))
    return {**load._asdict(), "together": rounds._asdict()}
