"""`evpinn bench training`: how fast each optimiser reaches the loss of Adam as published."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.cli.output import table_of
from benchmarks.deepxde_peer import deepxde_version
from benchmarks.training import Timed, bench_training
from evpinn_ros.cli.console import note, show, write_json
from evpinn_ros.cli.options import JsonOption, VehicleOption
from evpinn_ros.cli.reproduce import training_progress
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.reproduction.drive_log import read_drive_log
from evpinn_ros.vehicle.files import load_vehicle


def training(
    log: Annotated[Path, typer.Argument(help="CSV, bag or CAN log of one drive.")],
    vehicle: VehicleOption,
    epochs: Annotated[int, typer.Option(min=1, help="Epochs of Adam, as published.")] = 10_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of split, networks and batches.")] = 0,
    json_file: JsonOption = None,
) -> None:
    """Time every optimiser to the validation loss that Adam as published ends with.

    The same drive, network, split and loss for all, one after the other in this process. DeepXDE
    takes part when it is installed (extra `bench`).

    Example: evpinn bench training drive.csv --vehicle bmw_i3 --epochs 10000
    """
    limit_blas_threads()
    car = load_vehicle(vehicle)
    drive = read_drive_log(log, car).drive
    if deepxde_version() is None:
        note("DeepXDE is not installed and takes no part: pip install 'evpinn_ros[bench]'")
    timed: list[Timed] = []
    try:
        with training_progress() as on_epoch:
            for one in bench_training(drive, car, epochs, seed, on_epoch):
                timed.append(one)
    finally:  # Ctrl-C leaves the trainings so far
        if timed:
            _show(timed)
        if json_file is not None:
            write_json(json_file, [asdict(one) for one in timed])


def _show(timed: list[Timed]) -> None:
    published = timed[0]
    rows = []
    for one in timed:
        ratio = f"{published.best_seconds / one.best_seconds:.1f}"
        faster = "1" if one is published else ratio if one.reached else "not reached"
        rows.append((one, 1000 * one.seconds / one.epochs, faster))
    columns = (
        ("training", "{0.title}"),
        ("epochs", "{0.best_epoch}"),
        ("seconds", "{0.best_seconds:.1f}"),
        ("ms/epoch", "{1:.0f}"),
        ("best loss", "{0.best:.6f}"),
        ("times as fast", "{2}"),
    )
    title = f"Time to a validation loss of {published.best:.6f}, Adam's best"
    show(table_of(title, rows, columns))
