"""`evpinn bench breakdown`: compares breakdowns with the true energies of simulated cars."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from benchmarks.breakdown import PartCheck, difference_checks, part_checks, part_summaries
from benchmarks.cli.output import AltitudeOption, GradeOption, table_of
from benchmarks.height import CARS, alone_checks, height_checks
from benchmarks.truth import VEHICLES
from evpinn_ros.cli.console import progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import RMS_GRADE

WIDTH = 150  # characters; a narrower table would cut the names of joined parts
COLUMNS = (
    ("part", "{0.name}"),
    ("drives", "{0.drives}"),
    ("95 % covers %", "{0.coverage_percent:.1f}"),
    ("90 % covers %", "{0.coverage_90_percent:.1f}"),
    ("rms error / sigma", "{0.deviation:.2f}"),
    ("share %", "{0.share_percent:.1f}"),
    ("bias %", "{0.bias_percent:+.2f}"),
    ("rms error %", "{0.rms_percent:.2f}"),
    ("sigma %", "{0.sigma_percent:.2f}"),
)
FIRST_SEED = 12_000  # not used to choose constants


def breakdown(
    drives: Annotated[int, typer.Option(min=1, help="Drives, each of another car.")] = 60,
    seconds: Annotated[float, typer.Option(min=60.0, help="Length of a drive, s.")] = 600.0,
    rms_grade: GradeOption = RMS_GRADE,
    altitude: AltitudeOption = False,
    temperature: Annotated[
        bool, typer.Option("--temperature", help="With a thermometer.")
    ] = False,
    motor_torque: Annotated[
        bool, typer.Option("--motor-torque", help="With the torque of the motor.")
    ] = False,
    pairs: Annotated[
        bool, typer.Option("--pairs", help="Check the difference of two drives of each car.")
    ] = False,
    heights: Annotated[
        str, typer.Option(metavar="DATA", help="Check recorded drives with heights taken out.")
    ] = "",
    alone: Annotated[
        str,
        typer.Option(metavar="DATA", help="Check recorded drives learned one by one."),
    ] = "",
    cars: Annotated[
        str,
        typer.Option(
            help="Cars of --heights and --alone, joined by commas.",
            show_default=False,
        ),
    ] = ",".join(CARS),
    json_file: JsonOption = None,
) -> None:
    """Compare each part of the breakdown with its true energy, on simulated cars.

    The cars are drawn from the priors; they drive in town, on a motorway and on both in turn. With
    --heights DATA, breakdowns of recorded drives without their heights are compared with those
    with heights. With --alone DATA, the breakdown of a drive learned alone is compared with that
    learned from all drives of its car.

    Example: evpinn bench breakdown --drives 30
    """
    limit_blas_threads()
    part_rows: list[PartCheck] = []
    seeds = range(FIRST_SEED, FIRST_SEED + drives)
    if heights:
        checks = height_checks(heights, cars.split(","), drives)
    elif alone:
        checks = alone_checks(alone, cars.split(","), drives)
    elif pairs:
        checks = difference_checks(VEHICLES, seeds, seconds=seconds, altitude=altitude)
    else:
        checks = part_checks(
            list(DriveKind),
            VEHICLES,
            seeds,
            seconds=seconds,
            from_priors=True,
            rms_grade=rms_grade,
            altitude=altitude,
            temperature=temperature,
            motor_torque=motor_torque,
        )
    try:
        with progress_bar("drives", drives, unit="drives") as progress:
            for check in checks:
                part_rows.append(check)
                progress(len(part_rows) if heights or alone else check.seed - FIRST_SEED + 1)
    finally:  # Ctrl-C leaves the drives so far
        rows = part_summaries(part_rows)
        show(table_of("", rows, COLUMNS), at_least=WIDTH)
        if json_file is not None:
            write_json(json_file, [asdict(row) for row in rows])
