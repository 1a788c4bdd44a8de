"""`evpinn bench plans`: plans made of driven trips, forecast from the drives before them."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from typing import Annotated

import typer

from benchmarks.cli.output import TABLE_WIDTH, json_at_the_end, names_in, table_of
from benchmarks.plans import CARS, PLAN_COLUMNS, PlanScore, plan_scores
from benchmarks.unseen.drives import cars_in
from evpinn_ros.cli.console import progress_bar, show
from evpinn_ros.cli.options import MetricsOption
from evpinn_ros.common.blas_threads import limit_blas_threads


def plans(
    data: Annotated[str, typer.Argument(help="Folder of cars, as of `evpinn bench unseen`.")],
    cars: Annotated[
        str, typer.Option(help=f"By comma; else {', '.join(CARS)}, those that are there.")
    ] = "",
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    metrics: MetricsOption = None,
) -> None:
    """Forecast driven trips as plans of several resolutions, and compare with what they took.

    Example: evpinn bench plans $DATA --cars i3,changchun
    """
    there = cars_in(data)
    keys = names_in(cars) or [key for key in CARS if key in there]
    rows: list[PlanScore] = []
    with (
        json_at_the_end(metrics, lambda: [asdict(row) for row in rows]),
        ProcessPoolExecutor(jobs, initializer=limit_blas_threads) as pool,
        progress_bar("cars", len(keys)) as report,
    ):
        for number, found in enumerate(pool.map(partial(plan_scores, data), keys), start=1):
            rows += found
            report(number)
    show(table_of("Plans", rows, PLAN_COLUMNS, left=3), at_least=TABLE_WIDTH)
