"""Reads saved numbers with suspicion: a file may hold anything."""

from __future__ import annotations

from collections.abc import Mapping
import math
import reprlib
import sys
from typing import Any

from evpinn_ros.errors import InputError


def section(saved: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A part of what was saved; InputError when it is missing."""
    found = saved.get(name)
    if not isinstance(found, Mapping):
        raise InputError(f"saved energy: '{name}' is missing")
    return found


def number(saved: Mapping[str, Any], name: str, may_be_unknown: bool = False) -> float:
    """A finite number, or NaN for an unknown one; InputError when it is neither."""
    value = saved.get(name)
    if value is None and may_be_unknown and name in saved:
        return math.nan
    if not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
        raise InputError(f"saved energy: '{name}' is {_shown(value)}, expected a number")
    return float(value)


def numbers(
    saved: Mapping[str, Any], name: str, count: int, may_be_unknown: bool = False
) -> list[float]:
    """So many finite numbers, NaN for unknown ones; InputError when they are not."""
    values = saved.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise InputError(f"saved energy: '{name}' is {_shown(values)}, expected {count} numbers")
    return [number({name: value}, name, may_be_unknown) for value in values]


def _shown(value: object) -> str:
    return reprlib.repr(value)  # of a list of a million numbers, a few


def or_none(value: float) -> float | None:
    """The number as it is saved: JSON knows no NaN."""
    return None if math.isnan(value) else value
