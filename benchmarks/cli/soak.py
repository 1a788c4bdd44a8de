"""`evpinn bench soak`: hours of driving in one run, with memory and time watched."""

from __future__ import annotations

import time
from typing import Annotated

import typer

from benchmarks.cli.output import figures_table, json_at_the_end, table_of
from benchmarks.soak import HOUR, Hour, memory_growth, time_drift
from benchmarks.soak import soak as drive_for
from evpinn_ros.cli.console import progress_bar, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.blas_threads import limit_blas_threads

COLUMNS = (
    ("hour", "{0}"),
    ("readings", "{1.readings}"),
    ("memory", "{1.resident_mb:.1f} MB"),
    ("per reading", "{1.us_per_reading:.0f} us"),
    ("energy so far", "{1.energy_kwh:.2f} kWh"),
)


def soak(
    hours: Annotated[int, typer.Option(min=2, help="Hours of driving through one chain.")] = 24,
    json_file: JsonOption = None,
) -> None:
    """Drive for a day in one run, and watch memory and speed.

    Example: evpinn bench soak --hours 24 --json out/soak.json
    """
    limit_blas_threads()
    rows: list[Hour] = []
    with json_at_the_end(json_file, lambda: {"hours": [row._asdict() for row in rows]}):
        try:
            with progress_bar("driving", total=hours * HOUR) as progress:
                for hour in drive_for(hours, time.process_time, progress):
                    rows.append(hour)
        finally:
            numbered = list(enumerate(rows, start=1))
            show(table_of("One chain, hour by hour", numbered, COLUMNS, left=0))
    figures = [
        ("memory, largest after the first hour", f"{memory_growth(rows):+.2%}", "2 %"),
        ("time of a reading, last quarter to first", f"{time_drift(rows):+.2%}", "0"),
    ]
    show(figures_table("For years", figures))
