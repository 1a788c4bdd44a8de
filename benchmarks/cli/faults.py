"""`evpinn bench faults`: each fault injected into running nodes, and what became of it."""

from __future__ import annotations

from dataclasses import asdict
import math
import os
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evpinn_ros.cli.console import note, say, show, write_json
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.plain_table import PlainTable

if TYPE_CHECKING:
    from benchmarks.faults.fault import FaultResult

BUSY = 0.3  # cores taken by other programs, from which times are not those of the nodes alone


def faults(
    only: Annotated[
        list[str] | None, typer.Option(help="This fault alone; may be given again.")
    ] = None,
    kills: Annotated[
        int, typer.Option(min=1, help="How often to kill at a random instant.")
    ] = 100,
    json_file: JsonOption = None,
) -> None:
    """Break what can break, one after the other, while the nodes run.

    Each fault is injected into nodes that run as separate processes, over DDS. The table shows
    what was lost, how long the recovery took, and how the diagnostics reported the fault. If one
    fails, the command exits with 1. All faults together take half an hour.

    Example: evpinn bench faults --only speed_nan --only unplug --kills 10
    """
    # Imported here: the rest of the commands work where no ROS is.
    from benchmarks.faults.campaign import run_campaign
    from benchmarks.faults.clocks import clock_setter

    if clock_setter() is None:
        note("libfaketime is not installed: system_clock_back and system_clock_ahead are left out")
    load = os.getloadavg()[0]
    if load > BUSY:
        note(f"other programs take {load:.1f} cores: expect longer times")
    found: list[FaultResult] = []
    try:
        for result in run_campaign(only or [], kills, lambda name: note(f"{name}...")):
            found.append(result)
            if result.problem is not None:
                note(f"{result.fault.name} failed: {result.problem} ({result.finding.lost})")
    finally:  # Ctrl-C leaves the faults so far
        _show(found)
        failed = sum(result.problem is not None for result in found)
        say(f"{len(found)} faults, {failed} failed")
        if json_file is not None:
            write_json(json_file, {"load_average": load, "faults": [_row(each) for each in found]})
    if failed:
        raise typer.Exit(1)


def _show(found: list[FaultResult]) -> None:
    table = PlainTable(
        "Faults, injected into running nodes",
        ("fault", "lost", "took", "limit", "diagnostics say", ""),
        words=("lost", "diagnostics say", ""),
        unbroken=("fault", "took", "limit", ""),
    )
    for each in found:
        finding = each.finding
        table.add_row(
            each.fault.name,
            finding.lost,
            _seconds(finding.seconds),
            _seconds(each.fault.limit),
            "-" if finding.said is None else finding.said,
            each.problem or "ok",
        )
    show(table)


def _seconds(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "never"
    return f"{1000 * seconds:.1f} ms" if seconds < 0.1 else f"{seconds:.2f} s"


def _row(result: FaultResult) -> dict[str, Any]:
    fault, finding = result.fault, asdict(result.finding)
    if not math.isfinite(finding["seconds"]):
        finding["seconds"] = None
    about = {"name": fault.name, "what": fault.what, "contract": fault.contract}
    return {**about, **finding, "limit": fault.limit, "problem": result.problem}
