"""`evpinn bench soak`: hours of driving in one run, and what the nodes take of a computer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.util import find_spec
import time
from typing import Annotated, Any

import typer

from benchmarks.cli.output import figures_table, json_at_the_end, table_of
from benchmarks.soak import HOUR, Hour, memory_growth, time_drift
from benchmarks.soak import soak as drive_for
from evpinn_ros.cli.console import note, progress_bar, show
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
    seconds: Annotated[
        float, typer.Option(min=0.0, help="To watch the three nodes in real time; 0: not at all.")
    ] = 120.0,
    json_file: JsonOption = None,
) -> None:
    """Drive for a day in one run, and watch memory and speed.

    Then the three nodes run in one process, in real time, and are watched too.

    Example: evpinn bench soak --hours 24 --json out/soak.json
    """
    limit_blas_threads()
    found: dict[str, Any] = {"hours": []}
    with json_at_the_end(json_file, lambda: found):
        _soak(hours, seconds, found)


def _soak(hours: int, seconds: float, found: dict[str, Any]) -> None:
    rows: list[Hour] = []
    try:
        with progress_bar("driving", total=hours * HOUR) as progress:
            for hour in drive_for(hours, time.process_time, progress):
                rows.append(hour)
                found["hours"].append(hour._asdict())
    finally:
        numbered = list(enumerate(rows, start=1))
        show(table_of("One chain, hour by hour", numbered, COLUMNS, left=0))
    summary = list(_summary(rows))
    if seconds:
        if find_spec("rclpy") is None:
            note("rclpy is not installed: the nodes themselves are left out")
        else:
            found["nodes"], lines = _watch_nodes(seconds)
            summary += lines
    show(figures_table("For years", summary))


def _watch_nodes(seconds: float) -> tuple[dict[str, Any], list[tuple[str, str, str]]]:
    # Imported here: the rest works where no ROS is.
    from benchmarks.onboard_load import measure_onboard

    with progress_bar("three nodes", total=seconds) as progress:
        load = measure_onboard(seconds, progress)
    return asdict(load), [
        ("three nodes in one process, memory", f"{load.resident_mb:.0f} MB", "600 MB"),
        ("  share of one core at 10 Hz", f"{load.core_share:.1%}", "25 %"),
    ]


def _summary(rows: Sequence[Hour]) -> Iterator[tuple[str, str, str]]:
    yield "memory, largest after the first hour", f"{memory_growth(rows):+.2%}", "2 %"
    yield "time of a reading, last quarter to first", f"{time_drift(rows):+.2%}", "0"
