"""Folders of the package data: configuration, launch files and bundled bags."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import sys

PACKAGE = "evpinn_ros"


def share_directory() -> Path:
    """The folder that holds `config/`; FileNotFoundError without the data files."""
    for candidate in _candidates():
        if (candidate / "config" / "vehicles").is_dir():
            return candidate
    raise FileNotFoundError(f"{PACKAGE}: config/vehicles is in none of the install locations")


def bundled_lines(name: str) -> list[str]:
    """Lines of a text file of the package data, without those that begin with #."""
    lines = (share_directory() / name).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if not line.startswith("#")]


def _candidates() -> Iterator[Path]:
    module = Path(__file__).resolve()
    yield module.parents[2]
    for parent in module.parents:
        yield parent / "share" / PACKAGE
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / PACKAGE
    yield Path(sys.prefix) / "share" / PACKAGE
