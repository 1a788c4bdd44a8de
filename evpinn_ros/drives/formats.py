"""File formats that are tables of drives."""

from __future__ import annotations

from pathlib import Path

TEXT_SUFFIXES = (".csv", ".tsv", ".txt")
SHEET_SUFFIXES = (".xlsx", ".xlsm")
PARQUET_SUFFIXES = (".parquet", ".pq")
MEASUREMENT_SUFFIX = ".mf4"
TABLE_SUFFIXES = (*TEXT_SUFFIXES, *SHEET_SUFFIXES, *PARQUET_SUFFIXES, MEASUREMENT_SUFFIX)


def suffix_of(path: Path) -> str:
    """In lower case and without .gz."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


def is_table(path: Path) -> bool:
    """True if a path is that of a table by its name."""
    return suffix_of(path) in TABLE_SUFFIXES
