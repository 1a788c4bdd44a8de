"""Creates every output file of the package.

A file is complete or absent, never follows a link that another user made, and overwrites no input:
also after a power failure or a kill, on a full disk, beside another writer, and in a folder of
another user. Functions raise OSError.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
import errno
import fcntl
import os
from pathlib import Path
import re
from tempfile import mkstemp
import time
from typing import BinaryIO, TextIO
from weakref import finalize
import zlib

from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import input_at, note_own, open_file
from evpinn_ros.common.units import MEBIBYTE

DRAFT = ".evpinn-draft-"
"""Start of a draft's name; it does not contain the file's name, which may have maximal length."""
PATIENCE = 10.0  # s to wait for another writer; a state takes milliseconds
ABANDONED = 86_400.0  # s, age from which a draft of another machine counts as abandoned
_DRAFT = re.compile(re.escape(DRAFT) + r"(?P<machine>\w+)-(?P<pid>\d+)-(?P<start>\d+)-.*")
_START, _STATE = 19, 0  # fields of /proc/PID/stat after the name
BAG_FILES = (".mcap", ".db3", ".zstd", ".yaml")
_POLL = 0.005  # s


def sync(path: Path) -> None:
    """Flush the content of a file, or the names in a folder, to the disk if possible."""
    with suppress(OSError):  # some file systems do not sync folders
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def plain_cell(text: str) -> str:
    """The text of a cell, on one line."""
    return " ".join(text.splitlines()).strip()


@contextmanager
def replaced(path: Path, *, private: bool = False, update: bool = False) -> Iterator[BinaryIO]:
    """Yields a draft that replaces a file once it is complete, and is removed after an error.

    The draft is made by `mkstemp`, and flushed to the disk before it replaces the file. A pipe or
    device is written directly. Only its owner can read a new `private` file. InputError for a file
    that this process has read, unless it is an `update` of that file.
    """
    target = resolved(path)
    if not update:
        _refuse_input(path, target)
    if target.exists() and not target.is_file():
        with target.open("wb") as device:
            yield device
        return
    _sweep(target.parent)
    writer = f"{_machine()}-{os.getpid()}-{_start_of(os.getpid())}"
    handle, name = mkstemp(prefix=f"{DRAFT}{writer}-", dir=target.parent)
    draft = Path(name)
    try:
        with os.fdopen(handle, "w+b") as file:
            yield file
            file.flush()
            os.fchmod(handle, _mode(target, private))
            os.fsync(handle)
        draft.replace(target)
        note_own(target)
    except BaseException:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise


def write_file(
    path: Path, content: str | bytes, *, private: bool = False, update: bool = False
) -> None:
    """Write a whole file as `replaced` does, in UTF-8; makes its folder if missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path, private=private, update=update) as draft:
        draft.write(content.encode() if isinstance(content, str) else content)


def append_to(path: Path, content: str) -> None:
    """Append text to an existing file, all or nothing, without flushing it to the disk."""
    handle, text = os.open(resolved(path), os.O_WRONLY | os.O_APPEND), content.encode()
    try:
        if (written := os.write(handle, text)) < len(text):
            os.ftruncate(handle, os.fstat(handle).st_size - written)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
    finally:
        os.close(handle)


def new_file(path: Path) -> BinaryIO:
    """Create a file to write; OSError if there is one already, or a link."""
    return path.open("xb")


def new_table(path: Path, *, by_line: bool = False) -> TextIO:
    """Create a text file for the csv module, as `new_file` does; `by_line` flushes each line."""
    return path.open("x", 1 if by_line else -1, newline="", encoding="utf-8")


def mark(path: Path) -> None:
    """Make an empty file; an existing one stays as it is."""
    with suppress(FileExistsError), path.open("xb"):
        pass


def copy_file(source: Path, target: Path) -> None:
    """Copy a file, with its holes, to a new file."""
    with open_file(source) as content, new_file(target) as copy:
        for begin, end in _data_of(content):
            content.seek(begin)
            copy.seek(begin)
            while piece := content.read(min(MEBIBYTE, end - content.tell())):
                copy.write(piece)
        copy.truncate(os.fstat(content.fileno()).st_size)


class Held:
    """A lock file, held until `release` or the end; never refused on a system without locks."""

    def __init__(self, path: Path, busy: str) -> None:
        """Take the lock; InputError (`busy`) if another holds it, OSError if it cannot be made."""
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        while True:
            handle = os.open(path, flags, 0o600)
            if not _locked(handle):
                os.close(handle)
                raise InputError(busy)
            if _is_at(handle, path):
                break
            os.close(handle)  # its holder removed the file after it was opened here
        self._release = finalize(self, _let_go, path, handle, os.getpid())

    def __enter__(self) -> Held:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the lock; a second call does nothing."""
        self._release()


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Lock a file while it is read and rewritten; TimeoutError after 10 s.

    The lock is on its folder: it leaves no lock file, and ends with a killed process.
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
    """The path with all links followed; OSError for a loop of links."""
    try:
        return path.resolve()
    except RuntimeError as error:  # before Python 3.13
        raise OSError(0, "a loop of links", str(path)) from error


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """Raise InputError for outputs (not None or `-`) that would overwrite inputs or each other.

    Inputs are the given ones, opened or not, and every file that this process has read.
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
                raise _over(path, given)
        _refuse_input(path, target)
        if target in written:
            raise InputError(f"{path}: two results would be written there")
        written.add(target)


def _data_of(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """Start and end, bytes, of each part of a file that holds data, between its holes."""
    end = 0
    try:
        while True:
            begin = os.lseek(file.fileno(), end, os.SEEK_DATA)
            end = os.lseek(file.fileno(), begin, os.SEEK_HOLE)
            yield begin, end
    except OSError as error:
        if error.errno != errno.ENXIO:  # no more data
            raise


def _refuse_input(path: Path, target: Path) -> None:
    if (given := input_at(target)) is not None:
        raise _over(path, given)


def _over(path: Path, given: Path) -> InputError:
    return InputError(f"{path}: would be written over the input {given}")


def _is_there(path: Path) -> bool:
    with suppress(OSError, ValueError):
        return path.exists()
    return False


def _target(path: Path) -> Path:
    with as_input_error(path, ValueError):
        return resolved(path)


def _is_same(path: Path, other: Path) -> bool:
    with suppress(OSError):
        return path == other or path.samefile(other)
    return False


def _machine() -> str:
    """Name of the machine or container in which a process id is unique."""
    place = os.uname().nodename + str(Path("/proc/self/ns/pid").readlink())
    return f"{zlib.crc32(place.encode()):08x}"


def _start_of(pid: int) -> int:
    """Start time of a running process, in ticks of the kernel; 0 if there is no such process."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    fields = text.rpartition(")")[2].split()
    return 0 if fields[_STATE] in "ZX" else int(fields[_START])


def _let_go(path: Path, handle: int, holder: int) -> None:
    """Remove a lock file and close it; a fork of the holder does not remove it."""
    if os.getpid() == holder and _is_at(handle, path):
        with suppress(OSError):
            path.unlink()
    os.close(handle)


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except OSError:
        return False


def _sweep(folder: Path) -> None:
    for path in folder.glob(f"{DRAFT}*"):
        with suppress(OSError):
            if _is_abandoned(path):
                path.unlink(missing_ok=True)


def _is_abandoned(draft: Path) -> bool:
    """Whether the writer of a draft has ended; on another machine, whether a day has passed."""
    name = _DRAFT.fullmatch(draft.name)
    if name is not None and name["machine"] == _machine():
        return _start_of(int(name["pid"])) != int(name["start"])
    return time.time() - draft.lstat().st_mtime > ABANDONED


def _locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without such locks, as NFS for folders
        pass
    return True


def _mode(target: Path, private: bool) -> int:
    """Permissions of the replaced file; for a new file by umask, or of the owner alone."""
    with suppress(OSError):
        return target.stat().st_mode & 0o777
    if private:
        return 0o600
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
