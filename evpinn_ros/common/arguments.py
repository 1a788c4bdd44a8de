"""Arguments that a person gives from Python: an error names the wrong one in one line."""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path
from typing import Any

import numpy as np

from evpinn_ros.common.errors import InputError

LONGEST_SHOWN = 40  # characters of a value in an error


def number(name: str, value: Any) -> float:
    """A number of any kind as a float; NaN stays NaN.

    Raises:
        InputError: it is no number, or larger than a float can be.
    """
    if not isinstance(value, str | bytes | bytearray):
        try:
            return float(value)
        except OverflowError as error:
            raise InputError(f"{name} is larger than any number of a car") from error
        except (TypeError, ValueError):
            pass
    raise InputError(f"{name} is {shown(value)}, not a number")


def finite(name: str, value: Any) -> float:
    """A number that is neither NaN nor infinite.

    Raises:
        InputError: it is none.
    """
    found = number(name, value)
    if not math.isfinite(found):
        raise InputError(f"{name} is {found}, not a finite number")
    return found


def finite_or_none(name: str, value: Any) -> float | None:
    """A finite number, or None where the argument was left out.

    Raises:
        InputError: it is something else.
    """
    return None if value is None else finite(name, value)


def path_of(name: str, value: Any) -> Path:
    """A path given as text or as a path.

    Raises:
        InputError: it is something else, or no file can have such a name.
    """
    try:
        path = Path(value)
    except TypeError as error:
        raise InputError(f"{name} is {shown(value)}, not a path") from error
    if "\0" in str(path):
        raise InputError(f"{name} is no name that a file can have")
    return path


def text_of(name: str, value: Any) -> str:
    """Text as it is.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(value, str):
        raise InputError(f"{name} is {shown(value)}, not text")
    return value


def truth_of(name: str, value: Any) -> bool:
    """True or False, of numpy too.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} is {shown(value)}, not True or False")
    return bool(value)


def sequence_of(name: str, value: Any) -> Sequence[Any]:
    """A list or tuple as it is; text is none.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        raise InputError(f"{name} is {shown(value)}, not a list")
    return value


def shown(value: Any) -> str:
    """A value that was given in place of another, for an error: its kind, and itself if short."""
    if value is None:
        return "None"
    kind = type(value).__name__
    if isinstance(value, str | bytes | float | complex):
        return f"{kind} {value[:LONGEST_SHOWN] if isinstance(value, str | bytes) else value!r}"
    return kind
