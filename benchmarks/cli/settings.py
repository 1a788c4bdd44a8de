"""`evpinn bench settings`: each car scored with constants of the core chosen without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Annotated, Any

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
from benchmarks.variants import SCORE_COLUMNS, Variant, VariantRow, read_car, score
from evpinn_ros.cli.console import show
from evpinn_ros.cli.options import MetricsOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable


def settings(
    data: DataArgument,
    cars: Annotated[str, cars_option(CARS)] = "",
    jobs: JobsOption = 2,
    metrics: MetricsOption = None,
) -> None:
    """Score each car with constants that the other cars chose.

    The constants are chosen by likelihood. For comparison, the core with its own constants is
    scored too, and with constants chosen on the scored car.

    Example: evpinn bench settings $DATA --cars model3,e208,leaf2013
    """
    keys = chosen_cars(data, cars, CARS)
    lonely = [key for key in keys if not others(key, keys)]
    if lonely:
        raise InputError(f"--cars: {lonely[0]} needs another car, which chooses for it")
    scores: dict[str, dict[str, VariantRow]] = {key: {} for key in keys}
    finals: dict[str, dict[str, VariantRow]] = {key: {} for key in keys}
    chosen: dict[str, list[Variant]] = {}
    with json_at_the_end(metrics, lambda: _found(scores, chosen, finals)):
        recorded = list(in_parallel("cars read", jobs, read_car, [(data, key) for key in keys]))
        tasks = [(each, car) for car in recorded for each in alternatives()]
        for row in in_parallel("alternatives on cars", jobs, score, tasks):
            scores[row.car][row.variant] = row
        chosen |= {key: final_variants(scores, key) for key in keys}
        tasks = [(each, car) for car in recorded for each in chosen[car.key]]
        for row in in_parallel("chosen constants", jobs, score, tasks):
            finals[row.car][row.variant] = row
        _show_alternatives(scores)
        _show_chosen(chosen, finals)


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
