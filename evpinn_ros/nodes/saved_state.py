"""Keeps what a node learned or counted in a file, and never loses what it cannot use."""

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

MOST_APPENDED = 600  # states behind one that was written whole; 1.5 kB each


class Stateful(Protocol):
    """Something whose state can be saved: `OnlineEstimator`, `EnergyAccount`."""

    def export(self) -> Mapping[str, Any]:
        """What `restore` takes, as JSON holds it."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved state; ValueError when it does not fit."""

    def reset(self) -> None:
        """Forget all that was learned."""


class StateFile:
    """The state file of one node, which has a half of it; another node may have the other."""

    def __init__(self, path: Path | None, owner: Stateful, half: Half) -> None:
        self.problem: str | None = None  # why the file was not used or not written
        self._path, self._owner, self._half = path, owner, half
        self._loaded: Mapping[str, Any] | None = None
        self._refused: tuple[int, int] | None = None  # which file that was
        self._readable, self._unwritable = True, False
        self._claim: StateClaim | None = None
        self._appendable = 0  # states that may follow the last that was written whole
        self.busy: str | None = None  # another process has the half: nothing is written

    def why_unwritable(self) -> str | None:
        """The reason why the file can never be written, None where it can or none is set."""
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
        """Claim the half, and restore the owner from the file, if there is a usable one."""
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
        """Leave the half to others."""
        if self._claim is not None:
            self._claim.release()

    @property
    def start(self) -> str | None:
        """State that the owner goes on from; None where nothing was restored."""
        return None if self._loaded is None else f"continues from {self._path}"

    def start_over(self) -> None:
        """Set the owner to what it was at the start: the loaded state, or nothing learned."""
        self._owner.reset()
        if self._loaded is None:
            return
        try:
            self._owner.restore(self._loaded)
        except Exception as error:
            # Any content is possible in a file that is JSON: nothing in it may stop the node.
            self._owner.reset()
            self._loaded = None
            self._refuse(f"{self._path}: not used: {error}")

    def forget(self) -> None:
        """Forget what was learned and what was loaded; the file stays until the next save."""
        self._loaded = None
        self._owner.reset()

    def save(self) -> str | None:
        """Write the state; gives the reason when that fails."""
        if self._path is None:
            return "no file for it is set"
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
        """Append the state to the file, or now and then write it whole: a kill spares it."""
        if self._path is None or self._unwritable:
            return  # `save` tries again, in its own time
        if not self._appendable:
            self.save()
            return
        try:
            append_half(self._path, self._half, self._owner.export())
            self._appendable -= 1
        except (OSError, ValueError):
            self.save()  # which says what is wrong

    def _refuse(self, problem: str) -> None:
        if self._path is not None:
            self._refused = _identity(self._path)
            if self._path.is_file():
                kept = refused_names(self._path)[0].name
                problem += f"; its {self._half.value} half begins anew, the file is kept as {kept}"
        self.problem = problem

    def _set_refused_aside(self, path: Path) -> None:
        """Keep a file that was refused, unless the node of its other half has done so."""
        if self._refused is not None:
            with claimed(path):
                if _identity(path) == self._refused:
                    set_aside(path, copied=self._readable)
        self._refused = None


def state_path(text: str) -> Path | None:
    """The path of a parameter, None where empty; InputError for a `~` of nobody."""
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
