"""`evpinn bench fuzz`: damaged inputs for every parser of what comes from outside."""

from __future__ import annotations

from dataclasses import asdict
from importlib.util import find_spec
from math import ceil
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.cli.output import table_of
from benchmarks.fuzz import FuzzResult
from benchmarks.fuzz import fuzz as fuzz_target
from benchmarks.fuzz_targets import TARGETS
from evpinn_ros.cli.console import note, show, write_json
from evpinn_ros.cli.options import MetricsOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable


def fuzz(
    inputs: Annotated[int, typer.Option(min=1, help="In all, divided among the targets.")] = 10**6,
    seconds: Annotated[int, typer.Option(min=1, help="For each target at most.")] = 86400,
    target: Annotated[list[str] | None, typer.Option(help="Only this; may be repeated.")] = None,
    crashes: Annotated[Path, typer.Option(help="Folder for inputs that crash.")] = Path("crashes"),
    seed: Annotated[int, typer.Option(min=1, help="Another one gives other inputs.")] = 1,
    metrics: MetricsOption = None,
) -> None:
    """Feed parsers damaged inputs; look for crashes, hangs, memory.

    Example: evpinn bench fuzz --inputs 100000 --target mcap
    """
    if find_spec("atheris") is None:
        raise InputError("this needs atheris; pip install 'evpinn_ros[fuzz]'")
    known = {each.name: each for each in TARGETS}
    if unknown := sorted({*(target or ())} - known.keys()):
        raise InputError(f"no target '{unknown[0]}'; known are {', '.join(known)}")
    chosen = [known[name] for name in target or known]
    weights = sum(each.weight for each in chosen)
    found: list[FuzzResult] = []
    try:
        for each in chosen:
            part = ceil(inputs * each.weight / weights)
            found.append(fuzz_target(each, part, seconds, crashes, seed))
            last = found[-1]
            note(f"{last.target}: {last.inputs} inputs, {last.said or 'no crash'}")
    finally:  # Ctrl-C leaves the targets so far
        show(_table(found))
        if metrics is not None:
            rows = [asdict(each) | {"crash": str(each.crash or "")} for each in found]
            write_json(metrics, rows)
    if any(each.said for each in found):
        raise typer.Exit(1)


def _table(found: list[FuzzResult]) -> PlainTable:
    columns = (
        ("target", "{0.target}"),
        ("inputs", "{0.inputs}"),
        ("inputs/s", "{1:.0f}"),
        ("slowest, ms", "{2:.0f}"),
        ("memory, MB", "{0.memory_mb}"),
        ("crash", "{3}"),
    )
    rows = [
        (one, one.inputs / one.seconds, 1e3 * one.slowest_s, one.crash or one.said or "none")
        for one in found
    ]
    table = table_of("", rows, columns)
    table.add_row("all", str(sum(each.inputs for each in found)))
    return table
