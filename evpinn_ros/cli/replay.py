"""`evpinn replay`: replays recorded drives through the estimator and the energy account."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer

from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.console import (
    command_line,
    note,
    progress_bar,
    say,
    show,
    track,
    working,
    write_json,
    writing,
)
from evpinn_ros.cli.interruption import Interruption
from evpinn_ros.cli.options import (
    TABLE_SUFFIX,
    KeptStateOption,
    MetricsOption,
    ParamsOption,
    ReportOption,
    StartOption,
    UnitsOption,
    VehicleOption,
    trends_beside,
    with_read_options,
)
from evpinn_ros.cli.table_columns import explain_columns, explain_notes
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.units import JOULES_PER_KWH, Units, UnitSystem
from evpinn_ros.common.writer import check_outputs, write_file
from evpinn_ros.core.estimation.estimator import Mode, PaperOptimizer
from evpinn_ros.core.estimation.state_file import StateClaim
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.logs.formats import files_of
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.trips import joined, split
from evpinn_ros.replays.car import CarReplay
from evpinn_ros.replays.drive_names import short_names
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.run import WARM_UP, Replayed, ReplayOptions, has_battery, output_folders
from evpinn_ros.replays.simulation.truth_file import read_truth
from evpinn_ros.replays.totals import metrics_csv, trends_csv
from evpinn_ros.report.breakdown_text import breakdown_columns, breakdown_lines, breakdown_rows
from evpinn_ros.report.dropped_text import dropped_text
from evpinn_ros.report.owner_text import (
    drives_columns,
    drives_rows,
    health_line,
    owner_line,
    owner_notes,
    scores_note,
)
from evpinn_ros.report.tables import (
    SCORE_COLUMNS,
    energy_lines,
    parameter_columns,
    parameter_rows,
    score_rows,
)

WIDE = 110  # characters of the table of drives


@with_read_options
def replay(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            help="Drives of one car, in order: bags, CAN logs or tables, or a folder of them."
        ),
    ],
    vehicle: VehicleOption = "generic",
    mode: Annotated[
        Mode | None, typer.Option(help="Learning method; hybrid if not given.")
    ] = None,
    optimizer: Annotated[
        PaperOptimizer | None, typer.Option(help="Optimizer of --mode paper.")
    ] = None,
    params: ParamsOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write inputs and results to this new bag; for several inputs, to a folder."
        ),
    ] = None,
    report: ReportOption = None,
    metrics: MetricsOption = None,
    units: UnitsOption = UnitSystem.METRIC,
    withhold_battery_after: Annotated[
        float | None,
        typer.Option(min=0.0, help="Hide the battery after N seconds and predict it from speed."),
    ] = None,
    warm_up: Annotated[
        float, typer.Option(min=0.0, help="Leave the first N seconds out of the scores.")
    ] = WARM_UP,
    state: KeptStateOption = None,
    rate: Annotated[
        float | None,
        typer.Option(
            min=0.01, help="Speed in multiples of real time; if not given, as fast as possible."
        ),
    ] = None,
    start: StartOption = 0.0,
    duration: Annotated[
        float | None, typer.Option(min=0.0, help="Replay only N seconds of each input.")
    ] = None,
    loop: Annotated[
        int, typer.Option(min=1, max=1000, help="Replay all inputs this many times.")
    ] = 1,
    whole: Annotated[
        bool,
        typer.Option("--whole", help="Take each file as one drive: neither split nor join files."),
    ] = False,
    read_options: ReadOptions = READ_DEFAULTS,
) -> None:
    """Replay recorded drives: learn the car, and show where the energy went.

    Gives the same numbers as the ROS nodes, without ROS, and scores every prediction. Each drive
    starts from what the drives before it taught. A log is split into trips where the car was
    parked or charged. All readable recordings in a folder are replayed.

    Example: evpinn replay bags/urban --vehicle tesla_model_3_lr --out out/urban
    """
    trends = trends_beside(metrics) if metrics and metrics.suffix == TABLE_SUFFIX else None
    check_outputs((metrics, trends, report, state, out), (*inputs, params, Path(vehicle)))
    with StateClaim(state):
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
            note(f"evpinn: {state} does not exist yet: the car starts from its vehicle file")
        open_input = partial(car.open, options=read_options)
        first, unreadable = _opened(open_input, inputs, whole)
        again = (
            opened_source
            for _ in range(loop - 1)
            for opened_source in _opened(open_input, inputs, whole)[0]
        )
        check_outputs((metrics, trends, report))  # now that every file of the inputs was opened
        with Interruption() as interruption:
            try:
                paths = [source.path for source in first] * loop
                several = len(inputs) > 1 or len(paths) > 1  # even if together they are one drive
                folders = output_folders(out, paths, several=several)
                said: set[str] = set()
                for source, folder in zip(chain(first, again), folders, strict=True):
                    if interruption.asked:
                        break
                    try:
                        replayed = _replay(car, source, folder, lambda: interruption.asked)
                    except InputError as error:
                        if len(folders) == 1:
                            raise
                        unreadable.append(str(error))
                        continue
                    if len(folders) > 1:
                        _show_briefly(replayed, source, car.vehicle, said, units.units)
                    else:
                        _show(replayed, source, car.vehicle, warm_up, units.units)
            finally:
                # If a later drive fails, the results of those before it are kept.
                written = _write(car, (state, metrics, report), units.units, len(inputs) > 1)
        if not car.results:
            raise InputError("; ".join(unreadable))
        if len(car.results) > 1:
            _show_together(car, units.units)
            show(parameter_table(car.results[-1].metrics))
            say("To see these drives side by side, use evpinn compare.")
        say(health_line(car.chain.account.gauge, [result.drive for result in car.results]))
        if (line := car.record()) is not None:
            say(line)
        for line in unreadable:
            note(f"evpinn: not replayed: {line}")
        if unreadable or not written or any(result.problem for result in car.results):
            raise typer.Exit(1)


def _opened(
    open_input: Callable[[Path], Source], inputs: Sequence[Path], whole: bool
) -> tuple[list[Source], list[str]]:
    """Trips of all inputs, and a line per unreadable file; InputError if there is no trip."""
    logs: list[Source] = []
    sources: list[Source] = []
    unreadable: list[str] = []
    paths = [path for given in inputs for path in files_of(given)]
    for path in track("finding columns", paths, "files"):
        try:
            logs.append(open_input(path))
        except InputError as error:
            unreadable.append(str(error))
    explain_columns(logs)
    with working("finding drives that go on in the next file"):
        drives = logs if whole else joined(logs)
    if len(drives) < len(logs):
        note(f"{len(logs)} files make {len(drives)} logs: some continue the file before them")
    for log in track("finding trips", drives, "logs"):
        try:
            # Blocks of many logs, kept until their replay, would fill the memory.
            trips, charged = split(log, whole=whole, ahead=len(drives) == 1)
        except InputError as error:
            unreadable.append(str(error))
            continue
        sources += trips
        if len(trips) > 1:
            kwh = f"; charged while parked: {charged / JOULES_PER_KWH:.1f} kWh" if charged else ""
            note(f"{log.path}: {len(trips)} trips{kwh}")
    if not sources:
        raise InputError("; ".join(unreadable) or "no recording in this folder")
    return sources, unreadable


def _replay(
    car: CarReplay, source: Source, folder: Path | None, stopped: Callable[[], bool]
) -> Replayed:
    with ExitStack() as stack:
        writer = None
        if folder is not None:
            stack.enter_context(writing(folder))
            writer = stack.enter_context(BagWriter(folder))
        seconds = car.options.seconds_of(source.seconds)
        progress = stack.enter_context(progress_bar(source.path.name, total=seconds))
        replayed = car.replay(source, writer=writer, progress=progress, stopped=stopped)
        if seconds is not None and not stopped():
            progress(seconds)  # also where the rest of the drive has no reading that counts
        return replayed


def _show_briefly(
    result: Replayed, source: Source, vehicle: Vehicle, said: set[str], units: Units
) -> None:
    """Print a line for one of many drives, and its doubts that are not in `said`."""
    metrics = result.metrics
    if result.problem:
        note(f"evpinn: {result.problem}")
    said.update(explain_notes(source, said))
    dropped = dropped_text(metrics["input"]["dropped"])
    line = owner_line(result.drive, metrics, units) + (dropped and f" Not used: {dropped}.")
    if not has_battery(result.drive):
        line += " No battery voltage and current; nothing could be learned."
    say(f"{metrics['input']['path']}: {line}")
    doubts = [line for line in owner_notes(vehicle, result.drive, metrics) if line not in said]
    for line in doubts:
        say(line)
    said.update(doubts)


def _show(
    result: Replayed, source: Source, vehicle: Vehicle, warm_up: float, units: Units
) -> None:
    metrics = result.metrics
    if result.problem:
        note(f"evpinn: {result.problem}")
    explain_notes(source)
    if not has_battery(result.drive):
        note(f"evpinn: {source.path}: no battery voltage and current; nothing could be learned")
    say(
        f"{metrics['input']['path']}: {result.drive.duration:.0f} s, {metrics['vehicle']}, "
        f"{metrics['mode']}, {metrics['replay']['realtime_factor'] or 0:.0f} x real time"
    )
    if dropped := dropped_text(metrics["input"]["dropped"]):
        say(f"Not used: {dropped}")
    say(owner_line(result.drive, metrics, units))
    for line in owner_notes(vehicle, result.drive, metrics):
        say(line)
    _show_breakdown(metrics["breakdown"], units)
    show(score_table(result.drive, metrics, warm_up))
    if result.drive.duration <= warm_up:
        say(
            f"Nothing was scored, because the drive is not longer than the {warm_up:.0f} s of "
            "warm-up; --warm-up changes that."
        )
    for line in energy_lines(metrics):
        say(line)
    show(parameter_table(metrics, read_truth(source.path)))


def _show_together(car: CarReplay, units: Units) -> None:
    breakdown = car.breakdown()
    names = short_names([Path(result.metrics["input"]["path"]) for result in car.results])
    named = [
        (name, result.drive, result.metrics)
        for name, result in zip(names, car.results, strict=True)
    ]
    rows = drives_rows(named, breakdown, units)
    columns = drives_columns(units)
    # A name that folds would be read as two.
    table = PlainTable("Drives", columns, rows, words=("took most",), unbroken=columns[:1])
    show(table, at_least=WIDE)
    say(scores_note(rows))
    _show_breakdown(breakdown, units, "the energy of all drives")


def _show_breakdown(breakdown: Mapping[str, Any], units: Units, of: str = "the energy") -> None:
    if breakdown["unknown"] is None:
        rows = breakdown_rows(breakdown, units)
        show(PlainTable(f"Where {of} went", breakdown_columns(units), rows))
    for line in breakdown_lines(breakdown, units):
        say(line)


def parameter_table(metrics: Mapping[str, Any], truth: Parameters | None = None) -> PlainTable:
    """Live value, 1-sigma, prior share and status of each parameter, and its truth if given."""
    columns = parameter_columns(truth)
    rows = parameter_rows(metrics, truth)
    return PlainTable("Parameters of the car", columns, rows, words=("state",))


def score_table(drive: Drive, metrics: Mapping[str, Any], warm_up: float = WARM_UP) -> PlainTable:
    """Scores of predicted power, beside those of the baselines."""
    title = f"Power, predicted before it was learned from; the first {warm_up:.0f} s not scored"
    return PlainTable(title, SCORE_COLUMNS, score_rows(drive, metrics, warm_up))


def _write(
    car: CarReplay,
    files: tuple[Path | None, Path | None, Path | None],
    units: Units,
    several: bool,
) -> bool:
    if not car.results:
        return True
    state, metrics, report = files
    jobs: list[tuple[Path | None, Callable[[Path], None]]] = [
        (state, car.write_state),  # first, because nothing else holds it
        (metrics, lambda path: _write_metrics(path, car, several)),
        (report, lambda path: _write_report(path, car, units)),
    ]
    problems = 0
    for path, write in jobs:
        try:
            if path is not None:
                with as_input_error(path, ValueError), working(f"writing {path}"):
                    write(path)
        except InputError as error:
            problems += 1
            note(f"evpinn: {error}")
    return problems == 0


def _write_metrics(path: Path, car: CarReplay, several: bool) -> None:
    several |= len(car.results) > 1
    drives = car.metrics() if several else [car.results[0].metrics]
    if path.suffix == TABLE_SUFFIX:
        write_file(path, metrics_csv(drives))
        if (trends := trends_csv(drives)) is not None:
            write_file(trends_beside(path), trends)
    else:
        write_json(path, drives if several else drives[0])


def _write_report(path: Path, car: CarReplay, units: Units) -> None:
    # Imported here: pictures take longer to import than everything else together.
    from evpinn_ros.report.drive_page import write_replayed

    of_all = car.breakdown() if len(car.results) > 1 else None
    gauge = car.chain.account.gauge
    write_replayed(
        path,
        car.results,
        car.vehicle,
        car.options,
        command_line(),
        units,
        of_all,
        gauge=gauge,
        record=car.record(),
    )
