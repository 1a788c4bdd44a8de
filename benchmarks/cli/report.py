"""`evpinn bench report`: how long the report of a drive takes, and how large it is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import shlex
import sys
import time
from typing import Annotated

import typer

from benchmarks.cli.output import figures_table
from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.cli.console import progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption, VehicleOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.units import MEGABYTE
from evpinn_ros.drives.sources import open_source
from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.run import ReplayOptions, replay
from evpinn_ros.report.drive_page import ReportedDrive, write_drives
from evpinn_ros.vehicle.files import load_vehicle


def report(
    drive: Annotated[Path, typer.Argument(help="Bag, CAN log or CSV; the goal is for an hour.")],
    vehicle: VehicleOption = "tesla_model_3_lr",
    out: Annotated[Path, typer.Option(help="The report.")] = Path("out/report.html"),
    json_file: JsonOption = None,
) -> None:
    """Time the report of a drive after its replay.

    Example: evpinn simulate hour --duration 3600 && evpinn bench report hour
    """
    limit_blas_threads()
    car, settings, options = load_vehicle(vehicle), EstimatorSettings(), ReplayOptions()
    chain = Chain(car, settings, InlineWorker(time.perf_counter))
    source = open_source(drive, car)
    with progress_bar("replay", total=stated_seconds(drive)) as progress:
        replayed = replay(
            source, chain, options, vehicle=car.key, mode=settings.mode.value, progress=progress
        )
    begin = time.perf_counter()
    reported = ReportedDrive(replayed.drive, replayed.metrics, car, options.warm_up)
    write_drives(out, [reported], shlex.join(["evpinn", *sys.argv[1:]]))
    seconds = time.perf_counter() - begin
    size = out.stat().st_size
    show(figures_table(f"Report of {drive.name}", _rows(replayed.metrics, seconds, size)))
    if json_file is not None:
        made = {"report_s": seconds, "report_bytes": size}
        write_json(json_file, {**replayed.metrics["input"], **replayed.metrics["replay"], **made})


def _rows(
    found: dict[str, dict[str, float]], seconds: float, size: int
) -> Iterator[tuple[str, str, str]]:
    yield "drive", f"{found['input']['duration_s']:.0f} s", ""
    yield "samples", f"{found['input']['samples']}", ""
    yield "replay", f"{found['replay']['wall_s']:.0f} s", ""
    yield "report", f"{seconds:.2f} s", "1 s"
    yield "size", f"{size / MEGABYTE:.2f} MB", "3 MB"
