"""What was learned, kept between drives: JSON, written atomically, read with suspicion."""

from __future__ import annotations

from collections.abc import Mapping
import json
import os
from pathlib import Path
from typing import Any

from evpinn_ros.errors import InputError

MAX_FILE_BYTES = 20_000_000


def write_state(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state so that a crash at any instant leaves the old file or the new one whole.

    Raises:
        OSError: the file cannot be written.
        ValueError: the state holds a number that is not finite.
    """
    text = json.dumps(state, allow_nan=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    with fresh.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)


def read_state(path: Path) -> dict[str, Any] | None:
    """Read a state, None when there is no such file.

    Raises:
        InputError: the file cannot be read or is not a state; the text has file and reason.
    """
    try:
        size = path.stat().st_size
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    if size > MAX_FILE_BYTES:
        raise InputError(f"{path}: larger than {MAX_FILE_BYTES} bytes, not a saved state")
    try:
        state = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a saved state: {error}") from error
    if not isinstance(state, dict):
        raise InputError(f"{path}: not a saved state")
    return state


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number to be saved")
