"""Processor time and memory of processes, from /proc."""

from __future__ import annotations

import os
from pathlib import Path

from evpinn_ros.common.errors import InputError


def processor_seconds(pid: int) -> float:
    """Processor time of a process.

    Raises:
        InputError: the process has ended, or there is no /proc.
    """
    # The name of the program, in brackets, may hold blanks.
    fields = _proc_text(pid, "stat").rpartition(")")[2].split()
    user, system = int(fields[11]), int(fields[12])
    return (user + system) / os.sysconf("SC_CLK_TCK")


def resident_mb(process: int | str) -> float:
    """Resident memory of a process, MB.

    Raises:
        InputError: the process has ended, or there is no /proc.
    """
    lines = _proc_text(process, "status").splitlines()
    (line,) = (line for line in lines if line.startswith("VmRSS"))
    return int(line.split()[1]) * 1024 / 1e6


def _proc_text(process: int | str, file: str) -> str:
    try:
        return Path(f"/proc/{process}/{file}").read_text()
    except OSError as error:
        raise InputError(f"the process has ended, or there is no /proc: {error}") from error
