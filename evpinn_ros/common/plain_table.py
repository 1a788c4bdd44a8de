"""Tables of texts that may come from anywhere: shown as they are, whatever is in them."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from evpinn_ros.common.errors import printable


class PlainTable(Table):
    """A table without markup: names of topics, files and cars are text and nothing else."""

    def __init__(self, *headers: str, title: str = "", box: Any = SIMPLE_HEAD) -> None:
        """An empty table in the style of all.

        Args:
            headers: of columns to the left; others come with `add_column`.
            title: above it.
            box: of rich, the lines between the cells.
        """
        shown = Text(printable(title), style="table.title") if title else None
        super().__init__(title=shown, title_justify="left", box=box, pad_edge=False)
        for header in headers:
            self.add_column(header)

    def add_column(self, header: Any = "", *more: Any, **options: Any) -> None:
        """Add a column with a header of plain text; `options` are rich's."""
        super().add_column(_plain(header), *more, **options)

    def add_row(self, *cells: Any, **options: Any) -> None:
        """Add a row of plain texts; `options` are rich's."""
        super().add_row(*map(_plain, cells), **options)


def _plain(text: str) -> Text:
    """Lines of plain text."""
    return Text("\n".join(map(printable, text.split("\n"))))
