"""`evpinn bench settings`: each car scored with constants of the core chosen without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any

import typer

from benchmarks.cli.output import TABLE_WIDTH, json_at_the_end, table_of
from benchmarks.settings import (
    CARS,
    PRODUCT,
    Scores,
    alternatives,
    changes_text,
    final_variants,
    others,
    support,
)
from benchmarks.unseen.drives import cars_in
from benchmarks.variants import SCORE_COLUMNS, RecordedCar, Variant, VariantRow, read_car, score
from evpinn_ros.cli.console import progress_bar, show
from evpinn_ros.cli.options import MetricsOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable


def settings(
    data: Annotated[str, typer.Argument(help="Folder of data, as in `evpinn bench unseen`.")],
    cars: Annotated[
        str,
        typer.Option(help=f"By comma; else {', '.join(CARS)}, those that are there."),
    ] = "",
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    metrics: MetricsOption = None,
) -> None:
    """Score each car with constants that the other cars chose.

    The constants are chosen by likelihood. For comparison, the core with its own constants is
    scored too, and with constants chosen on the scored car.

    Example: evpinn bench settings $DATA --cars model3,e208,leaf2013
    """
    there = cars_in(data)
    keys = cars.split(",") if cars else [key for key in CARS if key in there]
    lonely = [key for key in keys if not others(key, keys)]
    if lonely:
        raise InputError(f"--cars: {lonely[0]} needs another car, which chooses for it")
    scores: dict[str, dict[str, VariantRow]] = {key: {} for key in keys}
    finals: dict[str, dict[str, VariantRow]] = {key: {} for key in keys}
    chosen: dict[str, list[Variant]] = {}
    with json_at_the_end(metrics, lambda: _found(scores, chosen, finals)):
        with ProcessPoolExecutor(jobs, initializer=limit_blas_threads) as pool:
            recorded = list(pool.map(partial(read_car, data), keys))
            tasks = [(each, car) for car in recorded for each in alternatives()]
            _score(pool, "alternatives on cars", tasks, scores)
            chosen |= {key: final_variants(scores, key) for key in keys}
            tasks = [(each, car) for car in recorded for each in chosen[car.key]]
            _score(pool, "chosen constants", tasks, finals)
        _show_alternatives(scores)
        _show_chosen(chosen, finals)


def _score(
    pool: ProcessPoolExecutor,
    title: str,
    tasks: Sequence[tuple[Variant, RecordedCar]],
    scores: dict[str, dict[str, VariantRow]],
) -> None:
    with progress_bar(title, len(tasks), unit="done") as progress:
        for number, row in enumerate(pool.map(score, *zip(*tasks, strict=True)), start=1):
            scores[row.car][row.variant] = row
            progress(number)


def _found(
    scores: Scores, chosen: Mapping[str, Sequence[Variant]], finals: Scores
) -> dict[str, list[dict[str, Any]]]:
    return {
        "alternatives": [asdict(row) for rows in scores.values() for row in rows.values()],
        "chosen": [
            {"changes": changes_text(each.changes), **asdict(finals[key][each.name])}
            for key, variants in chosen.items()
            for each in variants
            if each.name in finals[key]
        ],
    }


def _show_alternatives(scores: Scores) -> None:
    title = "Likelihood less that of the product's constants"
    table = PlainTable(title, ("instead", *scores, "all cars"))
    for variant in alternatives()[1:]:
        gains = [
            support(scores, judges, variant.name) - support(scores, judges, PRODUCT)
            for judges in (*([key] for key in scores), list(scores))
        ]
        table.add_row(variant.name, *(f"{gain:+.2f}" for gain in gains))
    show(table, at_least=TABLE_WIDTH)


def _show_chosen(chosen: Mapping[str, Sequence[Variant]], finals: Scores) -> None:
    changes = {
        (key, each.name): changes_text(each.changes) or "-"
        for key, variants in chosen.items()
        for each in variants
    }
    columns = (
        ("car", "{0.car}"),
        ("constants", "{0.variant}"),
        ("other than the product's", "{1}"),
        *SCORE_COLUMNS,
    )
    rows = [(finals[key][name], text) for (key, name), text in changes.items()]
    title = "Scored with constants chosen without the car, and others beside"
    show(table_of(title, rows, columns, left=3), at_least=TABLE_WIDTH)
