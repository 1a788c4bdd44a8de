"""Reads saved numbers with checks: a file may hold anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
import reprlib
import sys
from typing import Any

from evpinn_ros.common.errors import InputError


def section(saved: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A part of what was saved; InputError when it is missing."""
    found = saved.get(name)
    if not isinstance(found, Mapping):
        raise InputError(f"saved energy: '{name}' is missing")
    return found


def number(
    saved: Mapping[str, Any],
    name: str,
    may_be_unknown: bool = False,
    most: float = sys.float_info.max,
) -> float:
    """A number of at most this size, or NaN for an unknown one; InputError when it is neither."""
    value = saved.get(name)
    if value is None and may_be_unknown and name in saved:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= most:
        bound = "" if most == sys.float_info.max else f" of at most {most:g}"
        raise InputError(f"saved energy: '{name}' is {_shown(value)}, expected a number{bound}")
    return float(value)


def numbers(
    saved: Mapping[str, Any], name: str, most: Sequence[float], may_be_unknown: bool = False
) -> list[float]:
    """As many numbers as bounds, each within its own, NaN for unknown ones; else InputError."""
    values = saved.get(name)
    if not isinstance(values, list) or len(values) != len(most):
        wanted = f"expected {len(most)} numbers"
        raise InputError(f"saved energy: '{name}' is {_shown(values)}, {wanted}")
    pairs = zip(values, most, strict=True)
    return [number({name: value}, name, may_be_unknown, bound) for value, bound in pairs]


def _shown(value: object) -> str:
    return reprlib.repr(value)  # of a list of a million numbers, a few


def or_none(value: float) -> float | None:
    """The number as it is saved: JSON knows no NaN."""
    return None if math.isnan(value) else value
