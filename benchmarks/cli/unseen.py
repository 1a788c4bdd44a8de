"""`evpinn bench unseen`: scores methods on drives whose battery is hidden from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from benchmarks.cli.output import TABLE_WIDTH, figures_table, json_as_it_comes, names_in
from benchmarks.fastsim_peer import fastsim_version
from benchmarks.unseen.drives import cars_in
from benchmarks.unseen.goals import car_table, figures
from benchmarks.unseen.run import (
    CORE,
    METHODS,
    WEAK_LS,
    Task,
    TaskResult,
    find_method,
    run_tasks,
)
from benchmarks.unseen.sumo_cars import sumo_is_there
from benchmarks.unseen.table import (
    LEGEND,
    age_table,
    energy_table,
    score_table,
    truth_table,
    unscored,
)
from benchmarks.unseen.truth import KINDS
from evpinn_ros.cli.console import note, progress_bar, say, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.errors import InputError


def unseen(
    data: Annotated[
        str,
        typer.Argument(
            metavar="DATA",
            help="PATH=VEHICLE: your recordings of one car; or the folder of this project's cars.",
        ),
    ],
    cars: Annotated[str, typer.Option(help="Only these cars, joined by commas.")] = "",
    methods: Annotated[
        str,
        typer.Option(
            help=f"Methods, joined by commas; if not given, {', '.join(METHODS)}.",
            show_default=False,
        ),
    ] = ",".join(METHODS),
    method: Annotated[
        list[str] | None,
        typer.Option(help="Your own method, as FILE.py:CLASS; see CONTRIBUTING.md."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    json_file: JsonOption = None,
) -> None:
    """Score every method on drives and dropouts whose battery is hidden.

    Each drive is predicted from what the drives before it taught, and then learned from. Errors of
    energy are in percent of the measured net energy, or of the gross energy: the sum of drawn and
    regenerated energy.

    Example: evpinn bench unseen $DATA --cars model3,i3 --methods weak_ls,core --jobs 2
    """
    names = [*names_in(methods), *(method or ())]
    for name in names:
        find_method(name)
    one_car = "=" in data
    present = [*cars_in(data, recorded=not cars), *(() if one_car else KINDS)]
    if not (one_car or sumo_is_there()):
        note("evpinn: eclipse-sumo and libsumo are not installed: cars by SUMO are left out")
    if not one_car and fastsim_version() is None:
        note("evpinn: fastsim is not installed: cars by FASTSim are left out")
    chosen = _chosen(names_in(cars), present)
    tasks = [Task(data, car, name) for car in chosen for name in names]
    by_car: dict[str, Any] = {}
    with (
        json_as_it_comes(json_file, lambda: {"data": data, "cars": by_car}, [data]) as keep,
        progress_bar("methods on cars", len(tasks), unit="done") as progress,
    ):
        for number, result in enumerate(run_tasks(tasks, jobs, progress), start=1):
            _add(by_car, result)
            keep()
            progress(number)
            entry = by_car[result.task.car]
            if len(entry["methods"]) == len(names):
                _show(result.task.car, entry, names)
    for line in LEGEND.splitlines():
        say(line)
    if not one_car:
        _show_goals(by_car)


def _chosen(wanted: Sequence[str], present: Sequence[str]) -> Sequence[str]:
    unknown = [name for name in wanted if name not in present]
    if unknown or not present:
        raise InputError(
            f"no car '{', '.join(unknown)}'; there are {', '.join(present) or 'none'}"
        )
    return wanted or present


def _add(by_car: dict[str, Any], result: TaskResult) -> None:
    fresh = {
        "vehicle": result.vehicle,
        "drives": result.drives,
        "hours": round(result.hours, 3),
        "methods": {},
    }
    entry = by_car.setdefault(result.task.car, fresh)
    entry["methods"][result.task.method] = result.scores


def _show(car: str, entry: dict[str, Any], names: Sequence[str]) -> None:
    # Without the folder of a method's file, because tables are narrow.
    methods = {name.rpartition("/")[2]: entry["methods"][name] for name in names}
    title = f"{car}: {entry['drives']} drives, {entry['hours']:.1f} h, {entry['vehicle']}"
    say()
    say(title)
    if "carried" in next(iter(methods.values())):
        for table in (score_table, energy_table, age_table):
            show(table(methods), at_least=TABLE_WIDTH)
        for line in unscored(methods):
            say(line)
    if "truth" in next(iter(methods.values())):
        show(truth_table(methods), at_least=TABLE_WIDTH)


def _show_goals(by_car: dict[str, Any]) -> None:
    """Goals over all cars that the core was scored on."""
    rows = {car: entry["methods"] for car, entry in by_car.items()}
    core = {car: methods[CORE] for car, methods in rows.items() if CORE in methods}
    core = {car: scores for car, scores in core.items() if "carried" in scores}
    beside = {car: methods[WEAK_LS] for car, methods in rows.items() if WEAK_LS in methods}
    if core:
        say()
        say("The core over weak_ls, and its goals")
        show(car_table(core, beside), at_least=TABLE_WIDTH)
        show(figures_table("", figures(core, beside)), at_least=TABLE_WIDTH)
