"""The report of a live drive, made from its recording when the drive has ended."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import math
from pathlib import Path
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import typer

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.cli.console import note
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import check_file
from evpinn_ros.common.stopping import stopped_by
from evpinn_ros.common.writer import copy_file
from evpinn_ros.core.estimation.state_file import account_path

POLL_S = 0.2
CUT_SHORT_S = 20.0
"""Time that a report may take after SIGTERM; a service manager kills after 90 s."""

ONE_WISH_S = 1.0  # within which signals are one; another does not wait

TERMINATED = 143  # 128 + SIGTERM, as shells have it


@contextmanager
def reported(
    report: Path, record: Path | None, state: Path | None, options: Sequence[str]
) -> Iterator[Path]:
    """The bag to record to, of which `evpinn replay` makes a report after the drive.

    Without `record` the bag lies beside the report until that is made; `state` is copied first.
    InputError: no place for the report, or no such state. typer.Exit: there is no report.
    """
    if report.is_dir():
        raise InputError(f"--report {report}: a folder is there; give the name of a file")
    with as_input_error():
        report.parent.mkdir(parents=True, exist_ok=True)
        beside = TemporaryDirectory(prefix=f".{report.stem}_", dir=report.parent)
        if state is not None and state.exists() and check_file(state):
            before = Path(beside.name, "state.json")
            copy_file(state, before)
            if account_path(state).exists():
                copy_file(account_path(state), account_path(before))
            options = (*options, "--state", str(before))
    with beside as folder:
        bag = record or Path(folder, "bag")
        other = bag.is_file() or (bag.is_dir() and any(bag.iterdir()))
        yield bag
        if other or not bag.exists() or _is_empty(bag):
            return  # nothing was recorded, and the nodes have logged the reason
        note(f"evpinn: writing {report}; Ctrl-C cuts it short")
        command = [sys.executable, "-m", "evpinn_ros", "replay", str(bag), *options]
        if code := _run([*command, "--report", str(report)]):
            if record is None:
                kept = bag.rename(report.parent / Path(folder).name.lstrip("."))
                note(f"evpinn: the report is not whole; the drive is kept: {kept}")
            raise typer.Exit(code)


def _run(command: list[str]) -> int:
    """Run a command, which a signal to stop cuts short, apart from this process's nodes."""
    asked_s: list[float] = []
    with stopped_by(lambda *_: asked_s.append(time.monotonic())):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
        signalled_s = -math.inf
        while True:
            try:
                code = process.wait(POLL_S)
            except subprocess.TimeoutExpired:
                if asked_s and time.monotonic() - asked_s[0] > CUT_SHORT_S:
                    process.kill()
                elif asked_s and asked_s[-1] - signalled_s > ONE_WISH_S:
                    signalled_s = asked_s[-1]
                    process.send_signal(signal.SIGINT)
            else:
                return code if code >= 0 else TERMINATED


def _is_empty(bag: Path) -> bool:
    with BagReader(bag) as reader:
        return not any(True for _ in reader.log_times())
