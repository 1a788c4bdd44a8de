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

    def export(self) -> Any:
        """State to save, of numbers, text, lists and mappings only."""
        return plain(self.saved())

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from what `export` gave.

        Raises:
            StateError: it is another's, or something in it is not possible.
        """
        before = self.saved()
        try:
            self.take(_read(_declared(type(before)), saved, before, ""))
        except StateError:
            raise
        except ValueError as error:
            raise StateError(f"saved state: {error}") from error


def plain(state: Any) -> Any:
    """A state as it is saved."""
    return _plain(_declared(type(state)), state)


class _Declared(NamedTuple):
    """A declared type without None, whether None may be, and what stands beside it."""

    kind: Any
    optional: bool
    notes: tuple[Any, ...]

    @property
    def range(self) -> Range:
        """Range of its numbers: all that are finite, where none is declared."""
        most = sys.float_info.max
        return next((x for x in self.notes if isinstance(x, Range)), Range(-most, most))

    @property
    def is_named(self) -> bool:
        """True for a NamedTuple."""
        return hasattr(self.kind, "_fields")

    @property
    def of_numbers(self) -> _Declared | None:
        """Declaration of an array, where this is a tuple of numbers that are all known."""
        if get_origin(self.kind) is not tuple or self.is_named:
            return None
        item = _declared(get_args(self.kind)[0])
        plain = item.kind is float and not (item.optional or item.range.unknown)
        return item._replace(kind=np.ndarray) if plain else None

    def items(self, count: int) -> list[_Declared]:
        """Declarations of the items of a NamedTuple, or of so many of a tuple."""
        if self.is_named:
            return list(_fields(self.kind).values())
        return [_declared(get_args(self.kind)[0])] * count


def _declared(hint: Any) -> _Declared:
    optional, notes = False, ()
    while (origin := get_origin(hint)) in (Annotated, Union, UnionType):
        if origin is Annotated:
            hint, *beside = get_args(hint)
            notes = (*notes, *beside)
        else:
            optional, hint = True, next(x for x in get_args(hint) if x is not NoneType)
    return _Declared(hint, optional, notes)


@cache
def _fields(kind: Any) -> dict[str, _Declared]:
    hints = get_type_hints(kind, include_extras=True)
    return {name: _declared(hint) for name, hint in hints.items()}


def _plain(declared: _Declared, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        own: Any = type(value)
        return {name: _plain(each, getattr(value, name)) for name, each in _fields(own).items()}
    if isinstance(value, tuple):
        if declared.of_numbers:
            return list(value)
        items = zip(declared.items(len(value)), value, strict=True)
        return [_plain(each, item) for each, item in items]
    if isinstance(value, Mapping):
        inner = _declared(get_args(declared.kind)[1])
        return {key: _plain(inner, item) for key, item in value.items()}
    return None if declared.range.unknown and math.isnan(value) else value


def _read(declared: _Declared, value: Any, before: Any, where: str) -> Any:
    """A saved value as it is declared; shapes, keys and what is `SAME` are those of `before`."""
    kind = type(before) if declared.kind is Any else declared.kind
    if value is None and declared.optional:
        return None
    if is_dataclass(kind):
        return _dataclass(kind, value, before, where)
    if kind in (np.ndarray, int, float):
        return _numbers(declared, value, np.shape(before), where)
    if get_origin(kind) is tuple or declared.is_named:
        return _tuple(declared, value, where)
    if isinstance(before, Mapping):
        if not isinstance(value, Mapping) or set(value) != set(before):
            _refuse(where, value, ", ".join(before))
        inner = _declared(get_args(kind)[1])
        return {key: _read(inner, value[key], before[key], f"{where}.{key}") for key in before}
    return value if type(value) is kind else _refuse(where, value, kind.__name__)


def _dataclass(kind: Any, value: Any, before: Any, where: str) -> Any:
    declared = _fields(kind)
    if not isinstance(value, Mapping):
        _refuse(where, value, ", ".join(declared))
    _refuse_another([name for name, each in declared.items() if SAME in each.notes], value, before)
    needed = {name for name, each in declared.items() if ADDED not in each.notes}
    if not needed <= set(value) - getattr(kind, "GONE", set()) <= set(declared):
        _refuse(where, value, ", ".join(declared))
    prefix = f"{where}." if where else ""
    found = {
        name: _read(each, value.get(name), getattr(before, name, None), prefix + name)
        for name, each in declared.items()
    }
    try:
        return kind(**found)
    except ValueError as error:
        raise StateError(f"saved '{where}': {error}") from error


def _refuse_another(names: list[str], value: Mapping[str, Any], before: Any) -> None:
    found = {name: value.get(name) for name in names}
    wanted = {name: getattr(before, name) for name in names}
    if found != wanted:
        one, other = (
            ", ".join(f"{name} {reprlib.repr(each)}" for name, each in values.items())
            for values in (found, wanted)
        )
        raise StateError(f"saved for {one}, not for {other}")


def _tuple(declared: _Declared, value: Any, where: str) -> Any:
    kind, named = declared.kind, declared.is_named
    if not isinstance(value, list) or (named and len(value) != len(kind._fields)):
        _refuse(where, value, f"a list of {', '.join(kind._fields)}" if named else "a list")
    if numbers := declared.of_numbers:  # there may be many
        if bool in {*map(type, value)}:
            _refuse(where, value, "numbers")
        return tuple(_numbers(numbers, value, (len(value),), where).tolist())
    names = kind._fields if named else range(len(value))
    items = zip(names, declared.items(len(value)), value, strict=True)
    found = [_read(each, item, None, f"{where}.{name}") for name, each, item in items]
    return kind(*found) if named else tuple(found)


def _numbers(declared: _Declared, value: Any, shape: tuple[int, ...], where: str) -> Any:
    """A number, or an array of this shape; neither text nor truth values are such."""
    least, most, unknown = declared.range
    if value is None and unknown:
        return math.nan
    shape = shape if declared.kind is np.ndarray else ()
    try:
        numbers = np.array(value)
    except ValueError:  # lists of several lengths
        numbers = np.array(None)
    whole = declared.kind is int
    fits = numbers.shape == shape and numbers.dtype.kind in ("iu" if whole else "iuf")
    if not (fits and ((numbers >= least) & (numbers <= most)).all()):
        size = f" in the shape {shape}" if shape else ""
        what = "an integer" if whole else "a number"
        _refuse(where, value, f"{what} of {least:g} to {most:g}{size}")
    return numbers.astype(float) if declared.kind is np.ndarray else declared.kind(value)


def _refuse(where: str, value: Any, expected: str) -> NoReturn:
    raise StateError(f"saved '{where}' is {reprlib.repr(value)}, expected {expected}")
