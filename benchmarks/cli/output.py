"""Options and output that the commands of `evpinn bench` have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from evpinn_ros.cli.console import write_json
from evpinn_ros.common.plain_table import PlainTable

GradeOption = Annotated[float, typer.Option(min=0.0, help="RMS grade of the roads; 0: flat.")]
AltitudeOption = Annotated[bool, typer.Option("--altitude", help="With a barometer.")]
BUSY = 0.3  # load of other programs from which figures are not those of what is measured alone
TABLE_WIDTH = 140  # characters; in narrower tables numbers would be broken


def number(value: float | None, form: str) -> str:
    """A number in this format, a dash where it is not known."""
    return "-" if value is None else format(value, form)


def names_in(text: str) -> list[str]:
    """The names in a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


@contextmanager
def json_at_the_end(path: Path | None, found: Callable[[], Any]) -> Iterator[None]:
    """Write what was found so far, also where Ctrl-C or an error ends the block."""
    try:
        yield
    finally:
        if path is not None:
            write_json(path, found())


def table_of(
    title: str, rows: Iterable[Any], columns: Sequence[tuple[str, str]], left: int = 1
) -> PlainTable:
    """A table with a row for each object.

    Args:
        title: above it.
        rows: the objects, or tuples of several.
        columns: header of each, and the format of its cells: `{0}` is the object, or the first
            of the tuple.
        left: how many of the columns are texts, aligned left.
    """
    headers = [header for header, _ in columns]
    objects = (row if type(row) is tuple else (row,) for row in rows)
    cells = ([cell.format(*each) for _, cell in columns] for each in objects)
    return PlainTable(title, headers, cells, words=headers[:left])


def figures_table(title: str, rows: Iterable[tuple[str, str, str]]) -> PlainTable:
    """Table of figures, each beside its goal: (name, measured, goal)."""
    return PlainTable(title, ("", "measured", "goal"), rows)
