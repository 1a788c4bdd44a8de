"""Time of the processor that the processes of a bench take."""

from __future__ import annotations

import os
from pathlib import Path

from evpinn_ros.common.errors import InputError


def processor_seconds(pid: int) -> float:
    """Time of the processor that a process has taken.

    Raises:
        InputError: no such process any more, or no Linux.
    """
    try:
        # The name of the program, in brackets, may hold blanks.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError as error:
        raise InputError(f"the process ended, or this is no Linux: {error}") from error
    user, system = int(fields[11]), int(fields[12])
    return (user + system) / os.sysconf("SC_CLK_TCK")
