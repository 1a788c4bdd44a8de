"""Converts Parquet and Feather to CSV by polars in another process (`common.sandbox`)."""

from __future__ import annotations

from pathlib import Path

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import MOST_COLUMNS, open_file
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.writer import plain_cell

with optional_imports():
    import polars as pl


def write_columns(path: Path, out: Path) -> None:
    """Write a Parquet or Feather file as CSV, without nested columns."""
    with open_file(path) as file:
        # By file descriptor, as a name may contain glob characters or not be text.
        source = f"/dev/fd/{file.fileno()}"
        is_parquet = path.suffix.lower() in (".parquet", ".pq")
        frame = pl.scan_parquet(source) if is_parquet else pl.scan_ipc(source)
        # Nested columns hold no signal.
        schema = frame.collect_schema()
        flat = {name: kind for name, kind in schema.items() if not kind.is_nested()}
        if len(flat) > MOST_COLUMNS:
            raise InputError(f"more than {MOST_COLUMNS} columns")
        frame.select([_text(name, kind) for name, kind in flat.items()]).sink_csv(out)


def _text(name: str, kind: pl.DataType) -> pl.Expr:
    column, shown = pl.col(name), plain_cell(name)
    if isinstance(kind, pl.Duration):
        return (column.dt.total_nanoseconds() / 1e9).alias(f"{shown} [s]")
    if kind == pl.Time:  # a cast would lose fractions of a second
        return column.dt.to_string("%H:%M:%S%.f").alias(shown)
    text = column.cast(pl.String, strict=False)
    if kind in (pl.String, pl.Binary, pl.Categorical):
        text = text.str.replace_all(r"[\r\n]+", " ")
    return text.alias(shown)
