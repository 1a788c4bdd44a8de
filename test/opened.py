"""What Python opens to read, whoever asks it to: told by an audit hook, not by the opener."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import sys
from urllib.parse import unquote, urlsplit

_asked: list[set[Path]] = []
_written: set[Path] = set()


def _hear(event: str, arguments: tuple[object, ...]) -> None:
    if not _asked or event not in ("open", "os.rename", "sqlite3.connect"):
        return
    named = arguments[1 if event == "os.rename" else 0]
    if not isinstance(named, str | bytes | os.PathLike):
        return
    text = os.fsdecode(named)
    path = Path(unquote(urlsplit(text).path) if text.startswith("file:") else text).resolve()
    if event == "os.rename":
        _written.add(path)
    elif path not in _written and not (event == "open" and _is_to_write(arguments[2])):
        _asked[-1].add(path)


def _is_to_write(flags: object) -> bool:
    return isinstance(flags, int) and bool(flags & (os.O_WRONLY | os.O_RDWR))


sys.addaudithook(_hear)


@contextmanager
def opened_to_read() -> Iterator[set[Path]]:
    """The files that are opened to read within a block, but for those that were written in it."""
    _written.clear()
    _asked.append(set())
    try:
        yield _asked[-1]
    finally:
        _asked.pop()
