"""Knowledge of a car, kept between drives: one JSON file, written whole, checked when read.

The file has two halves: `learned`, of the estimator, and `energy`, of the energy account. Each is
written by its owner, perhaps another process, and leaves the other as it is. Lines behind the
JSON are newer states of a half, appended between two writes of the whole; the last may be torn.
Files of earlier versions hold one half alone, the account in `car.energy.json` beside `car.json`;
they are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from enum import Enum
from itertools import pairwise
import json
import math
import os
from pathlib import Path
import shutil
from typing import Any, NoReturn
import zlib

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import open_file, read_whole
from evpinn_ros.common.writer import (
    Held,
    append_to,
    claimed,
    replaced,
    resolved,
    sync,
    write_file,
)

MAX_FILE_BYTES = 4_000_000  # mode paper saves 1 MB, hybrid less; empty lists take 30 times as much
REFUSED_KEPT = 5  # files
State = Mapping[str, Any]


class Half(str, Enum):
    """A half of a state file: its key."""

    LEARNED = "learned"
    ENERGY = "energy"


LOCK = ".evpinn-lock-"
"""Begin of a lock's name; a checksum follows, because the file's name may be of full length."""
KEYS = {half.value for half in Half}
REMEDY = "give another file, or rename this one: the car is then learned anew"


class StateClaim:
    """Keeps other processes from halves of a state file while this one learns into them.

    Taken before the file is read and kept until the last write; otherwise what one of two
    processes learns would be lost. A killed process holds none.
    """

    def __init__(self, path: Path | None, halves: Iterable[Half] = Half) -> None:
        """Claim halves of the file, in a folder that is made if need be; None claims nothing.

        Raises:
            InputError: another process has them.
        """
        self._held: list[Held] = []
        if path is None or (path.exists() and not path.is_file()):
            return
        busy = (
            f"{path}: another evpinn learns into this file; wait until it has ended, "
            "or give another file"
        )
        try:
            for half in halves:
                with suppress(OSError):  # a folder without locks can hold no state either
                    target = resolved(path)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    name = f"{LOCK}{zlib.crc32(os.fsencode(target.name)):08x}-{half.value}"
                    self._held.append(Held(target.with_name(name), busy))
        except InputError:
            self.release()
            raise

    def __enter__(self) -> StateClaim:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Leave the halves to others; a second call does nothing."""
        while self._held:
            self._held.pop().release()


def account_path(state: Path) -> Path:
    """The file in which earlier versions kept the energy account: `car.energy.json`."""
    return state.with_suffix(".energy.json")


def write_state(path: Path, state: State) -> None:
    """Write a JSON file so that a crash at any instant leaves the old one or the new one whole.

    Once written, it survives a loss of power.

    Raises:
        OSError: the file cannot be written.
        ValueError: the state holds a number that is not finite.
    """
    write_file(path, json.dumps(state, allow_nan=False), private=True, update=True)
    sync(path.resolve().parent)


def write_halves(path: Path, halves: Mapping[Half, State]) -> None:
    """Write halves of a state file and keep the other; two writers wait for each other.

    Raises:
        OSError: the file cannot be written, or another process does not cease to write.
        ValueError: a half holds a number that is not finite.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with claimed(path):
        kept: State = {}
        try:
            if content := read_state(path):
                kept = _halves(content, Half.LEARNED)
        except InputError:  # it was damaged since it was read
            set_aside(path)
        write_state(path, {**kept, **{half.value: state for half, state in halves.items()}})


def append_half(path: Path, half: Half, state: State) -> None:
    """Append the state of a half to a file that `write_halves` wrote; the last one counts.

    Raises:
        OSError: as of `write_halves`.
        ValueError: the half holds a number that is not finite.
    """
    with claimed(path):
        append_to(path, f"\n{json.dumps({half.value: state}, allow_nan=False)}")


def read_half(path: Path, half: Half) -> tuple[State | None, str | None]:
    """Read one half of a state file.

    Returns:
        the half, None when there is none; and a message if the file holds the other half alone.

    Raises:
        InputError: the file cannot be read or is not a state; the text has file and reason.
    """
    content = read_state(path)
    halves = {} if content is None else _halves(content, half)
    half_state = halves.get(half.value)
    if half_state is None and half is Half.ENERGY:
        half_state = read_state(account_path(path))
    if half_state is not None or not halves:
        return half_state, None
    return None, f"{path}: holds no '{half.value}' of the car, which begins anew; the rest is used"


@contextmanager
def read_for_a_person(path: Path) -> Iterator[None]:
    """Add a remedy to errors of a state, for commands; nodes go on without the state."""
    try:
        yield
    except (InputError, ValueError) as error:
        text = str(error) if str(path) in str(error) else f"{path}: {error}"
        raise InputError(f"{text}; {REMEDY}") from error


def vehicle_of(path: Path) -> str | None:
    """The vehicle that a saved state is of; None where it says none.

    Raises:
        InputError: as of `read_half`.
    """
    with read_for_a_person(path):
        learned, _ = read_half(path, Half.LEARNED)
    vehicle = (learned or {}).get("vehicle")
    return vehicle if isinstance(vehicle, str) else None


def read_state(path: Path) -> dict[str, Any] | None:
    """Read a JSON file of a state, None when there is no such file.

    Raises:
        InputError: the file cannot be read or is not a state; the text has file and reason.
    """
    try:
        text = read_whole(path, MAX_FILE_BYTES, "a saved state")
    except FileNotFoundError:
        return None
    try:
        return _with_appended(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        reason = f": {error}" if str(error) else ""
        raise InputError(f"{path}: not a saved state{reason}") from error


def set_aside(path: Path, *, copied: bool = False) -> None:
    """Keep a file that cannot be used as `.refused`, the newest five of its name.

    It may be another car's. If only one half is refused, the file is copied and the other goes on.

    Raises:
        OSError: it is not a regular file, and stays.
    """
    if not path.is_file():
        raise OSError(0, "not a regular file", str(path))
    first, *_ = names = refused_names(path)
    for older, newer in pairwise(reversed(names)):
        if newer.exists():
            newer.replace(older)
    if not copied:
        path.replace(first)
        return
    with open_file(path) as file, replaced(first, private=True, update=True) as draft:
        shutil.copyfileobj(file, draft)


def refused_names(path: Path) -> list[Path]:
    """Places of refused files, the newest first."""
    first = path.with_name(path.name + ".refused")
    return [first, *(first.with_name(f"{first.name}.{n}") for n in range(2, REFUSED_KEPT + 1))]


def _with_appended(text: str) -> dict[str, Any]:
    """The JSON at the begin of a text, updated by the halves on the lines behind it.

    Raises:
        ValueError: the JSON, or a line before the last, is not a state.
    """
    content, end = _DECODER.raw_decode(text, len(text) - len(text.lstrip()))
    behind = text[end:].rstrip("\0\n")  # a loss of power leaves NUL bytes
    if not _is_state(content):
        raise ValueError
    state: dict[str, Any] = content
    if behind and not (behind.startswith("\n") and KEYS & state.keys()):
        raise ValueError
    lines = behind.splitlines()[1:]
    for number, line in enumerate(lines, 1):
        try:
            appended = _DECODER.decode(line)
        except ValueError:
            if number < len(lines):
                raise
            break  # a write was cut by a loss of power
        if not (_is_state(appended) and KEYS & appended.keys()):
            raise ValueError
        state.update(appended)
    return state


def _is_state(content: Any) -> bool:
    """True for a mapping that has only halves, or none of them."""
    return isinstance(content, dict) and (
        not KEYS & content.keys()
        or (content.keys() <= KEYS and all(isinstance(part, dict) for part in content.values()))
    )


def _halves(content: State, asked: Half) -> dict[str, Any]:
    """The halves in a file; a file of an earlier version has one."""
    if KEYS & content.keys():
        return dict(content)
    if "before_reset" in content:
        return {Half.ENERGY.value: content}
    return {(Half.LEARNED if "mode" in content else asked).value: content}


def _finite(digits: str) -> float:
    """The number; ValueError if it is infinite, as 1e999 is."""
    number = float(digits)
    return number if math.isfinite(number) else _refuse(digits)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a finite number")


_DECODER = json.JSONDecoder(parse_constant=_refuse, parse_float=_finite)
