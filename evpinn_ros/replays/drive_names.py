"""Names of drives that stand side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def short_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """A name for each drive, as short as it can be: of the file, with its folder if need be."""
    whole = [path.absolute() for path in paths]
    for length in range(1, 1 + max(len(path.parts) for path in whole)):
        names = ["/".join(path.parts[-length:]) for path in whole]
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(f"{number}: {path.name}" for number, path in enumerate(whole, start=1))
