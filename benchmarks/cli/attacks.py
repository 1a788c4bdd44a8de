"""`evpinn bench attacks`: what the page on security promises, attacked."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.attack_seeds import SEEDS
from benchmarks.attacks import AttackResult, attack_all, two_writers
from benchmarks.cli.output import table_of
from evpinn_ros.cli.console import note, say, show, write_json
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.errors import InputError


def attacks(
    files: Annotated[int, typer.Option(min=0, help="Damaged files of each format.")] = 100,
    only: Annotated[list[str] | None, typer.Option(help="This format; may be repeated.")] = None,
    reads: Annotated[
        int, typer.Option(min=0, help="Reads of a state that two processes write.")
    ] = 1000,
    seed: Annotated[int, typer.Option(min=1, help="Another one gives other damage.")] = 1,
    kept: Annotated[Path, typer.Option(help="For files that break a promise.")] = Path("broken"),
    json_file: JsonOption = None,
) -> None:
    """Read damaged files of every format, and a state that two processes write.

    No file may take more than 300 MB, more than 10 s of processor time (or 3 s per MB), or end in
    a traceback. No read of the state may see half of it, and no save may be lost. If one of these
    fails, the command exits with 1. The long form is --files 3000 --reads 10000.

    Example: evpinn bench attacks --files 20 --only csv --reads 200
    """
    kinds = only or [*SEEDS]
    if unknown := [kind for kind in kinds if kind not in SEEDS]:
        raise InputError(f"no format '{unknown[0]}'; known are {', '.join(SEEDS)}")
    found: list[AttackResult] = []
    writers = None
    try:
        for result in attack_all(kinds if files else (), files, seed, kept):
            found.append(result)
            note(f"{result.kind}: {result.files} files, {len(result.broken)} broke a promise")
            for line in result.broken[:5]:
                note(line)
        if reads:
            writers = two_writers(reads)
            say(
                f"two writers: {writers.torn} of {writers.reads} reads torn, "
                f"{writers.lost} of {writers.saves} saves lost, {len(writers.left)} files left"
            )
    finally:  # Ctrl-C leaves the formats so far
        show(table_of("", found, COLUMNS))
        if json_file is not None:
            rows = [asdict(each) for each in found]
            write_json(json_file, {"files": rows, "writers": writers and asdict(writers)})
    if any(each.broken for each in found) or (writers and not writers.holds):
        raise typer.Exit(1)


COLUMNS = (
    ("format", "{0.kind}"),
    ("files", "{0.files}"),
    ("read", "{0.read}"),
    ("largest memory, MB", "{0.memory_mb:.0f}"),
    ("slowest, s", "{0.slowest_s:.1f}"),
)
