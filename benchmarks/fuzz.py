"""Drives atheris over the table of `fuzz_targets`, a process for each target."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
import re
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from benchmarks.fuzz_targets import Target
from evpinn_ros.common.errors import InputError

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


def fuzz(target: Target, inputs: int, seconds: int, crashes: Path, seed: int) -> FuzzResult:
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
            cwd=Path(__file__).parents[1],
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
