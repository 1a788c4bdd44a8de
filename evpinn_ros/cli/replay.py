"""`evpinn replay`: recorded drives through the whole chain."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
import itertools
from pathlib import Path
from typing import Annotated, Any

import typer

from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.console import command_line, note, progress_bar, say, show, write_json, writing
from evpinn_ros.cli.interruption import Interruption
from evpinn_ros.cli.options import (
    CanProfileOption,
    ColumnOption,
    MetricsOption,
    ParamsOption,
    StartOption,
    TrustProfileOption,
    VehicleOption,
)
from evpinn_ros.cli.table_columns import explain_columns, explain_notes
from evpinn_ros.cli.tables import breakdown_table, drives_table, parameter_table, score_table
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.units import Units, UnitSystem
from evpinn_ros.common.writer import check_outputs
from evpinn_ros.drives.sources import Source
from evpinn_ros.estimation.estimator import Mode
from evpinn_ros.paper.settings import PaperOptimizer
from evpinn_ros.replays.breakdown_text import breakdown_lines
from evpinn_ros.replays.car import CarReplay
from evpinn_ros.replays.owner_text import owner_line
from evpinn_ros.replays.run import (
    WARM_UP,
    Replayed,
    ReplayOptions,
    has_battery,
    output_folders,
)
from evpinn_ros.replays.tables import energy_lines
from evpinn_ros.simulation.truth_file import read_truth

WIDE = 110  # characters of the table of drives


def replay(
    inputs: Annotated[
        list[Path], typer.Argument(help="Bags, CAN logs or tables of one car, in order.")
    ],
    vehicle: VehicleOption = "generic",
    mode: Annotated[Mode | None, typer.Option(help="How to learn; hybrid if not given.")] = None,
    optimizer: Annotated[
        PaperOptimizer | None,
        typer.Option(help="Of mode paper; as published, or other."),
    ] = None,
    params: ParamsOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="New bag of inputs and outputs; for several inputs a folder."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write a report, one HTML file.")] = None,
    metrics: MetricsOption = None,
    units: Annotated[
        UnitSystem, typer.Option(help="Of distances, here and in the report.")
    ] = UnitSystem.METRIC,
    withhold_battery_after: Annotated[
        float | None,
        typer.Option(min=0.0, help="Hide the battery from here on, s: what is speed worth alone?"),
    ] = None,
    warm_up: Annotated[float, typer.Option(min=0.0, help="Not scored at the start, s.")] = WARM_UP,
    state: Annotated[
        Path | None,
        typer.Option(help="What was learned: read at the start if there, written at the end."),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(min=0.01, help="Of real time; else as fast as it can.")
    ] = None,
    start: StartOption = 0.0,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this much of each input, s.")
    ] = None,
    loop: Annotated[
        int, typer.Option(min=1, max=1000, help="Replay all inputs so many times.")
    ] = 1,
    column: ColumnOption = None,
    can_profile: CanProfileOption = None,
    trust_profile: TrustProfileOption = False,
) -> None:
    """Replay recorded drives, and score every prediction.

    The same cores as in the nodes, without ROS: readings, samples, learning, power, energy. What
    one input teaches is carried over to the next, and from one turn of --loop to the next.

    Example: evpinn replay bags/urban --vehicle tesla_model_3_lr --out out/urban
    """
    check_outputs((metrics, report, state, out), (*inputs, params, Path(vehicle)))
    car = CarReplay(
        vehicle,
        ReplayOptions(withhold_battery_after, warm_up, rate, start, duration),
        mode=mode,
        optimizer=optimizer,
        params=params,
        state=state,
    )
    if car.missing:
        note(f"evpinn: {car.missing}")
    elif state is not None and not state.exists():
        note(f"evpinn: {state} is not there yet: the car begins as its vehicle file says")
    open_input = partial(
        car.open, can_profile=can_profile, trust_profile=trust_profile, columns=column or ()
    )
    first = [open_input(path) for path in inputs]
    for source in first:
        explain_columns(source)
    again = (open_input(path) for _ in range(loop - 1) for path in inputs)
    with Interruption() as interruption:
        try:
            folders = output_folders(out, inputs * loop)
            for source, folder in zip(itertools.chain(first, again), folders, strict=True):
                if interruption.asked:
                    break
                found = _one(car, source, folder, lambda: interruption.asked)
                _show(found, source, warm_up, len(folders) > 1, units.units)
        finally:
            # Whatever ends a later drive, the results of those before it are kept.
            written = _write(car, (metrics, report, state), units.units)
    if len(car.done) > 1:
        drives = drives_table([(each.drive, each.metrics) for each in car.done], units.units)
        show(drives, at_least=WIDE)
        show(parameter_table(car.done[-1].metrics))
        say("evpinn compare puts the breakdowns of these drives side by side.")
    if not written or any(result.problem for result in car.done):
        raise typer.Exit(1)


def _one(
    car: CarReplay, source: Source, folder: Path | None, stopped: Callable[[], bool]
) -> Replayed:
    """Replay one drive, into a bag if there is a folder for it."""
    with ExitStack() as stack:
        writer = None
        if folder is not None:
            stack.enter_context(writing(folder))
            writer = stack.enter_context(BagWriter(folder))
        seconds = car.options.seconds_of(source.seconds)
        progress = stack.enter_context(progress_bar(source.path.name, total=seconds))
        return car.replay(source, writer=writer, progress=progress, stopped=stopped)


def _show(result: Replayed, source: Source, warm_up: float, briefly: bool, units: Units) -> None:
    """Tables for people, of one of many drives a line, and one for each thing that was missing."""
    found = result.metrics
    if result.problem:
        note(f"evpinn: {result.problem}")
    explain_notes(source)
    if not has_battery(result.drive):
        note(f"evpinn: {source.path}: no battery voltage and current; nothing could be learned")
    say(
        f"{found['input']['path']}: {result.drive.duration:.0f} s, {found['vehicle']}, "
        f"{found['mode']}, {found['replay']['realtime_factor'] or 0:.0f} x real time"
    )
    dropped = ", ".join(f"{n} {reason}" for reason, n in found["input"]["dropped"].items())
    if dropped:
        say(f"Dropped readings: {dropped}")
    say(owner_line(result.drive, found, units))
    if briefly:
        return
    if found["breakdown"]["unknown"] is None:
        show(breakdown_table(found["breakdown"], units))
    for line in breakdown_lines(found["breakdown"], units):
        say(line)
    show(score_table(result.drive, found, warm_up))
    for line in energy_lines(found):
        say(line)
    show(parameter_table(found, read_truth(source.path)))


def _write(
    car: CarReplay, files: tuple[Path | None, Path | None, Path | None], units: Units
) -> bool:
    """Write all that was asked for; one file that cannot be written does not cost the others."""
    if not car.done:
        return True
    metrics, report, state = files
    jobs: list[tuple[Path | None, Callable[[Path], None]]] = [
        (metrics, lambda path: _write_metrics(path, car.done)),
        (report, lambda path: _write_report(path, car, units)),
        (state, car.write_state),
    ]
    problems = 0
    for path, write in jobs:
        try:
            if path is not None:
                with as_input_error(path, ValueError):
                    write(path)
        except InputError as error:
            problems += 1
            note(f"evpinn: {error}")
    return problems == 0


def _write_metrics(path: Path, done: list[Replayed]) -> None:
    found: list[dict[str, Any]] = [result.metrics for result in done]
    write_json(path, found if len(found) > 1 else found[0])


def _write_report(path: Path, car: CarReplay, units: Units) -> None:
    # Here, for pictures take longer to import than all else together.
    from evpinn_ros.report.drive_page import write_replayed

    write_replayed(path, car.done, car.vehicle, car.options, command_line(), units)
