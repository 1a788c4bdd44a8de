"""Saved values, declared once as dataclasses whose fields carry the range of their numbers.

`plain` gives the saved form, `read` checks it by pydantic. A missing field takes its default and
unknown fields are ignored, so files of other versions can be read. `__post_init__` checks what
ranges cannot express, and raises ValueError.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, is_dataclass
from functools import cache
import math
import reprlib
from types import NoneType
from typing import (
    Annotated,
    Any,
    Generic,
    NamedTuple,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from evpinn_ros.common.errors import InputError

State = TypeVar("State")


class Range(NamedTuple):
    """Range of a number or array, beside its type in `Annotated`."""

    least: float  # the smallest number
    most: float  # the largest number
    unknown: bool = False  # whether a number may be NaN, which is saved as null
    shape: tuple[Any, ...] = ()  # of an array, None for any length; empty: a row of any length
    # True if an array is saved as a row of any length, with the names of its states beside it:
    # other versions have other states
    by_state: bool = False

    def __get_pydantic_core_schema__(self, source: Any, _: Any) -> Any:
        """Schema of pydantic: neither text nor truth values are numbers."""
        from pydantic_core import core_schema as schemas

        limits: Any = {"ge": self.least, "le": self.most, "strict": True}
        if source is int:
            return schemas.int_schema(**limits)
        schema: Any = schemas.float_schema(allow_inf_nan=False, **limits)
        if source is np.ndarray:
            shape = (None,) if self.by_state or not self.shape else self.shape
            for size in reversed(shape):
                schema = schemas.list_schema(schema, min_length=size, max_length=size)
            return schemas.no_info_after_validator_function(np.array, schema)
        if self.unknown:
            schema = schemas.nullable_schema(schema)
            return schemas.no_info_after_validator_function(
                lambda number: math.nan if number is None else number, schema
            )
        return schema


class Figure(NamedTuple):
    """Unit and meaning of a field that files, tables and pages show, beside its type."""

    unit: str  # empty for text and plain numbers
    meaning: str  # one sentence for people


class StateError(InputError, ValueError):
    """A saved state does not fit its declaration; the text names the place."""


class Saveable(ABC, Generic[State]):
    """An object whose state is saved; `restore` refuses one that differs in a field of `SAME`."""

    @abstractmethod
    def saved(self) -> State:
        """The present state, for `take`."""

    @abstractmethod
    def take(self, saved: State) -> None:
        """Continue from a state that is within its ranges; ValueError if it is impossible."""

    def export(self) -> Any:
        """The state to save, made of numbers, text, lists and mappings only."""
        return plain(self.saved())

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from the result of `export`; StateError if impossible or of another object."""
        before = self.saved()
        _refuse_another(saved, before)
        try:
            self.take(read(type(before), saved))
        except StateError:
            raise
        except ValueError as error:
            raise StateError(f"saved state: {error}") from error


def plain(value: Any) -> Any:
    """A value as numbers, text, lists and mappings, for JSON."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) or hasattr(value, "_fields"):
        kind: Any = type(value)
        values = {}
        for name, field in declared(kind).items():
            content, limits = getattr(value, name), field.range
            if limits is not None and limits.by_state:
                content = np.ravel(content)
            lacks = limits is not None and limits.unknown and math.isnan(content)
            values[name] = None if lacks else plain(content)
        return values if is_dataclass(value) else [*values.values()]
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return value


def read(kind: type[State], saved: Any) -> State:
    """The saved value of a class; StateError names the first wrong place in one line."""
    # Imported here as in `_adapter`; `json` takes six times as long for a network of 1 MB.
    from pydantic_core import to_json

    adapter = _adapter(cast("Any", kind))
    try:
        text = to_json(saved, inf_nan_mode="constants")
        value: State = adapter.validate_json(text, strict=True)
    except ValueError as error:
        details = getattr(error, "errors", None)  # of pydantic
        if details is None:
            raise StateError(f"saved state: {error}") from error
        first = details(include_url=False)[0]
        place, shown = ".".join(map(str, first["loc"])), reprlib.repr(first["input"])
        raise StateError(f"saved '{place}' is {shown}: {first['msg']}") from error
    return value


@cache
def _adapter(kind: Any) -> Any:
    # Imported here: it takes 0.1 s, and is needed only where states are saved.
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


class Declared(NamedTuple):
    """Declaration of a saved field, from its annotation."""

    kind: Any  # its type, without None
    range: Range | None  # of its numbers, None if not declared
    optional: bool  # whether it may be None
    lackable: bool  # whether it may be missing in a file, because it has a default


@cache
def declared(kind: Any) -> dict[str, Declared]:
    """Declarations of the fields of a dataclass or NamedTuple, by name."""
    fields_by_name = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        optional = NoneType in get_args(hint)
        inner = get_args(hint)[0] if optional else hint
        notes = [note for note in getattr(inner, "__metadata__", ()) if isinstance(note, Range)]
        bare = get_args(inner)[0] if get_origin(inner) is Annotated else inner
        defaults = getattr(kind, "__dataclass_fields__", {}).get(name)
        has = defaults is not None and (
            defaults.default is not MISSING or defaults.default_factory is not MISSING
        )
        fields_by_name[name] = Declared(bare, notes[0] if notes else None, optional, has)
    return fields_by_name


def figures(kind: Any) -> dict[str, Figure]:
    """The shown fields of a dataclass, in their order, with unit and meaning."""
    hints = get_type_hints(kind, include_extras=True)
    return {
        name: note
        for name, hint in hints.items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, Figure)
    }


def is_within(value: Any) -> bool:
    """Whether all numbers of a dataclass are within the ranges that it declares."""
    for name, field in declared(cast("Any", type(value))).items():
        content = getattr(value, name)
        if field.range is not None and content is not None:
            least, most = field.range[:2]
            if not np.all((np.asarray(content) >= least) & (np.asarray(content) <= most)):
                return False
        elif is_dataclass(field.kind) and not is_within(content):
            return False
    return True


def _refuse_another(saved: Any, before: Any) -> None:
    saved = saved if isinstance(saved, Mapping) else {}
    wanted = {name: getattr(before, name) for name in getattr(before, "SAME", ())}
    others = {name: saved.get(name) for name in wanted if saved.get(name) != wanted[name]}
    if others:
        held, ours = (
            " and ".join(f"{name} {reprlib.repr(values[name])}" for name in others)
            for values in (others, wanted)
        )
        raise StateError(f"saved for {held}, not for {ours}")
