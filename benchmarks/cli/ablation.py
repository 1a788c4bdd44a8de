"""`evpinn bench ablation`: what each part of the core is worth without the battery."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from benchmarks.ablation import CARS, VARIANTS
from benchmarks.cli.output import (
    TABLE_WIDTH,
    DataArgument,
    JobsOption,
    cars_option,
    chosen_cars,
    in_parallel,
    json_at_the_end,
    table_of,
)
from benchmarks.variants import SCORE_COLUMNS, SEEDS, VariantRow, read_car, score
from evpinn_ros.cli.console import show
from evpinn_ros.cli.options import JsonOption


def ablation(
    data: DataArgument,
    cars: Annotated[str, cars_option(CARS)] = "",
    seeds: Annotated[int, typer.Option(min=1, help="Networks whose scores are averaged.")] = len(
        SEEDS
    ),
    jobs: JobsOption = 2,
    json_file: JsonOption = None,
) -> None:
    """Leave out each part of the core in turn, and score drives.

    Example: evpinn bench ablation $DATA --cars i3,e208
    """
    keys = chosen_cars(data, cars, CARS)
    rows: list[VariantRow] = []
    with json_at_the_end(json_file, lambda: list(map(asdict, rows))):
        read = [read_car(data, key) for key in keys]
        tasks = [(each, car, range(seeds)) for car in read for each in VARIANTS]
        for row in in_parallel("variants", jobs, score, tasks):
            rows.append(row)
    for key in keys:
        _show([row for row in rows if row.car == key])


def _show(rows: list[VariantRow]) -> None:
    whole = rows[0]
    lost = ["", *("{:+.2f} +- {:.2f}".format(*whole.gain(row)) for row in rows[1:])]
    columns = ("left out", "{0.variant}"), *SCORE_COLUMNS, ("lost likelihood", "{1}")
    table = table_of(whole.car, list(zip(rows, lost, strict=True)), columns)
    show(table, at_least=TABLE_WIDTH)
