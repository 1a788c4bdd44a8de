"""`evpinn bench plans`: plans made of driven trips, forecast from the drives before them."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any

import typer

from benchmarks.cli.output import TABLE_WIDTH, json_at_the_end, names_in, table_of
from benchmarks.empty import EMPTY_COLUMNS, empty_scores
from benchmarks.plans import CARS, PLAN_COLUMNS, plan_scores
from benchmarks.unseen.drives import cars_in
from evpinn_ros.cli.console import progress_bar, show
from evpinn_ros.cli.options import MetricsOption
from evpinn_ros.common.blas_threads import limit_blas_threads


def plans(
    data: Annotated[str, typer.Argument(help="Folder of data, as in `evpinn bench unseen`.")],
    cars: Annotated[
        str, typer.Option(help=f"By comma; else {', '.join(CARS)}, those that are there.")
    ] = "",
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    metrics: MetricsOption = None,
) -> None:
    """Forecast recorded trips as plans of several resolutions, and score that.

    Cells: bias / median error in %; share of 90 % intervals that hold the measured energy; their
    width in % of gross energy. A second table scores the distance to empty along the same drives.

    Example: evpinn bench plans $DATA --cars i3,changchun
    """
    there = cars_in(data)
    keys = names_in(cars) or [key for key in CARS if key in there]
    rows: list[Any] = []
    roads: list[Any] = []
    with (
        json_at_the_end(metrics, lambda: [asdict(row) for row in (*rows, *roads)]),
        ProcessPoolExecutor(jobs, initializer=limit_blas_threads) as pool,
        progress_bar("cars", 2 * len(keys)) as report,
    ):
        planned = pool.map(partial(plan_scores, data), keys)
        driven = pool.map(partial(empty_scores, data), keys)
        for number, found in enumerate(planned, start=1):
            rows += found
            report(number)
        for number, more in enumerate(driven, start=len(keys) + 1):
            roads += more
            report(number)
    show(table_of("Plans", rows, PLAN_COLUMNS, left=3), at_least=TABLE_WIDTH)
    show(table_of("Distance to empty", roads, EMPTY_COLUMNS, left=1), at_least=TABLE_WIDTH)
