"""Parquet, Feather and lines of JSON as text, by polars, which runs apart (`common.apart`)."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import open_file
from evpinn_ros.drives.text_table import MOST_COLUMNS, plain_cell


def write_columns(path: Path, out: Path) -> None:
    """Write the columns of such a file, their names first, a row a line."""
    with open_file(path) as file:
        # By its number, for in a name there may be signs of a pattern, or no text at all.
        source = f"/dev/fd/{file.fileno()}"
        match path.suffix.lower():
            case ".parquet" | ".pq":
                frame = pl.scan_parquet(source)
            case ".feather" | ".arrow":
                frame = pl.scan_ipc(source)
            case _:  # all lines tell the columns: a logger leaves out what it does not know
                frame = pl.scan_ndjson(source, infer_schema_length=None)
        # Nested columns hold no signal; a table of ours or of pandas has none.
        schema = frame.collect_schema()
        flat = {name: kind for name, kind in schema.items() if not kind.is_nested()}
        if len(flat) > MOST_COLUMNS:
            raise InputError(f"more than {MOST_COLUMNS} columns")
        columns = []
        for name, kind in flat.items():
            text = pl.col(name).cast(pl.String, strict=False)
            if kind in (pl.String, pl.Binary, pl.Categorical):
                text = text.str.replace_all(r"[\r\n]+", " ")
            columns.append(text.alias(plain_cell(name)))
        frame.select(columns).sink_csv(out)
