"""`evpinn bench recover`: broken bags saved, against the whole ones."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

import typer

from benchmarks.cli.output import json_at_the_end, table_of
from benchmarks.recovery import STORAGES, campaign, measure_speed
from evpinn_ros.cli.console import progress_bar, say, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.units import MEGABYTE

BAG_BYTES = 200_000


def recover(
    cases: Annotated[int, typer.Option(min=12, help="Bags to break.")] = 1000,
    seed: Annotated[int, typer.Option(help="Seed of bags and faults.")] = 0,
    megabytes: Annotated[
        int, typer.Option(min=0, help="MB of the bags that measure speed; 0 leaves it out.")
    ] = 60,
    json_file: JsonOption = None,
) -> None:
    """Break bags in every way, save them, compare with the original, and time it.

    Example: evpinn bench recover --cases 1000 --json out/recover.json
    """
    found: dict[str, Any] = {"campaign": [], "speed": []}
    with json_at_the_end(json_file, lambda: found):
        _break(cases, seed, found["campaign"])
        for storage in STORAGES if megabytes else ():
            wall, processor = measure_speed(storage, int(megabytes * MEGABYTE))
            found["speed"].append({"storage": storage, "wall": wall, "processor": processor})
            say(
                f"{storage}: {wall / MEGABYTE:.0f} MB/s, "
                f"{processor / MEGABYTE:.0f} MB for each second of the processor"
            )


def _break(cases: int, seed: int, rows: list[dict[str, Any]]) -> None:
    names = ("storage", "fault", "cases", "messages", "missing", "altered", "unread", "miscounted")
    columns = [(name, f"{{0[{name}]}}") for name in names]
    try:
        with progress_bar("bags broken and saved", total=cases, unit="bags") as progress:
            for storage, fault, tally in campaign(cases, BAG_BYTES, seed, progress):
                rows.append({"storage": storage, "fault": fault, **asdict(tally)})
    finally:
        show(table_of("Broken bags saved", rows, columns, left=2))
