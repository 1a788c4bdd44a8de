"""`evpinn compare`: drives of one car side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.cli.console import command_line, note, progress_bar, say, show, track, write_json
from evpinn_ros.cli.options import (
    JsonOption,
    ParamsOption,
    ReportOption,
    StartOption,
    UnitsOption,
    VehicleOption,
    with_read_options,
)
from evpinn_ros.cli.table_columns import explain_columns
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.units import Units, UnitSystem
from evpinn_ros.common.writer import check_outputs
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.replays.car import CarReplay
from evpinn_ros.replays.comparison import Comparison
from evpinn_ros.replays.comparison import compare as compare_drives
from evpinn_ros.replays.run import ReplayOptions
from evpinn_ros.report.compare_page import part_rows, sentences, trip_rows, write_comparison


@with_read_options
def compare(
    drives: Annotated[
        list[Path],
        typer.Argument(
            help="Drives of one car: bags, CAN logs or tables. Each is compared with the first."
        ),
    ],
    vehicle: VehicleOption = "generic",
    report: ReportOption = None,
    state: Annotated[
        Path | None,
        typer.Option(help="Start from this state file of evpinn replay; it is not changed."),
    ] = None,
    units: UnitsOption = UnitSystem.METRIC,
    start: StartOption = 0.0,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Compare only this many seconds of each drive.")
    ] = None,
    params: ParamsOption = None,
    read_options: ReadOptions = READ_DEFAULTS,
    json_file: JsonOption = None,
) -> None:
    """Compare drives of one car: where energy went, and what explains a difference.

    Compare, for example, the same road with other tyres, in another season or with another driver.
    One model of the car learns from all drives, so its errors mostly cancel in the differences.

    Example: evpinn compare bags/urban bags/highway --vehicle tesla_model_3_lr
    """
    if len(drives) < 2:
        raise typer.BadParameter("give at least two drives", param_hint="DRIVES...")
    check_outputs((report, json_file), (*drives, state, params, Path(vehicle)))
    if state is not None and not state.exists():
        raise InputError(f"{state}: no such file; evpinn replay --state writes it")
    options = ReplayOptions(start=start, duration=duration)
    car = CarReplay(vehicle, options, params=params, state=state, keep_drives=True)
    files = track("finding columns", drives, "files")
    sources = [car.open(path, read_options) for path in files]
    check_outputs((report, json_file))  # now that every file of the inputs was opened
    explain_columns(sources)
    comparison = compare_drives(
        car,
        sources,
        progress=lambda source: progress_bar(source.path.name, options.seconds_of(source.seconds)),
    )
    _show(comparison, units.units)
    if json_file is not None:
        write_json(json_file, comparison.metrics())
    if report is not None:
        write_comparison(report, comparison, command_line(), units.units)
    if comparison.problems:
        raise typer.Exit(1)


def _show(comparison: Comparison, units: Units) -> None:
    for problem in comparison.problems:
        note(f"evpinn: {problem}")
    rows = trip_rows(comparison, units) + part_rows(comparison.parts(), units=units)
    show(PlainTable(f"Where the energy went, {units.rate}", ("", *comparison.names), rows))
    less = tuple(f"{name} minus {comparison.names[0]}" for name in comparison.names[1:])
    rows = part_rows(comparison.differences(), signed=True, units=units)
    show(PlainTable("What explains the difference", ("", *less), rows))
    for line in sentences(comparison, units):
        say(line)
