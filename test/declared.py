"""Strategies of Hypothesis for declared values, and their fields one by one."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import partial
import math
from typing import Any

from hypothesis import strategies as st
import numpy as np

from evpinn_ros.common.saved_fields import declared


def plain_fields(kind: Any, most: float = math.inf) -> st.SearchStrategy[dict[str, Any]]:
    """Any values within their ranges for all fields that are numbers or truth values.

    `most` bounds the numbers further.
    """
    values: dict[str, st.SearchStrategy[Any]] = {}
    for name, field in declared(kind).items():
        if field.kind is bool:
            values[name] = st.booleans()
        elif field.kind in (int, float) and field.range is not None:
            of_kind: Any = st.integers if field.kind is int else st.floats
            number = of_kind(field.range.least, min(field.range.most, most))
            values[name] = st.none() | number if field.optional else number
    return st.fixed_dictionaries(values)


def _content(value: Any) -> Mapping[str, Any]:
    """Fields of a value by name; none of a number, a text or an array."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return value._asdict() if hasattr(value, "_asdict") else {}


def changes(value: Any, prefix: str = "", but: Collection[str] = ()) -> Iterator[tuple[str, Any]]:
    """Every field below a value, by its path with dots, with the value in which it alone differs.

    Of a mapping all items are changed at once, and a field that is None becomes 1. Paths in
    `but` are left out.
    """
    swap = getattr(value, "_replace", partial(replace, value))
    for name, content in _content(value).items():
        path = f"{prefix}{name}"
        if path in but:
            continue
        if isinstance(content, Mapping) and content and _content(next(iter(content.values()))):
            rows = {key: dict(changes(item, f"{path}.")) for key, item in content.items()}
            for below in next(iter(rows.values())):
                yield below, swap(**{name: {key: row[below] for key, row in rows.items()}})
        elif _content(content):
            for below, changed in changes(content, f"{path}.", but):
                yield below, swap(**{name: changed})
        else:
            yield path, swap(**{name: _another(content)})


def _another(content: Any) -> Any:
    """A value of the same kind that differs a little."""
    if isinstance(content, Mapping):
        return {key: _another(item) for key, item in content.items()}
    if isinstance(content, bool | np.bool_):
        return not content
    if isinstance(content, Enum):
        return next(kind for kind in type(content) if kind is not content)
    if isinstance(content, str):
        return f"{content}1"
    if isinstance(content, tuple):
        return _another(content[0]), *content[1:]
    if isinstance(content, np.ndarray):
        return 1.01 * content + 0.001
    return 1 if content is None else content + 1
