"""Saved states: declared once, as dataclasses whose fields carry the range of their numbers.

What has a state to keep is `Saveable`: it names a dataclass, says how to make one of itself and
how to go on from one. What is written and what is refused both follow from the declared types:

| declared | saved |
|---|---|
| a number or array, `Annotated[float, Range(0.0, 1.0)]` | a number, or lists of an array's shape |
| `bool`, `str`, `X or None` | the same |
| a dataclass | a mapping, with these keys and no others |
| a NamedTuple | a list |
| `tuple[X, ...]` | a list of any length |
| `Mapping[str, X]` | a mapping with the keys of the state before |
| `Any` | as the class of the state before is declared |

What ranges cannot express (a covariance is none, a car far from its vehicle file) is refused by
the ValueError of `__post_init__` or of `Saveable.take`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache
import math
import reprlib
import sys
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Generic,
    NamedTuple,
    NoReturn,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from evpinn_ros.common.errors import InputError

SAME = "same"  # beside a type: must be what it is in the state before, as a version must
ADDED = "added"  # beside `X | None`: None where the file is older than the field
State = TypeVar("State")


class Range(NamedTuple):
    """Numbers from `least` to `most`; with `unknown` NaN too, which is saved as null."""

    least: float
    most: float
    unknown: bool = False


class StateError(InputError, ValueError):
    """A saved state is not what is declared; the text names the place."""


class Saveable(ABC, Generic[State]):
    """Something whose state is saved."""

    @abstractmethod
    def saved(self) -> State:
        """State to save."""

    @abstractmethod
    def take(self, saved: State) -> None:
        """Go on from a state within its ranges; ValueError where it is not possible otherwise."""

    def export(self) -> dict[str, Any]:
        """State to save, of numbers, text, lists and mappings only."""
        exported: dict[str, Any] = plain(self.saved())
        return exported

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from what `export` gave.

        Raises:
            StateError: it is another's, or something in it is not possible.
        """
        before = self.saved()
        try:
            self.take(_read(type(before), saved, before, ""))
        except StateError:
            raise
        except ValueError as error:
            raise StateError(f"saved state: {error}") from error


def plain(state: Any) -> Any:
    """A state as it is saved."""
    return _plain(type(state), state)


def _plain(declared: Any, value: Any) -> Any:
    kind, note = _split(declared)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        own: Any = type(value)
        return {name: _plain(each, getattr(value, name)) for name, each in _fields(own)}
    if isinstance(value, tuple):
        items = zip(_items(type(value), get_args(kind), len(value)), value, strict=True)
        return [_plain(each, item) for each, item in items]
    if isinstance(value, Mapping):
        return {key: _plain(get_args(kind)[1], item) for key, item in value.items()}
    unknown = isinstance(note, Range) and note.unknown and math.isnan(value)
    return None if unknown else value


def _split(declared: Any) -> tuple[Any, Any]:
    """The type, without None, and what stands beside it."""
    note = None
    if get_origin(declared) is Annotated:
        declared, note = get_args(declared)
    if get_origin(declared) in (Union, UnionType):
        inner, inner_note = _split(next(x for x in get_args(declared) if x is not NoneType))
        return inner, inner_note or note
    return declared, note


@cache
def _fields(kind: type) -> tuple[tuple[str, Any], ...]:
    return tuple(get_type_hints(kind, include_extras=True).items())


def _items(kind: type, arguments: tuple[Any, ...], count: int) -> list[Any]:
    """Declarations of the items of a NamedTuple, or of so many of a tuple."""
    named = hasattr(kind, "_fields")
    return [each for _, each in _fields(kind)] if named else [arguments[0]] * count


def _optional(declared: Any) -> bool:
    if get_origin(declared) is Annotated:
        declared = get_args(declared)[0]
    return NoneType in get_args(declared)


def _read(declared: Any, value: Any, before: Any, where: str) -> Any:
    """A saved value as it is declared; shapes, keys and what is `SAME` are those of `before`."""
    kind, note = _split(type(before) if declared is Any else declared)
    if value is None and _optional(declared):
        return None
    if is_dataclass(kind):
        return _dataclass(kind, value, before, where)
    if kind is np.ndarray or kind in (int, float):
        return _numbers(kind, note, value, before, where)
    if get_origin(kind) is tuple or hasattr(kind, "_fields"):
        return _tuple(kind, value, where)
    if isinstance(before, Mapping):
        if not isinstance(value, Mapping) or set(value) != set(before):
            _refuse(where, value, ", ".join(before))
        inner = get_args(kind)[1]
        return {key: _read(inner, value[key], before[key], f"{where}.{key}") for key in before}
    if type(value) is not kind:
        _refuse(where, value, kind.__name__)
    return value


def _dataclass(kind: Any, value: Any, before: Any, where: str) -> Any:
    declared = dict(_fields(kind))
    added = {name for name, each in declared.items() if _beside(each, ADDED)}
    if not isinstance(value, Mapping):
        _refuse(where, value, ", ".join(declared))
    same = [name for name, each in declared.items() if _beside(each, SAME)]
    _refuse_another(same, value, before)
    if not set(declared) - added <= set(value) <= set(declared):
        _refuse(where, value, ", ".join(declared))
    prefix = f"{where}." if where else ""
    found = {
        name: _read(each, value.get(name), getattr(before, name, None), prefix + name)
        for name, each in declared.items()
    }
    try:
        return kind(**found)
    except StateError:
        raise
    except ValueError as error:
        raise StateError(f"saved '{where}': {error}") from error


def _beside(declared: Any, note: str) -> bool:
    return get_origin(declared) is Annotated and get_args(declared)[1] == note


def _refuse_another(names: list[str], value: Mapping[str, Any], before: Any) -> None:
    found = {name: value.get(name) for name in names}
    wanted = {name: getattr(before, name) for name in names}
    if found != wanted:
        texts = [
            ", ".join(f"{k} {reprlib.repr(v)}" for k, v in x.items()) for x in (found, wanted)
        ]
        raise StateError(f"saved for {texts[0]}, not for {texts[1]}")


def _tuple(kind: Any, value: Any, where: str) -> Any:
    named = hasattr(kind, "_fields")
    if not isinstance(value, list) or (named and len(value) != len(kind._fields)):
        _refuse(where, value, f"a list of {', '.join(kind._fields)}" if named else "a list")
    names = kind._fields if named else range(len(value))
    items = zip(names, _items(kind, get_args(kind), len(value)), value, strict=True)
    found = [_read(each, item, None, f"{where}.{name}") for name, each, item in items]
    return kind(*found) if named else tuple(found)


def _numbers(kind: Any, note: Any, value: Any, before: Any, where: str) -> Any:
    """A number, or an array of this shape; neither text nor truth values are such."""
    bounds = note if isinstance(note, Range) else Range(-sys.float_info.max, sys.float_info.max)
    if value is None and bounds.unknown:
        return math.nan
    shape = np.shape(before) if kind is np.ndarray else ()
    try:
        numbers = np.array(value)
    except ValueError:  # lists of several lengths
        numbers = np.array(None)
    fits = numbers.shape == shape and numbers.dtype.kind in ("iu" if kind is int else "iuf")
    if not (fits and ((numbers >= bounds.least) & (numbers <= bounds.most)).all()):
        size = f" in the shape {shape}" if shape else ""
        what = "an integer" if kind is int else "a number"
        _refuse(where, value, f"{what} of {bounds.least:g} to {bounds.most:g}{size}")
    return numbers.astype(float) if kind is np.ndarray else kind(value)


def _refuse(where: str, value: Any, expected: str) -> NoReturn:
    raise StateError(f"saved '{where}' is {reprlib.repr(value)}, expected {expected}")
