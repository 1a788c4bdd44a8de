"""Output to a person: results on stdout, everything else on stderr, progress on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
import shlex
import sys
import time
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from evpinn_ros.common.errors import InputError, as_input_error, printable
from evpinn_ros.common.json_text import json_text
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.writer import write_file
from evpinn_ros.core.signals.readings import NANOSECONDS

Report = Callable[..., None]
"""Reports progress: the amount done, in the bar's unit, and optionally a word to show."""

Item = TypeVar("Item")

STDOUT = "-"  # as the path of a file
DRIVE_SECONDS = "s of the drive"
LINE_PERIOD_S = 10.0  # between lines of progress in a pipe; shorter work prints none

results = Console(highlight=False)
notes = Console(stderr=True, highlight=False, soft_wrap=True)


def note(text: str) -> None:
    """Print one line on stderr."""
    notes.print(printable(text), markup=False)


def say(text: str = "", style: str = "") -> None:
    """Print one line of the results."""
    results.print(Text(printable(text), style), soft_wrap=True)


def show(table: PlainTable, at_least: int = 0) -> None:
    """Print a table of results at the terminal's width, but at least `at_least` characters."""
    narrow = results.width < at_least
    (Console(width=at_least, stderr=results.stderr) if narrow else results).print(table)


def command_line() -> str:
    """The running command, quoted for a shell."""
    return shlex.join(["evpinn", *sys.argv[1:]])


def moment(stamp_ns: int, timespec: str = "seconds") -> str:
    """A stamp as ISO 8601 time in UTC, or as "N ns" if `datetime` cannot hold it."""
    try:
        instant = datetime.fromtimestamp(stamp_ns / NANOSECONDS, timezone.utc)
    except (OverflowError, ValueError, OSError):
        return f"{stamp_ns} ns"
    return instant.isoformat(sep=" ", timespec=timespec).removesuffix("+00:00")


def tables_beside(json_file: Path | None) -> None:
    """Send tables to stderr if the JSON goes to stdout."""
    results.stderr = json_file is not None and str(json_file) == STDOUT


def write_json(path: Path, document: Any) -> None:
    """Write JSON to a file, or to stdout if `path` is "-"; numbers that are not finite are null.

    Raises:
        InputError: the file cannot be written.
    """
    text = json_text(document, indent=1)
    if str(path) == STDOUT:
        print(text, flush=True)
        return
    with as_input_error(path):
        write_file(path, text + "\n")


class RateColumn(ProgressColumn):
    """Rate of progress: multiples of real time for seconds of a drive, else units a second."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        """The recent rate; empty at the start."""
        speed = task.finished_speed or task.speed
        if speed is None:
            return Text()
        text = f"{speed:.0f}" if speed >= 100 else f"{speed:.3g}"
        return Text(text + (" x real time" if self._unit == DRIVE_SECONDS else " a second"))


@contextmanager
def progress_bar(title: str, total: float | None, unit: str = DRIVE_SECONDS) -> Iterator[Report]:
    """Show progress as a bar on a terminal, else as lines; `total` is None if unknown."""
    if not notes.is_terminal:
        yield progress_lines(title, total, unit)
        return
    name = TextColumn("{task.description}", markup=False)  # often that of a file
    amount = TextColumn(f"{{task.completed:.0f}} {unit}", markup=False)
    word = TextColumn("{task.fields[word]}", markup=False)
    columns = (TaskProgressColumn(), amount, RateColumn(unit), word, TimeRemainingColumn())
    with Progress(name, BarColumn(), *columns, console=notes) as bar:
        task = bar.add_task(printable(title), total=total, word="")
        yield lambda done, word="": bar.update(task, completed=done, word=word)


@contextmanager
def working(title: str) -> Iterator[None]:
    """Show a spinner on a terminal while work of unknown length runs."""
    if not notes.is_terminal:
        yield
        return
    with notes.status(Text(printable(title))):
        yield


def track(title: str, items: Collection[Item], unit: str) -> Iterator[Item]:
    """Yields the items, and shows progress if there are two or more."""
    if len(items) < 2:
        yield from items
        return
    with progress_bar(title, len(items), f"of {len(items)} {unit}") as progress:
        for count, item in enumerate(items, start=1):
            yield item
            progress(count)


def progress_lines(title: str, total: float | None, unit: str) -> Report:
    """A report that prints at most one line on stderr per `LINE_PERIOD_S`."""
    begun = last_line = time.monotonic()

    def report(done: float, _word: str = "") -> None:
        nonlocal last_line
        now = time.monotonic()
        if now - last_line < LINE_PERIOD_S:
            return
        last_line = now
        share = done / total if total else 0.0
        left = (now - begun) * (1.0 - share) / share if 0.0 < share <= 1.0 else None
        progress = "" if left is None else f", {100.0 * share:.0f} %, {left:.0f} s left"
        note(f"{title}: {done:.0f} {unit}{progress}")

    return report


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError while a bag is written into InputError."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; the bag is incomplete") from error
