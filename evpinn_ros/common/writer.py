"""The one way out: files that are whole or not there, that follow no link and destroy no input.

That holds after a loss of power, a kill, on a full disk, beside another process that writes the
same file, and in a folder that others may write to as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
import fcntl
import os
from pathlib import Path
from tempfile import mkstemp
import time

from evpinn_ros.common.errors import InputError, as_input_error

DRAFT = ".evpinn-draft-"
"""Begin of a draft's name: as short as that, for the file's own name may be as long as can be."""
PATIENCE = 10.0  # s that a writer waits for another one; a state takes milliseconds
BAG_FILES = (".mcap", ".db3", ".zstd", ".yaml")
_POLL = 0.005  # s


def sync(path: Path) -> None:
    """Put the content of a file, or the names in a folder, on the disk, as far as it can be."""
    with suppress(OSError):  # some file systems do not sync folders
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A draft that takes the place of a file when it is whole; of one that is not nothing stays.

    The draft is new and this process's own (`mkstemp`: O_EXCL, O_NOFOLLOW), on the disk before it
    takes the place. What is no file, such as a pipe, is written to as it is.

    Args:
        path: of the file.

    Yields:
        Path of the draft.

    Raises:
        OSError: the file cannot be written, or its links lead in a circle.
    """
    target = resolved(path)
    if target.exists() and not target.is_file():
        yield target
        return
    _sweep(target.parent)
    handle, name = mkstemp(prefix=DRAFT, dir=target.parent)
    draft = Path(name)
    try:
        _locked(handle)  # for as long as this process lives
        yield draft
        draft.chmod(_mode(target))
        os.fsync(handle)
        draft.replace(target)
    except BaseException:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise
    finally:
        os.close(handle)


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Keep others from writing a file while it is read, changed and written again.

    The lock is on its folder, so no file of locks lies beside it, and a killed process holds none.

    Raises:
        OSError: another process has written there for 10 s, or there is no such folder.
    """
    folder = os.open(resolved(path).parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        begin = time.monotonic()
        while not _locked(folder):
            if time.monotonic() - begin > PATIENCE:
                raise TimeoutError(0, f"another process has been writing for {PATIENCE:g} s")
            time.sleep(_POLL)
        yield
    finally:
        os.close(folder)


def resolved(path: Path) -> Path:
    """The file that a path leads to, over links.

    Raises:
        OSError: they lead in a circle.
    """
    try:
        return path.resolve()
    except RuntimeError as error:  # before Python 3.13
        raise OSError(0, "its links lead in a circle", str(path)) from error


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """Refuse, before work begins, what would write over an input or two outputs into one file.

    Args:
        outputs: files and folders to write; None and `-` are none.
        inputs: files and folders that are read.

    Raises:
        InputError: with both names.
    """
    read = [(path, _target(path)) for path in inputs if path is not None and _is_there(path)]
    written: set[Path] = set()
    for path in outputs:
        if path is None or str(path) == "-":
            continue
        target = _target(path)
        if target.exists() and not (target.is_file() or target.is_dir()):
            continue  # a device, such as /dev/null
        for given, source in read:
            of_a_bag = source in target.parents and target.suffix in BAG_FILES
            if of_a_bag or _is_same(source, target):
                raise InputError(f"{path}: would be written over the input {given}")
        if target in written:
            raise InputError(f"{path}: two results would be written there")
        written.add(target)


def _is_there(path: Path) -> bool:
    with suppress(OSError, ValueError):
        return path.exists()
    return False


def _target(path: Path) -> Path:
    with as_input_error(path, ValueError):
        return resolved(path)


def _is_same(path: Path, other: Path) -> bool:
    """True if two paths lead to one file, by a hard link perhaps."""
    with suppress(OSError):
        return path == other or path.samefile(other)
    return False


def _sweep(folder: Path) -> None:
    """Remove drafts that killed processes left: no process holds them."""
    with suppress(OSError):
        for path in folder.glob(f"{DRAFT}*"):
            draft = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            if _locked(draft):
                path.unlink()
            os.close(draft)


def _locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without such locks, as NFS has none of folders
        pass
    return True


def _mode(target: Path) -> int:
    """Permissions of the file that is replaced; of a new one those that the person's umask leaves.

    A draft of `mkstemp` is for its owner alone.
    """
    with suppress(OSError):
        return target.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
