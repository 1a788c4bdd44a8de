"""Options, parallel work and output shared by the commands of `evpinn bench`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
import signal
from typing import Annotated, Any, TypeVar

import typer

from benchmarks.unseen.drives import cars_in, inputs_of
from evpinn_ros.cli.console import STDOUT, progress_bar, write_json
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.common.stopping import stopped_by
from evpinn_ros.common.writer import check_outputs

GradeOption = Annotated[float, typer.Option(min=0.0, help="RMS grade of the roads; 0: flat.")]
AltitudeOption = Annotated[bool, typer.Option("--altitude", help="With a barometer.")]
DataArgument = Annotated[str, typer.Argument(help="Folder of data, as in `evpinn bench unseen`.")]
JobsOption = Annotated[int, typer.Option(min=1, help="Number of processes.")]
TABLE_WIDTH = 140  # characters; in narrower tables numbers would be broken
Result = TypeVar("Result")


def cars_option(cars: Sequence[str]) -> Any:
    """The option `--cars` of a command that scores these cars by default."""
    return typer.Option(help=f"Joined by commas; if not given, DATA's among {', '.join(cars)}.")


def chosen_cars(data: str, wanted: str, default: Sequence[str]) -> list[str]:
    """The cars in `wanted`, joined by commas, else those of `default` that `data` has."""
    if wanted:
        return names_in(wanted)
    present = cars_in(data, recorded=True)
    return [key for key in default if key in present]


def names_in(text: str) -> list[str]:
    """The names in a list joined by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def in_parallel(
    title: str, jobs: int, work: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]
) -> Iterator[Result]:
    """Results of `work(*task)` for each task, in order, computed by `jobs` processes."""
    with (
        ProcessPoolExecutor(jobs, initializer=limit_blas_threads) as pool,
        progress_bar(title, len(tasks), unit="done") as progress,
    ):
        for number, result in enumerate(pool.map(work, *zip(*tasks, strict=True)), start=1):
            progress(number)
            yield result


@contextmanager
def json_as_it_comes(
    path: Path | None, document: Callable[[], Any], inputs: Iterable[str] = ()
) -> Iterator[Callable[[], None]]:
    """Yields a function that writes `document()` to `path`; on exit it is written once more.

    Every signal to stop raises KeyboardInterrupt in the block.

    Raises:
        InputError: `path` is a file of `inputs`, names of data and of cars.
    """
    check_outputs([path], inputs_of(inputs))

    def keep() -> None:
        if path is not None and str(path) != STDOUT:
            write_json(path, document())

    try:
        with stopped_by(signal.default_int_handler):
            yield keep
    finally:
        if path is not None:
            write_json(path, document())


def table_of(
    title: str, rows: Iterable[Any], columns: Sequence[tuple[str, str]], left: int = 1
) -> PlainTable:
    """A table with a row for each object.

    Args:
        title: above it.
        rows: the objects, or tuples of several.
        columns: header of each, and the format of its cells: `{0}` is the object, or the first
            of the tuple.
        left: number of columns that are texts, aligned left.
    """
    headers = [header for header, _ in columns]
    objects = (row if type(row) is tuple else (row,) for row in rows)
    cells = ([cell.format(*record) for _, cell in columns] for record in objects)
    return PlainTable(title, headers, cells, words=headers[:left])


def figures_table(title: str, rows: Iterable[tuple[str, str, str]]) -> PlainTable:
    """Table of (name, measured, goal)."""
    return PlainTable(title, ("", "measured", "goal"), rows)
