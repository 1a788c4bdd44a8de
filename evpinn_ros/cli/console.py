"""What a person sees: results on stdout, everything else on stderr, progress on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from evpinn_ros.errors import InputError, printable

Report = Callable[[float], None]  # takes seconds of the drive done

results = Console(highlight=False)
notes = Console(stderr=True, highlight=False, soft_wrap=True)


def note(text: str) -> None:
    """One line to the person, on stderr."""
    notes.print(printable(text), markup=False)


def write_json(path: Path, found: Any) -> None:
    """Write results for scripts, the folder too if need be.

    Raises:
        InputError: it cannot be written.
    """
    text = json.dumps(found, indent=1, allow_nan=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error


@contextmanager
def progress_bar(title: str, total: float | None) -> Iterator[Report]:
    """Show progress on a terminal and nothing in a pipe; takes seconds of the drive done."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.completed:.0f} s of the drive"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=notes, disable=not notes.is_terminal) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def bytes_bar(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """The same for a file: takes bytes done, shows the rate and the time left."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=notes, disable=not notes.is_terminal) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell a disk that is full, or fails, in one line."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; the bag is cut there") from error
