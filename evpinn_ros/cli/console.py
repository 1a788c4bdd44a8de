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
"""Takes the amount done (seconds of the drive unless named) and a word for the terminal."""

Item = TypeVar("Item")

STDOUT = "-"  # as the path of a file
DRIVE = "s of the drive"
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
    """Print a table of the results, as wide as the terminal and at least as wide as asked."""
    narrow = results.width < at_least
    (Console(width=at_least, stderr=results.stderr) if narrow else results).print(table)


def command_line() -> str:
    """The running command as a line for a shell."""
    return shlex.join(["evpinn", *sys.argv[1:]])


def moment(stamp_ns: int, timespec: str = "seconds") -> str:
    """UTC of a stamp in ISO format; the number of nanoseconds if it is no date."""
    try:
        instant = datetime.fromtimestamp(stamp_ns / NANOSECONDS, timezone.utc)
    except (OverflowError, ValueError, OSError):
        return f"{stamp_ns} ns"
    return instant.isoformat(sep=" ", timespec=timespec).removesuffix("+00:00")


def tables_beside(json_file: Path | None) -> None:
    """Send tables to stderr if the JSON goes to stdout."""
    results.stderr = json_file is not None and str(json_file) == STDOUT


def write_json(path: Path, document: Any) -> None:
    """Write JSON to stdout or a file; a number that is not finite becomes null."""
    text = json_text(document, indent=1)
    if str(path) == STDOUT:
        print(text, flush=True)
        return
    with as_input_error(path):
        write_file(path, text + "\n")


class RateColumn(ProgressColumn):
    """Rate of the work: times real time for seconds of a drive, else the amount per second."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        """The recent rate; empty until there is one."""
        speed = task.finished_speed or task.speed
        if speed is None:
            return Text()
        text = f"{speed:.0f}" if speed >= 100 else f"{speed:.3g}"
        return Text(text + (" x real time" if self._unit == DRIVE else " a second"))


@contextmanager
def progress_bar(title: str, total: float | None, unit: str = DRIVE) -> Iterator[Report]:
    """Show progress: a bar on a terminal, a line every 10 s in a pipe; `total` may be None."""
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


def each(title: str, items: Collection[Item], unit: str) -> Iterator[Item]:
    """Yields items; shows how far they are where there are several."""
    if len(items) < 2:
        yield from items
        return
    with progress_bar(title, len(items), f"of {len(items)} {unit}") as progress:
        for count, item in enumerate(items, start=1):
            yield item
            progress(count)


def progress_lines(title: str, total: float | None, unit: str) -> Report:
    """Progress as lines on stderr, none in the first `LINE_PERIOD_S`."""
    begun = due = time.monotonic()

    def report(done: float, _word: str = "") -> None:
        nonlocal due
        now = time.monotonic()
        if now - due < LINE_PERIOD_S:
            return
        due = now
        share = done / total if total else 0.0
        left = (now - begun) * (1.0 - share) / share if 0.0 < share <= 1.0 else None
        progress = "" if left is None else f", {100.0 * share:.0f} %, {left:.0f} s left"
        note(f"{title}: {done:.0f} {unit}{progress}")

    return report


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an error of the disk into one line for the user."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; the bag is cut there") from error
