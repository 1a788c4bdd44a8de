"""Tables for the terminal that show untrusted text literally."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from evpinn_ros.common.errors import printable


class PlainTable(Table):
    """A table that does not interpret markup in names of topics, files and cars."""

    def __init__(
        self,
        title: str,
        columns: Sequence[str],
        rows: Iterable[Iterable[str]] = (),
        *,
        words: Collection[str] = (),
        unbroken: Collection[str] = (),
    ) -> None:
        """Make a table; `words` and the first column are aligned left, `unbroken` never fold."""
        shown = Text(printable(title), style="table.title") if title else None
        super().__init__(title=shown, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
        for column in columns:
            left = column in (columns[0], *words)
            self.add_column(
                _plain(column),
                justify="left" if left else "right",
                no_wrap=column in unbroken,
                # Two rows may differ only at the end of a name.
                overflow="fold" if column == columns[0] else "ellipsis",
            )
        for row in rows:
            self.add_row(*row)

    def add_row(self, *cells: Any, **options: Any) -> None:
        """Add a row of plain texts; `options` go to rich."""
        super().add_row(*map(_plain, cells), **options)


def _plain(text: str) -> Text:
    return Text("\n".join(map(printable, text.split("\n"))))
