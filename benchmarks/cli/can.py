"""`evpinn bench can`: the CAN bridge under a full bus, and how quick a log is decoded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from importlib.util import find_spec
import os
from typing import Annotated, Any

import typer

from benchmarks.can_decoding import Throughput, measure_throughput
from benchmarks.can_traffic import Idle, measure_idle
from benchmarks.cli.output import BUSY, figures_table, json_at_the_end
from evpinn_ros.cli.console import note, progress_bar, show
from evpinn_ros.cli.options import JsonOption


def can(
    minutes: Annotated[
        float, typer.Option(min=0.05, help="How long the bus is full; the goal is for 10.")
    ] = 1.0,
    json_file: JsonOption = None,
) -> None:
    """Load the CAN bridge with a full bus, and time the decoder.

    The bus is UDP multicast on this machine: 4000 frames a second from one process, the bridge's
    executable in another, a subscriber in a third. The bus is then read again without
    decoding and publishing, to see how much time python-can itself takes.

    Example: evpinn bench can --minutes 10 --json out/can.json
    """
    found: dict[str, Any] = {"load_average": os.getloadavg()[0]}
    with json_at_the_end(json_file, lambda: found):
        _measure(found, minutes)


def _measure(found: dict[str, Any], minutes: float) -> None:
    if found["load_average"] > BUSY:
        note(f"other programs take {found['load_average']:.1f} cores: expect worse figures")
    throughput = measure_throughput()
    found["offline"] = asdict(throughput)
    show(figures_table("Decoding a log, one core", _offline_rows(throughput)))
    if find_spec("rclpy") is None:
        note("rclpy is not installed: the bridge itself is left out")
    else:
        found["live"] = _measure_live(60 * minutes)


def _measure_live(seconds: float) -> dict[str, Any]:
    # Imported here: the rest works where no ROS is.
    from benchmarks.bridge_load import Load, measure_load

    idle = measure_idle(seconds)
    with progress_bar("full bus", total=seconds) as progress:
        load: Load = measure_load(seconds, progress)
    rows = _live_rows(asdict(load), idle)
    show(figures_table(f"A full bus for {seconds / 60:g} min: 4000 frames a second", rows))
    return asdict(load) | {"idle": idle._asdict()}


def _live_rows(load: dict[str, Any], idle: Idle) -> Iterator[tuple[str, str, str]]:
    lost = load["frames_sent"] - load["frames_received"]
    missing = load["readings_sent"] - load["readings_heard"]
    p50, p99, largest = load["latency_ms"]
    yield "frames sent", str(load["frames_sent"]), ""
    yield "frames lost", str(lost), "0"
    yield "battery/state not received", f"{missing} of {load['readings_sent']}", ""
    yield "bridge, share of one core", f"{load['core_share']:.1%}", "20 %"
    yield "  of that python-can's reading", f"{idle.core_share:.1%}", ""
    yield "frame to subscriber, p50", f"{p50:.2f} ms", "2 ms"
    yield "frame to subscriber, p99", f"{p99:.2f} ms", "10 ms"
    yield "frame to subscriber, largest", f"{largest:.1f} ms", ""


def _offline_rows(throughput: Throughput) -> Iterator[tuple[str, str, str]]:
    yield "frames in memory to readings", f"{throughput.decoding:,.0f} a second", ""
    yield "  of the profile's ids alone", f"{throughput.decoding_known:,.0f} a second", ""
    yield "candump file to readings", f"{throughput.whole_file:,.0f} a second", "100,000 a second"
