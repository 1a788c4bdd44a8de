"""Learned state kept between drives: JSON, written atomically, validated when read."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
import os
from pathlib import Path
from typing import Any, NoReturn

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import open_file
from evpinn_ros.common.writer import replaced, sync

MAX_FILE_BYTES = 20_000_000  # mode paper saves 1 MB, hybrid less


def account_path(state: Path) -> Path:
    """File beside a state that keeps the energy account of the car: `car.energy.json`."""
    return state.with_suffix(".energy.json")


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state so that a crash at any instant leaves the old file or the new one whole.

    Once it is written it outlives a loss of power.

    Raises:
        OSError: the file cannot be written.
        ValueError: the state holds a number that is not finite.
    """
    text = json.dumps(state, allow_nan=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path) as draft, draft.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    sync(path.resolve().parent)


def read_state(path: Path) -> dict[str, Any] | None:
    """Read a state, None when there is no such file.

    Raises:
        InputError: the file cannot be read or is not a state; the text has file and reason.
    """
    try:
        with open_file(path) as file:
            text = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    if len(text) > MAX_FILE_BYTES:
        raise InputError(f"{path}: larger than {MAX_FILE_BYTES} bytes, not a saved state")
    try:
        state = json.loads(text.decode("utf-8"), parse_constant=_refuse, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a saved state: {error}") from error
    if not isinstance(state, dict):
        raise InputError(f"{path}: not a saved state")
    return state


def _finite(digits: str) -> float:
    """The number; 1e999 would be infinite."""
    number = float(digits)
    return number if math.isfinite(number) else _refuse(digits)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number to be saved")
