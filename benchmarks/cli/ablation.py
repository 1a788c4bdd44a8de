"""`evpinn bench ablation`: what each part of the core is worth without the battery."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import product
from typing import Annotated, Any

import typer

from benchmarks.ablation import CARS, NO_TRIM, VARIANTS, SecondsRow, seconds
from benchmarks.cli.output import TABLE_WIDTH, json_at_the_end, names_in, number, table_of
from benchmarks.unseen.drives import cars_in
from benchmarks.variants import SCORE_COLUMNS, SEEDS, VariantRow, read_car, score
from evpinn_ros.cli.console import progress_bar, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.plain_table import PlainTable


def ablation(
    data: Annotated[str, typer.Argument(help="Folder of data, as in `evpinn bench unseen`.")],
    cars: Annotated[
        str, typer.Option(help=f"By comma; else {', '.join(CARS)}, those that are there.")
    ] = "",
    seeds: Annotated[int, typer.Option(min=1, help="Networks whose scores are averaged.")] = len(
        SEEDS
    ),
    trim: Annotated[
        bool, typer.Option("--trim", help="Score the trim of the last seconds instead; slow.")
    ] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    json_file: JsonOption = None,
) -> None:
    """Leave out each part of the core in turn, and score drives.

    Example: evpinn bench ablation $DATA --cars i3,e208
    """
    there = [] if cars else cars_in(data)
    keys = names_in(cars) or [key for key in CARS if key in there]
    rows: list[Any] = []
    variants = (VARIANTS[0], NO_TRIM) if trim else VARIANTS
    with (
        json_at_the_end(json_file, lambda: list(map(_found, rows))),
        ProcessPoolExecutor(jobs, initializer=limit_blas_threads) as pool,
        progress_bar("variants", len(keys) * len(variants), unit="variants") as progress,
    ):
        if trim:
            tasks: Any = [(data, *pair) for pair in product(keys, variants)]
            results: Any = pool.map(seconds, *zip(*tasks, strict=True))
        else:
            read = [read_car(data, key) for key in keys]
            tasks = [(each, car, range(seeds)) for car, each in product(read, variants)]
            results = pool.map(score, *zip(*tasks, strict=True))
        for row in results:
            rows.append(row)
            progress(len(rows))
    if trim:
        show(_seconds_table(rows), at_least=TABLE_WIDTH)
        return
    for key in keys:
        _show([row for row in rows if row.car == key])


def _found(row: VariantRow | SecondsRow) -> dict[str, Any]:
    return asdict(row) if isinstance(row, VariantRow) else row._asdict()


def _show(rows: list[VariantRow]) -> None:
    whole = rows[0]
    lost = ["", *("{:+.2f} +- {:.2f}".format(*whole.gain(row)) for row in rows[1:])]
    columns = ("left out", "{0.variant}"), *SCORE_COLUMNS, ("lost likelihood", "{1}")
    table = table_of(whole.car, list(zip(rows, lost, strict=True)), columns)
    show(table, at_least=TABLE_WIDTH)


def _seconds_table(rows: list[SecondsRow]) -> PlainTable:
    ages = list(dict.fromkeys(age for row in rows for age in row.ages))
    headers = "car", "left out", *(f"{age} s: RMSE W" for age in ages)
    cells = (
        (row.car, row.variant, *(number(row.ages.get(age), ".0f") for age in ages)) for row in rows
    )
    return PlainTable("Since the last battery sample", headers, cells, words=headers[:2])
