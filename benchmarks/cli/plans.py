"""`evpinn bench plans`: forecasts driven trips as plans, learned from the drives before them."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from benchmarks.cli import output
from benchmarks.empty import EMPTY_COLUMNS, empty_scores
from benchmarks.plans import CARS, PLAN_COLUMNS, plan_scores
from evpinn_ros.cli.console import show
from evpinn_ros.cli.options import JsonOption


def plans(
    data: output.DataArgument,
    cars: Annotated[str, output.cars_option(CARS)] = "",
    jobs: output.JobsOption = 2,
    json_file: JsonOption = None,
) -> None:
    """Forecast recorded trips as plans of several resolutions, and score the forecasts.

    Bias, median and mean error in %; share of 90 % intervals that hold the measured energy; their
    median width in % of gross energy; for all drives and by mean speed. A second table scores the
    distance to empty along the same drives.

    Example: evpinn bench plans $DATA --cars i3,changchun
    """
    keys = output.chosen_cars(data, cars, CARS)
    tasks = [(data, key) for key in keys]
    rows: list[Any] = []
    roads: list[Any] = []
    with output.json_as_it_comes(
        json_file, lambda: [asdict(row) for row in (*rows, *roads)], (data, *keys)
    ) as keep:
        for car_scores in output.in_parallel("plans of cars", jobs, plan_scores, tasks):
            rows += car_scores
            keep()
        for more in output.in_parallel("distance to empty of cars", jobs, empty_scores, tasks):
            roads += more
            keep()
    show(output.table_of("Plans", rows, PLAN_COLUMNS, left=4), at_least=output.TABLE_WIDTH)
    show(
        output.table_of("Distance to empty", roads, EMPTY_COLUMNS, left=1),
        at_least=output.TABLE_WIDTH,
    )
