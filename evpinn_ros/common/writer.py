"""The one way out: every file of the package is created here.

Files are whole or not there, follow no link that somebody laid, and destroy no input: after a loss
of power, a kill, on a full disk, beside another writer, and in a folder of others. OSErrors come
through.
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
"""Begin of a draft's name: as short as that, for the file's own name may be as long as can be."""
PATIENCE = 10.0  # s that a writer waits for another one; a state takes milliseconds
ABANDONED = 86_400.0  # s, age of a draft of another machine that nobody writes any more
_DRAFT = re.compile(re.escape(DRAFT) + r"(?P<machine>\w+)-(?P<pid>\d+)-(?P<start>\d+)-.*")
_START, _STATE = 19, 0  # fields of /proc/PID/stat behind the name
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


def plain_cell(text: str) -> str:
    """The text of a cell, on one line."""
    return " ".join(text.splitlines()).strip()


@contextmanager
def replaced(path: Path, *, private: bool = False, update: bool = False) -> Iterator[BinaryIO]:
    """A draft that takes the place of a file when it is whole, else nothing stays; or OSError.

    The draft is new and this process's own (`mkstemp`), on the disk before it takes the place.
    What is no file, such as a pipe, is written to as it is. A new `private` file is for its owner
    alone. InputError for a file that this process has read, unless it is an `update` of that.
    """
    target = resolved(path)
    if not update:
        _refuse_input(path, target)
    if target.exists() and not target.is_file():
        with target.open("wb") as other:
            yield other
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
    """Write a whole file as `replaced` does, in UTF-8, and its folder if need be."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path, private=private, update=update) as draft:
        draft.write(content.encode() if isinstance(content, str) else content)


def append_to(path: Path, content: str) -> None:
    """Append text to a file that is there, all or nothing, not synced to the disk."""
    handle, text = os.open(resolved(path), os.O_WRONLY | os.O_APPEND), content.encode()
    try:
        if (written := os.write(handle, text)) < len(text):
            os.ftruncate(handle, os.fstat(handle).st_size - written)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
    finally:
        os.close(handle)


def new_file(path: Path) -> BinaryIO:
    """A file to write that is not there yet, not even as a link."""
    return path.open("xb")


def new_table(path: Path, *, by_line: bool = False) -> TextIO:
    """A file of text to write that is not there yet, for the csv module; or handed on by lines."""
    return path.open("x", 1 if by_line else -1, newline="", encoding="utf-8")


def mark(path: Path) -> None:
    """Make an empty file; what is there stays as it is."""
    with suppress(FileExistsError), path.open("xb"):
        pass


def copy_file(source: Path, target: Path) -> None:
    """Copy a file to a place where there is none yet, without filling its holes."""
    with open_file(source) as content, new_file(target) as copy:
        for begin, end in _data_of(content):
            content.seek(begin)
            copy.seek(begin)
            while piece := content.read(min(MEBIBYTE, end - content.tell())):
                copy.write(piece)
        copy.truncate(os.fstat(content.fileno()).st_size)


class Held:
    """A lock file, held until it is released or the process ends; all get it without locks."""

    def __init__(self, path: Path, busy: str) -> None:
        """Take the lock; InputError (`busy`) if it is held, OSError if it cannot be made."""
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        while True:
            handle = os.open(path, flags, 0o600)
            if not _locked(handle):
                os.close(handle)
                raise InputError(busy)
            if _is_at(handle, path):
                break
            os.close(handle)  # its holder removed the file once it was opened here
        self._release = finalize(self, _let_go, path, handle, os.getpid())

    def __enter__(self) -> Held:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Give the lock to others; a second call does nothing."""
        self._release()


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """Keep others from writing a file between reading and writing it; OSError after 10 s.

    The lock is on its folder, so no file of locks lies beside it, and a killed process holds none.
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
    """The file that a path leads to, over links; OSError for a circle."""
    try:
        return path.resolve()
    except RuntimeError as error:  # before Python 3.13
        raise OSError(0, "its links lead in a circle", str(path)) from error


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """InputError for outputs (not None or `-`) that would write over inputs or each other.

    Inputs are those given, which need not be open yet, and every file that this process has read.
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
    """Where a file holds data, between holes that may have any size."""
    end = 0
    try:
        while True:
            begin = os.lseek(file.fileno(), end, os.SEEK_DATA)
            end = os.lseek(file.fileno(), begin, os.SEEK_HOLE)
            yield begin, end
    except OSError as error:
        if error.errno != errno.ENXIO:  # which says that there is no more
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
    """Where numbers of processes mean the same: a machine, or a container on it."""
    place = os.uname().nodename + str(Path("/proc/self/ns/pid").readlink())
    return f"{zlib.crc32(place.encode()):08x}"


def _start_of(pid: int) -> int:
    """Time at which a living process began, in ticks of the kernel; 0 where there is none."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    fields = text.rpartition(")")[2].split()
    return 0 if fields[_STATE] in "ZX" else int(fields[_START])


def _let_go(path: Path, handle: int, holder: int) -> None:
    """Remove a lock file and close it; a fork of the holder leaves it there."""
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
    """True if the writer of a draft has ended; one of another machine counts as ended in a day."""
    name = _DRAFT.fullmatch(draft.name)
    if name is not None and name["machine"] == _machine():
        return _start_of(int(name["pid"])) != int(name["start"])
    return time.time() - draft.lstat().st_mtime > ABANDONED


def _locked(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without such locks, as NFS has none of folders
        pass
    return True


def _mode(target: Path, private: bool) -> int:
    """Permissions of the file that is replaced; of a new one by umask, or the owner's alone."""
    with suppress(OSError):
        return target.stat().st_mode & 0o777
    if private:
        return 0o600
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
