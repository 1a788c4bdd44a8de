"""The report of a live drive, made when it has ended from what was recorded of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory

import typer

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.cli.console import note
from evpinn_ros.errors import InputError


@contextmanager
def reported(
    report: Path, record: Path | None, state: Path | None, options: Sequence[str]
) -> Iterator[Path]:
    """The bag to record to, which `evpinn replay` makes a report of after the drive.

    Args:
        report: HTML file to write.
        record: where the person wants the bag; without, it lies beside the report until the end,
            and stays there if no report comes of it.
        state: what was learned before the drive, as the nodes start from it too.
        options: more of `evpinn replay`.

    Raises:
        InputError: there is no place for the report, or the state cannot be read.
        typer.Exit: there is no report.
    """
    if report.is_dir():
        raise InputError(f"--report {report}: a folder is there; give the name of a file")
    try:
        report.parent.mkdir(parents=True, exist_ok=True)
        beside = TemporaryDirectory(prefix=f".{report.stem}_", dir=report.parent)
        if state is not None and state.exists():
            before = shutil.copy(state, Path(beside.name, "state.json"))
            options = (*options, "--state", str(before))
    except OSError as error:
        raise InputError(f"{error.filename or report}: {error.strerror}") from error
    with beside as folder:
        bag = record or Path(folder, "bag")
        other = bag.is_file() or (bag.is_dir() and any(bag.iterdir()))
        yield bag
        if other or not bag.exists() or _is_empty(bag):
            return  # nothing was recorded, and the nodes have said why
        note(f"evpinn: writing {report}; Ctrl-C cuts it short")
        # A process of its own: this one's threads, signals and memory are those of the nodes.
        command = [sys.executable, "-m", "evpinn_ros", "replay", str(bag), *options]
        done = subprocess.run([*command, "--report", str(report)], stdout=subprocess.DEVNULL)
        if done.returncode:
            if record is None:
                kept = bag.rename(report.parent / Path(folder).name.lstrip("."))
                note(f"evpinn: no report; the drive is kept: {kept}")
            raise typer.Exit(done.returncode)


def _is_empty(bag: Path) -> bool:
    with BagReader(bag) as reader:
        return not any(True for _ in reader.log_times())
