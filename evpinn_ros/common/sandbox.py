"""Runs a foreign parser in its own process, because it may crash, hang or fill the memory.

The process is `python -m evpinn_ros.common.sandbox MODULE:FUNCTION IN OUT`; its limits depend on
the size of IN.
"""

from __future__ import annotations

import ctypes
from importlib import import_module
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
from typing import NamedTuple, NoReturn

from evpinn_ros.common.errors import one_line, printable
from evpinn_ros.common.opener import RATIO, check_file
from evpinn_ros.common.units import MEBIBYTE

MOST_MEMORY, MOST_OUTPUT = 2 << 30, 16 << 30
PATIENCE = 6.0  # times of its processor time that a process may wait for a core
PR_SET_PDEATHSIG = 1  # of Linux: signal that a process gets when its parent dies


class ParserLimits(NamedTuple):
    """Limits of a parser, beyond what its import needs."""

    memory: int  # bytes
    output: int  # bytes of the written file
    seconds: int  # of processor time

    @classmethod
    def of(cls, size: int) -> ParserLimits:
        """Limits for a file of this size, bytes; libraries need 5 to 20 times that for a table."""
        return cls(
            min(160 * MEBIBYTE + 40 * size, MOST_MEMORY),
            min(16 * MEBIBYTE + RATIO * size, MOST_OUTPUT),
            8 + 12 * size // MEBIBYTE,
        )


def run_apart(function: str, path: Path, out: Path) -> str | None:
    """Run `MODULE:NAME` on a file and an output path; returns why it failed, or None."""
    limits = ParserLimits.of(check_file(path))
    command = [sys.executable, "-B", "-m", __spec__.name, function, str(path), str(out)]
    few = {"POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env={**os.environ, **few},
    ) as process:
        try:
            _, errors = process.communicate(timeout=PATIENCE * limits.seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            return f"not read within {PATIENCE * limits.seconds:g} s"
        except BaseException:
            process.kill()
            raise
    return _reason(process.returncode, errors, limits) if process.returncode else None


def _reason(code: int, errors: str, limits: ParserLimits) -> str:
    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return f"takes more than {limits.seconds} s to read"
    # Allocators of C++ and Rust end the process when the memory is used up.
    if "memory allocation" in errors or "bad_alloc" in errors or "MemoryError" in errors:
        return f"takes more than {limits.memory // MEBIBYTE} MiB to read"
    if code < 0 or not errors.strip():
        return f"its parser crashed ({signal.Signals(-code).name if code < 0 else code})"
    return errors.strip().splitlines()[-1]


def _limit(limits: ParserLimits) -> None:
    statm = Path("/proc/self/statm").read_text(encoding="ascii")
    taken = int(statm.split()[0]) * resource.getpagesize()
    spent = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    for which, limit in (
        (resource.RLIMIT_AS, taken + limits.memory),
        (resource.RLIMIT_FSIZE, limits.output),
        (resource.RLIMIT_CPU, round(spent) + limits.seconds),
        (resource.RLIMIT_CORE, 0),
    ):
        most = resource.getrlimit(which)[1]
        limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
        resource.setrlimit(which, (limit, limit))


def be_the_parser(function: str, path: Path, out: Path) -> NoReturn:
    """Run the parser in this process and exit with 0, or with 1 and one line on stderr."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    code = 1
    try:
        module, name = function.split(":")
        work = getattr(import_module(module), name)
        _limit(ParserLimits.of(check_file(path)))
        work(path, out)
        code = 0
    except BaseException as error:  # a panic of Rust is not an Exception
        reason = "MemoryError" if isinstance(error, MemoryError) else one_line(error)
        print(printable(reason), file=sys.stderr)
    sys.stderr.flush()
    os._exit(code)  # without finalizers of libraries


if __name__ == "__main__":
    be_the_parser(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
