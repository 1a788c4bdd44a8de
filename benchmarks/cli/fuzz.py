"""`evpinn bench fuzz`: damaged inputs for every parser of what comes from outside."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib.util import find_spec
import json
from math import ceil
from pathlib import Path
import re
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Annotated

import typer

from benchmarks.cli.output import table_of
from benchmarks.fuzz_targets import TARGETS, Target
from evpinn_ros.cli.console import note, show, write_json
from evpinn_ros.cli.options import MetricsOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable

LONGEST_INPUT = 16_384  # bytes; a longer one repeats what a short one says
MOST_SECONDS = 10  # for one input: more is a hang
MOST_MEMORY = 512  # MB of the process, of which instrumented libraries are most
STATISTICS = {"inputs": "number_of_executed_units", "memory_mb": "peak_rss_mb"}


@dataclass(frozen=True, slots=True)
class FuzzResult:
    """Result of one target."""

    target: str  # its name
    inputs: int  # that were parsed
    seconds: float  # they took, with loading
    slowest_s: float  # the longest of them
    memory_mb: int  # most of the process; instrumented libraries are most of that
    crash: Path | None  # the file with the input that crashed, hung or grew, None if none was kept
    said: str  # the error, empty if there was none


def fuzz_target(target: Target, inputs: int, seconds: int, crashes: Path, seed: int) -> FuzzResult:
    """Parse so many damaged inputs, or for so many seconds; stops at the first crash.

    Inputs that crash are kept in the folder `crashes`. Another seed gives other inputs.

    Raises:
        InputError: atheris is not installed, or did not start.
    """
    crashes.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        corpus, result = Path(folder, "corpus"), Path(folder, "result.json")
        corpus.mkdir()
        for number, sound in enumerate(target.seeds()):
            (corpus / str(number)).write_bytes(sound)
        options = {
            "runs": inputs,
            "max_total_time": seconds,
            "timeout": MOST_SECONDS,
            "rss_limit_mb": MOST_MEMORY,
            "max_len": LONGEST_INPUT,
            "len_control": 0,
            "seed": seed,
            "print_final_stats": 1,
            "artifact_prefix": f"{crashes.resolve()}/{target.name}-",
        }
        command = [sys.executable, "-m", "benchmarks.fuzz_child", target.name, str(result)]
        command += [f"-{name}={value}" for name, value in options.items()]
        begin = time.perf_counter()
        done = subprocess.run(
            [*command, str(corpus)],
            cwd=Path(__file__).parents[2],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        took = time.perf_counter() - begin
        slowest = json.loads(result.read_text())["slowest_s"] if result.exists() else 0.0
    found = {key: _statistic(done.stderr, name) for key, name in STATISTICS.items()}
    artifact = re.search(r"Test unit written to (\S+)", done.stderr)
    if not found["inputs"]:
        last = next(reversed(done.stderr.splitlines()), "atheris said nothing")
        raise InputError(f"{target.name}: exit code {done.returncode}: {last}")
    return FuzzResult(
        target=target.name,
        inputs=found["inputs"],
        seconds=took,
        slowest_s=slowest,
        memory_mb=found["memory_mb"],
        crash=Path(artifact[1]) if artifact else None,
        said=f"exit code {done.returncode}: {_reason(done.stderr)}" if done.returncode else "",
    )


def _statistic(text: str, name: str) -> int:
    found = re.search(rf"stat::{name}:\s+(\d+)", text)
    return int(found[1]) if found else 0


def _reason(text: str) -> str:
    """The error in what atheris and libFuzzer say."""
    found = re.search(r"Uncaught Python exception[^\n]*\n(.*)", text) or re.search(
        r"(ERROR: libFuzzer: .*)", text
    )
    return found[1].strip() if found else "for no reason given"


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
