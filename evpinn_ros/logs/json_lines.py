"""JSON Lines as text; polars cannot read a file with a `NaN` or a torn last line."""

from __future__ import annotations

from contextlib import suppress
import csv
import json
from pathlib import Path
from typing import Any

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import MOST_COLUMNS, open_file
from evpinn_ros.common.writer import new_table, plain_cell

_decoded = json.JSONDecoder(parse_constant=lambda _: None).decode


def write_objects(path: Path, out: Path) -> None:
    """Write names and values, an object a line; InputError at the end if some lines were none."""
    names: dict[str, None] = {}
    with open_file(path) as file:
        for row in map(_object, file):
            names.update(dict.fromkeys(row or ()))
            if len(names) > MOST_COLUMNS:
                raise InputError(f"more than {MOST_COLUMNS} columns")
    bad: list[int] = []
    with open_file(path) as file, new_table(out) as text:
        table = csv.writer(text)
        table.writerow(map(plain_cell, names))
        for number, row in enumerate(map(_object, file), 1):
            if row is None:
                bad.append(number)
            else:
                table.writerow([_cell(row.get(name)) for name in names])
    if bad:
        raise InputError(f"{len(bad)} lines are no JSON objects, the first is line {bad[0]}")


def _object(line: bytes) -> dict[str, Any] | None:
    """The object of a line, none of a blank one; None where it is something else."""
    with suppress(ValueError, RecursionError):
        row = _decoded(line.decode("utf-8-sig")) if line.strip() else {}
        return row if isinstance(row, dict) else None
    return None


def _cell(value: object) -> object:
    """A value on one line; none for a nested one, which is no signal."""
    if isinstance(value, str):
        return plain_cell(value)
    return None if isinstance(value, (dict, list)) else value
