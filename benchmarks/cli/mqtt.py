"""`evpinn bench mqtt`: cost of the bridge between MQTT and the estimator."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from benchmarks.cli.output import json_at_the_end, table_of
from benchmarks.mqtt import DayCost, day, live
from evpinn_ros.cli.console import show
from evpinn_ros.cli.options import JsonOption

LIVE = (
    ("answers", "{.answers}"),
    ("median ms", "{.median_ms:.0f}"),
    ("p95 ms", "{.p95_ms:.0f}"),
    ("most ms", "{.most_ms:.0f}"),
    ("% of a core", "{.core_pct:.2f}"),
    ("MB", "{.memory_mb:.0f}"),
)
DAY = (("h", "{.hours:.1f}"), ("MB", "{.memory_mb:.1f}"), ("ms a second", "{.cpu_ms:.2f}"))


def mqtt(
    seconds: Annotated[
        int, typer.Option(min=0, help="Seconds of a drive at 1 Hz over a real mosquitto; 0: none.")
    ] = 120,
    hours: Annotated[
        float, typer.Option(min=0.0, help="Hours of driving at full speed; 0: none.")
    ] = 1.0,
    json_file: JsonOption = None,
) -> None:
    """Measure delay, processor and memory of `evpinn mqtt`.

    A drive is published second by second, as TeslaMate does it. 150 ms of the delay are a wait for
    messages of the same moment. Then the same drive is processed repeatedly without a broker. The
    long form is --hours 24.

    Example: evpinn bench mqtt --seconds 60 --hours 1
    """
    found: dict[str, Any] = {"live": None, "day": []}
    with json_at_the_end(json_file, lambda: found):
        if seconds:
            cost = live(seconds)
            found["live"] = cost._asdict()
            show(table_of("One car at 1 Hz, value to answer", [cost], LIVE))
        if hours:
            rows: list[DayCost] = []
            for row in day(hours):
                rows.append(row)
                found["day"].append(row._asdict())
            show(table_of("Driving at speed", rows, DAY))
