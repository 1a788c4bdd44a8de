"""Saves the state of a node in a file; a file that it cannot use is renamed, not overwritten."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Protocol

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.writer import claimed
from evpinn_ros.core.estimation.state_file import (
    Half,
    StateClaim,
    append_half,
    read_half,
    refused_names,
    set_aside,
    write_halves,
)

MOST_APPENDED = 600  # states after a completely written one; 1.5 kB each


class Stateful(Protocol):
    """An object whose state can be saved: `OnlineEstimator`, `EnergyAccount`."""

    def export(self) -> Mapping[str, Any]:
        """The state for `restore`, as JSON values."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved state; ValueError if it does not fit."""

    def reset(self) -> None:
        """Forget everything learned."""


class StateFile:
    """The state file of one node, which owns one half of it; another node may own the other."""

    def __init__(self, path: Path | None, owner: Stateful, half: Half) -> None:
        self.problem: str | None = None  # why the file was not used or not written
        self._path, self._owner, self._half = path, owner, half
        self._loaded: Mapping[str, Any] | None = None
        self._refused: tuple[int, int] | None = None  # inode and time of a refused file
        self._readable, self._unwritable = True, False
        self._claim: StateClaim | None = None
        self._appendable = 0  # states that may be appended before the next whole file
        self.busy: str | None = None  # set if another process owns the half: nothing is written

    def why_unwritable(self) -> str | None:
        """Why the file cannot be written; None if it can, or without a file."""
        if self._path is None:
            return None
        try:
            if not self._path.parent.exists():
                self._path.parent.mkdir(parents=True)
            with TemporaryFile(dir=self._path.parent):
                pass
        except OSError as error:
            return f"{self._path}: cannot be written: {error.strerror}"
        return f"{self._path}: cannot be written: a folder" if self._path.is_dir() else None

    def restore(self) -> None:
        """Claim the half, and restore the owner from the file if it is usable."""
        try:
            self._claim = StateClaim(self._path, [self._half])
        except InputError as error:
            self.busy, self._unwritable = str(error), True
        try:
            if self._path is not None:
                self._loaded, self.problem = read_half(self._path, self._half)
        except InputError as error:
            self._readable = False
            self._refuse(str(error))
            return
        self.start_over()
        self.problem = self.busy or self.problem

    def release(self) -> None:
        """Release the half."""
        if self._claim is not None:
            self._claim.release()

    @property
    def start(self) -> str | None:
        """Text on the restored state; None if nothing was restored."""
        return None if self._loaded is None else f"continues from {self._path}"

    def start_over(self) -> None:
        """Return the owner to its start: the loaded state, or nothing learned."""
        self._owner.reset()
        if self._loaded is None:
            return
        try:
            self._owner.restore(self._loaded)
        except Exception as error:
            # A JSON file may have any content, which must not stop the node.
            self._owner.reset()
            self._loaded = None
            self._refuse(f"{self._path}: not used: {error}")

    def forget(self) -> None:
        """Forget the learned and the loaded state; the file stays until the next save."""
        self._loaded = None
        self._owner.reset()

    def save(self) -> str | None:
        """Write the state; returns the reason if that fails."""
        if self._path is None:
            return "no file is set"
        if self.busy is not None:
            return self.busy
        try:
            self._set_refused_aside(self._path)
            write_halves(self._path, {self._half: self._owner.export()})
        except (OSError, ValueError) as error:
            self.problem, self._unwritable = f"{self._path}: not written: {error}", True
            return self.problem
        self._appendable, self.problem, self._unwritable = MOST_APPENDED, None, False
        return None

    def append(self) -> None:
        """Append the state to the file, or rewrite it after `MOST_APPENDED`; a kill loses none."""
        if self._path is None or self._unwritable:
            return  # `save` tries again at its next call
        if not self._appendable:
            self.save()
            return
        try:
            append_half(self._path, self._half, self._owner.export())
            self._appendable -= 1
        except (OSError, ValueError):
            self.save()  # it reports the problem

    def _refuse(self, problem: str) -> None:
        if self._path is not None:
            self._refused = _identity(self._path)
            if self._path.is_file():
                kept = refused_names(self._path)[0].name
                problem += f"; its {self._half.value} half begins anew, the file is kept as {kept}"
        self.problem = problem

    def _set_refused_aside(self, path: Path) -> None:
        """Rename a refused file, unless the node of its other half has done so."""
        if self._refused is not None:
            with claimed(path):
                if _identity(path) == self._refused:
                    set_aside(path, copied=self._readable)
        self._refused = None


def state_path(text: str) -> Path | None:
    """The path in a parameter, None if empty; InputError for a `~` of an unknown user."""
    try:
        return Path(text).expanduser() if text else None
    except RuntimeError as error:
        raise InputError(f"{text}: no home for '~'; give the whole path") from error


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns
