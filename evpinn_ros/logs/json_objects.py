"""Converts JSON to CSV, a row per object: one per line, or the longest list of a document.

Nested values are named by their path: `telemetry.kmh`. polars is not used, as it refuses a file
with a `NaN` or a truncated last line.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
import csv
import json
from pathlib import Path
from typing import IO, Any

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import LONGEST_LINE, MOST_COLUMNS, open_file
from evpinn_ros.common.writer import new_table, plain_cell

NESTED = dict, list
DEEPEST = 8  # nested objects
_decoded = json.JSONDecoder(parse_constant=lambda _: None).decode


def write_objects(path: Path, out: Path) -> None:
    """Write the objects of a JSON file as CSV; InputError at the end if lines are no objects."""
    if path.suffix.lower() == ".json":
        with open_file(path) as file, suppress(ValueError, RecursionError):
            rows = list(map(flat, longest_list(_decoded(file.read().decode("utf-8-sig")))))
            return _write(rows, rows, out)
    with open_file(path) as names, open_file(path) as values:
        _write(_objects(names), _objects(values), out)


def longest_list(document: object) -> list[dict[str, Any]]:
    """The longest list of objects in a document; lists under the same names are joined."""
    lists: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    waiting: deque[tuple[tuple[str, ...], object]] = deque([((), document)])
    while waiting:
        path, value = waiting.popleft()
        if isinstance(value, dict):
            waiting.extend(
                ((*path, name), inner)
                for name, inner in value.items()
                if isinstance(inner, NESTED)
            )
        elif isinstance(value, list):
            lists.setdefault(path, []).extend(row for row in value if isinstance(row, dict))
            waiting.extend((path, inner) for inner in value if isinstance(inner, NESTED))
    return max(lists.values(), key=len, default=[])


def _write(
    first: Iterable[dict[str, Any] | None], again: Iterable[dict[str, Any] | None], out: Path
) -> None:
    """Write the names of `first`, then the values of the same rows in `again`."""
    names: dict[str, None] = {}
    for row in first:
        names.update(dict.fromkeys(row or ()))
        if len(names) > MOST_COLUMNS:
            raise InputError(f"more than {MOST_COLUMNS} columns")
    if not names:
        raise InputError("no JSON objects in it")
    bad: list[int] = []
    with new_table(out) as text:
        table = csv.writer(text)
        table.writerow(map(plain_cell, names))
        for number, row in enumerate(again, 1):
            if row is None:
                bad.append(number)
            else:
                table.writerow([_cell(row.get(name)) for name in names])
    if bad:
        raise InputError(f"{len(bad)} lines are no JSON objects, the first is line {bad[0]}")


def _objects(file: IO[bytes]) -> Iterator[dict[str, Any] | None]:
    """The objects of all lines but an unterminated last one."""
    while line := file.readline(LONGEST_LINE + 1):
        yield _object(line)
        if len(line) > LONGEST_LINE:
            return


def _object(line: bytes) -> dict[str, Any] | None:
    """The object of a line, empty for a blank one; None if the line is no object."""
    with suppress(ValueError, RecursionError):
        row = _decoded(line.decode("utf-8-sig")) if line.strip() else {}
        return flat(row) if isinstance(row, dict) else None
    return None


def flat(row: dict[str, Any], levels: int = DEEPEST) -> dict[str, Any]:
    """Values of an object and of nested ones, named by their paths; lists are no signals."""
    values: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, dict) and levels:
            inner = flat(value, levels - 1)
            values |= {f"{name}.{path}": cell for path, cell in inner.items()}
        elif not isinstance(value, NESTED):
            values[name] = value
    return values


def _cell(value: object) -> object:
    """The value as one line of text."""
    return plain_cell(value) if isinstance(value, str) else value
