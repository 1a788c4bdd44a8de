"""`evpinn bench soak`: hours of driving in one run, and what the nodes take of a computer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.util import find_spec
import time
from typing import Annotated, Any

import typer

from benchmarks.soak import HOUR, Hour, memory_growth, time_drift
from benchmarks.soak import soak as drive_for
from evpinn_ros.cli.console import note, progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.cli.tables import figures_table, titled_table
from evpinn_ros.common.blas_threads import limit_blas_threads


def soak(
    hours: Annotated[int, typer.Option(min=2, help="Of driving, through one chain.")] = 24,
    seconds: Annotated[
        float, typer.Option(min=0.0, help="To watch the three nodes in real time; 0: not at all.")
    ] = 120.0,
    json_file: JsonOption = None,
) -> None:
    """Drive for a day in one run: is memory flat, does each reading take what it took at first?

    Then the three nodes run in one process, in real time, and are watched.

    Example: evpinn bench soak --hours 24 --json out/soak.json
    """
    limit_blas_threads()
    found: dict[str, Any] = {"hours": []}
    try:
        _soak(hours, seconds, found)
    finally:  # Ctrl-C leaves the hours so far
        if json_file is not None:
            write_json(json_file, found)


def _soak(hours: int, seconds: float, found: dict[str, Any]) -> None:
    rows: list[Hour] = []
    try:
        with progress_bar("driving", total=hours * HOUR) as progress:
            for hour in drive_for(hours, time.process_time, progress):
                rows.append(hour)
                found["hours"].append(hour._asdict())
    finally:
        _show(rows)
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


def _show(rows: Sequence[Hour]) -> None:
    table = titled_table("One chain, hour by hour")
    for column in ("hour", "readings", "memory", "per reading", "energy so far"):
        table.add_column(column, justify="right")
    for number, row in enumerate(rows, start=1):
        table.add_row(
            str(number),
            str(row.readings),
            f"{row.resident_mb:.1f} MB",
            f"{row.us_per_reading:.0f} us",
            f"{row.energy / 3.6e6:.2f} kWh",
        )
    show(table)


def _summary(rows: Sequence[Hour]) -> Iterator[tuple[str, str, str]]:
    yield "memory, largest after the first hour", f"{memory_growth(rows):+.2%}", "2 %"
    yield "time of a reading, last quarter to first", f"{time_drift(rows):+.2%}", "0"
