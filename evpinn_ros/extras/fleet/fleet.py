"""`evpinn fleet`: learns many cars, and the priors of their models."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
import signal
from typing import Annotated, Any

import typer

from evpinn_ros.can.profile import load_profile
from evpinn_ros.cli.console import command_line, note, progress_bar, say, show, write_json
from evpinn_ros.cli.options import JsonOption, VehicleOption
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.stopping import stopped_by
from evpinn_ros.common.writer import Held, check_outputs, mark
from evpinn_ros.core.vehicle.files import write_vehicle
from evpinn_ros.extras.fleet.car import CarDone, CarTask, car_folder, learn_car
from evpinn_ros.extras.fleet.executor import DaskExecutor, Executor, LocalExecutor, TaskOutcome
from evpinn_ros.extras.fleet.manifest import (
    YAML,
    CarDrives,
    cars_by_folder,
    cars_by_manifest,
    load_model,
)
from evpinn_ros.extras.fleet.page import (
    POPULATION_HEAD,
    fleet_sentence,
    population_cells,
    write_fleet_page,
)
from evpinn_ros.extras.fleet.tables import (
    CARS,
    DRIVES,
    POPULATION,
    FleetSummary,
    population_rows,
    require_extra,
    write_tables,
)

REPORT, LOCK, STOP = "report.html", ".lock", ".stop"
MOST_SHOWN = 20  # problems printed; the tables hold all


def fleet(
    bags: Annotated[
        list[str] | None,
        typer.Argument(help="Files, folders or patterns; each top-level folder is one car."),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder of the results; the next run continues from them.")
    ] = Path("fleet"),
    vehicle: VehicleOption = "generic",
    manifest: Annotated[
        Path | None, typer.Option(help="YAML or CSV with the car and model of each drive.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Number of processes; one per core if not given."),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler of a cluster.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="HTML report; report.html in OUT if not given.")
    ] = None,
    write_vehicle_to: Annotated[
        Path | None,
        typer.Option(
            "--write-vehicle",
            metavar="OUT.yaml",
            help="Vehicle file to write for the next car of this model; "
            "for several models, a folder.",
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Learn each car from its drives, and priors for the next car of its model.

    Finished work is kept: after a stop, the same command continues. A drive that fails does not
    stop the others.

    Example: evpinn fleet drives/ --vehicle bmw_i3 --write-vehicle i3_fleet.yaml
    """
    require_extra()
    cars = _cars(bags or [], vehicle, manifest)
    models = sorted({car.vehicle.key for car in cars})
    if len(models) > 1 and write_vehicle_to and write_vehicle_to.suffix in YAML:
        names = ", ".join(models)
        raise InputError(f"{write_vehicle_to}: one file for {names}; give the name of a folder")
    for profile in filter(None, {car.vehicle.can_profile for car in cars}):
        load_profile(profile)  # opened here too, so that no output overwrites it
    drives = (drive for car in cars for drive in car.drives)
    report = report or out / REPORT
    tables = (out / name for name in (DRIVES, CARS, POPULATION))
    check_outputs(
        (report, write_vehicle_to, json_file, *tables), (manifest, Path(vehicle), *drives)
    )
    executor: Executor = DaskExecutor(scheduler) if scheduler else LocalExecutor(workers)
    with claimed(out):
        failed: dict[str, str] = {}
        stopped = not _learn(cars, out, executor, failed)
        summary = write_tables(out, cars, failed)
        _write(summary, report, write_vehicle_to)
    _show(summary, out)
    if json_file is not None:
        write_json(json_file, {"out": str(out), "stopped": stopped, **_as_json(summary)})
    if stopped:
        note("evpinn: stopped; the same command continues")
    if stopped or failed or not summary.counts["learned"]:
        raise typer.Exit(1)


@contextmanager
def claimed(out: Path) -> Iterator[None]:
    """Lock the folder of the results; InputError if it cannot be made or is locked."""
    with as_input_error(out):
        out.mkdir(parents=True, exist_ok=True)
    with as_input_error(out / LOCK):
        lock = Held(out / LOCK, f"{out}: another evpinn fleet writes there")
    with lock:
        with as_input_error(out):
            (out / STOP).unlink(missing_ok=True)
        yield


def learn_fleet(
    cars: Sequence[CarDrives], out: Path, executor: Executor
) -> Generator[TaskOutcome[CarTask, CarDone], None, None]:
    """Learn every car; when the iteration ends early, running tasks are stopped."""
    tasks = (CarTask(car, car_folder(out, car), out / STOP) for car in cars)
    try:
        yield from executor.outcomes(learn_car, tasks)
    except BaseException:
        mark(out / STOP)
        raise
    finally:
        executor.close()


def _cars(bags: list[str], vehicle: str, manifest: Path | None) -> list[CarDrives]:
    if manifest is not None:
        if bags:
            raise InputError(f"{manifest}: lists all drives; give no others")
        return cars_by_manifest(manifest)
    if not bags:
        raise InputError("give bags, folders of bags, or a --manifest")
    return cars_by_folder(bags, load_model(vehicle, Path()))


def _learn(cars: list[CarDrives], out: Path, executor: Executor, failed: dict[str, str]) -> bool:
    try:
        with (
            stopped_by(signal.default_int_handler),  # every signal acts as Ctrl-C
            progress_bar("evpinn fleet", len(cars), unit="cars") as progress,
        ):
            for finished, outcome in enumerate(
                learn_fleet(cars, out.resolve(), executor), start=1
            ):
                progress(finished)
                if outcome.problem is not None:
                    failed[outcome.task.drives.car] = outcome.problem
    except KeyboardInterrupt:
        return False
    return True


def _write(summary: FleetSummary, report: Path, vehicles: Path | None) -> None:
    with as_input_error():
        write_fleet_page(report, summary, command_line())
        for key, population in summary.populations.items():
            if vehicles is not None:
                path = vehicles if vehicles.suffix in YAML else vehicles / f"{key}.yaml"
                write_vehicle(path, population.priors("evpinn fleet"))


def _as_json(summary: FleetSummary) -> dict[str, Any]:
    """The summary for `--json`; the tables have all drives and cars."""
    return {
        **summary.counts,
        "failed": [{"what": what, "why": why} for what, why in summary.problems],
        "populations": {
            key: {row.pop("name"): row for row in population_rows(key, population)}
            for key, population in summary.populations.items()
        },
    }


def _show(summary: FleetSummary, out: Path) -> None:
    for what, why in summary.problems[:MOST_SHOWN]:
        note(f"evpinn: {why}" if what in why else f"evpinn: {what}: {why}")
    counts = summary.counts
    if counts["problems"] > MOST_SHOWN:
        note(f"evpinn: and {counts['problems'] - MOST_SHOWN} more problems, in the tables")
    for key, population in summary.populations.items():
        name, _, *rest = POPULATION_HEAD  # the column of the vehicle file is only for the report
        rows = [(name, *cells) for name, _, *cells in population_cells(population)]
        show(PlainTable(f"Cars of model {key}", (name, *rest), rows, unbroken=rest))
    say(f"{out}: {fleet_sentence(counts)}")
