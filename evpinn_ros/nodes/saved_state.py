"""Keeps what a node learned or counted in a file, and never loses what it cannot use."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

from evpinn_ros.common.errors import InputError
from evpinn_ros.estimation.state_file import read_state, write_state

REFUSED_KEPT = 5  # files


class Stateful(Protocol):
    """Something whose state can be saved: `OnlineEstimator`, `EnergyAccount`."""

    def export(self) -> Mapping[str, Any]:
        """State to save."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved state; ValueError when it does not fit."""

    def reset(self) -> None:
        """Forget all that was learned."""


class StateFile:
    """The state file of one node.

    Attributes:
        problem: why the file was not used or not written, None if all is well.
    """

    def __init__(self, path: Path | None, owner: Stateful) -> None:
        """Keep the state of `owner` at `path`; None keeps nothing."""
        self.problem: str | None = None
        self._path, self._owner = path, owner
        self._loaded: Mapping[str, Any] | None = None
        self._refused = False

    def load(self) -> None:
        """Restore the owner from the file, if there is a usable one."""
        try:
            self._loaded = None if self._path is None else read_state(self._path)
        except InputError as error:
            self._refuse(str(error))
            return
        self.start_over()

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
        try:
            self._set_refused_aside(self._path)
            write_state(self._path, self._owner.export())
        except (OSError, ValueError) as error:
            self.problem = f"{self._path}: not written: {error}"
            return self.problem
        self.problem = None
        return None

    def _refuse(self, problem: str) -> None:
        aside = "" if self._path is None else f"; it will be kept as {_aside(self._path)[0].name}"
        self.problem, self._refused = problem + aside, True

    def _set_refused_aside(self, path: Path) -> None:
        """A file that was refused may be another car's: it is renamed, not overwritten."""
        if self._refused and path.exists():
            names = _aside(path)
            for older, newer in pairwise(reversed(names)):
                if newer.exists():
                    newer.replace(older)
            path.replace(names[0])
        self._refused = False


def state_path(text: str) -> Path | None:
    """The path that a parameter gives, None where it is empty.

    Raises:
        InputError: it begins with `~`, and no user has such a home.
    """
    try:
        return Path(text).expanduser() if text else None
    except RuntimeError as error:
        raise InputError(f"{text}: no home for '~'; give the whole path") from error


def _aside(path: Path) -> list[Path]:
    """Places of refused files, the newest first."""
    first = path.with_name(path.name + ".refused")
    return [first, *(first.with_name(f"{first.name}.{n}") for n in range(2, REFUSED_KEPT + 1))]
