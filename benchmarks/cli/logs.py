"""`evpinn bench logs`: logs of apps, read with no flag and checked against themselves."""

from __future__ import annotations

from dataclasses import asdict
import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from benchmarks.app_logs import LogRead, measure_large, read_log, write_large
from benchmarks.cli.output import json_at_the_end, table_of
from evpinn_ros.cli.console import note, progress_bar, say, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.formats import recordings


def logs(
    data: Annotated[list[Path], typer.Argument(help="Logs of apps, or folders of them.")],
    megabytes: Annotated[
        int, typer.Option(min=0, help="Rows of the table that measures speed; 0 leaves it out.")
    ] = 100,
    json_file: JsonOption = None,
) -> None:
    """Read logs of apps with no flag: distance, energy, time, memory.

    Example: evpinn bench logs logs/leafspy --json out/logs.json
    """
    found: dict[str, Any] = {"logs": [], "large": []}
    refused = 0
    with json_at_the_end(json_file, lambda: found):
        paths = sorted(path for each in data for path in recordings(each))
        with progress_bar("logs", total=len(paths), unit="logs") as progress:
            for done, path in enumerate(paths):
                try:
                    found["logs"].append(asdict(read_log(path)))
                except InputError as error:
                    refused += 1
                    note(f"evpinn: {error}")
                progress(done + 1)
        _show([LogRead(**each) for each in found["logs"]], refused)
        if megabytes:
            _measure(megabytes, found["large"])
    if refused:
        raise typer.Exit(1)


def _show(found: list[LogRead], refused: int) -> None:
    columns = (
        ("log", "{0.name}"),
        ("rows", "{0.rows}"),
        ("used", "{0.used}"),
        ("empty", "{0.empty}"),
        ("readings", "{0.readings}"),
        ("distance", "{1}"),
        ("energy", "{2}"),
    )
    rows = [(log, _off(log.way, log.odometer), _off(log.energy, log.charge)) for log in found]
    show(table_of("Logs of apps", rows, columns))
    lost = sum(log.rows - log.used - log.empty for log in found)
    say(
        f"{len(found)} logs read, {refused} refused; {sum(log.rows for log in found)} rows, "
        f"{lost} of them torn or without a time"
    )
    ways: dict[str, list[tuple[float, float]]] = {}
    for log in found:
        name = f"distance by '{log.speed_by}' against the odometer"
        ways.setdefault(name, []).append((log.way, log.odometer))
    for name, pairs in (
        *ways.items(),
        ("energy against the charge", [(log.energy, log.charge) for log in found]),
        ("energy against the log's own power", [(log.same, log.power) for log in found]),
    ):
        known = [pair for pair in pairs if math.isfinite(pair[0])]
        if known:
            one, other = (sum(column) for column in zip(*known, strict=True))
            each = sorted(pair[0] / pair[1] - 1 for pair in known if pair[1])
            say(
                f"{name}: {len(known)} logs, {one / other - 1:+.1%} together, "
                f"{each[len(each) // 2]:+.1%} in the median"
            )


def _measure(megabytes: int, rows: list[dict[str, float]]) -> None:
    with TemporaryDirectory() as folder:
        for size in (megabytes / 10, float(megabytes)):
            path = Path(folder) / "large.csv"
            write_large(path, size)
            seconds, processor, memory = measure_large(path)
            row = {"megabytes": size, "seconds": seconds, "processor_s": processor}
            rows.append({**row, "peak_mb": memory})
            say(
                f"{size:.0f} MB of CSV: {60 * size / seconds:.0f} MB a minute, "
                f"{60 * size / processor:.0f} a minute of the processor, "
                f"{memory:.0f} MB of memory at most"
            )


def _off(found: float, stated: float) -> str:
    return f"{found / stated - 1:+.1%}" if math.isfinite(found) and stated else ""
