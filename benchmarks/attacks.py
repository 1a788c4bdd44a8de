"""Attacks on the doors of the package: damaged files, and two writers of one state.

Each damaged file is read in a process of its own, forked from one that has imported the readers,
so that memory and time are those of the one file and of the parsers that it starts. That of
workbooks is forked too, for its imports take half a second; that of Parquet is started, for no
process in which polars is at work can be forked.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from dataclasses import dataclass, field
import gzip
from io import BytesIO
import os
from pathlib import Path
import random
import resource
import select
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
import traceback
from zipfile import ZIP_DEFLATED, ZipFile

from benchmarks.attack_seeds import SEEDS
from evpinn_ros.bags.names import BAG_SUFFIXES
from evpinn_ros.common import apart
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives import sheets  # noqa: F401 (imported before the fork)
from evpinn_ros.drives.formats import SHEET_SUFFIXES
from evpinn_ros.drives.sources import open_source
from evpinn_ros.estimation.state_file import Half, read_half, read_state
from evpinn_ros.vehicle.files import load_vehicle

MOST_MEMORY = 300.0  # MB of any process
MOST_SECONDS, SECONDS_A_MB = 10.0, 3.0  # of the processor; whichever is more
CHECKOUT = Path(__file__).parents[1]
RUNAWAY = 60  # s of the processor that end a reader
HANGING = 600.0  # s of the wall clock, for one that waits; on a busy machine a sound one waits too
GZIP, ZIP = b"\x1f\x8b", b"PK"
VEHICLE = load_vehicle("tesla_model_3_lr")
BULK = 2000  # numbers in a state of the writers, some 10 kB


@dataclass(slots=True)
class AttackResult:
    """Outcome of reading the damaged files of one format.

    Attributes:
        kind: the format.
        files: how many were tried.
        read: those that gave readings; the rest was refused in one line, or broke a promise.
        memory_mb: the largest memory of a process.
        slowest_s: the longest time of a processor.
        broken: promises that did not hold, a line each, with the number of the file.
    """

    kind: str
    files: int = 0
    read: int = 0
    memory_mb: float = 0.0
    slowest_s: float = 0.0
    broken: list[str] = field(default_factory=list)


def damaged(seed: bytes, chance: random.Random) -> bytes:
    """Bytes of a sound file after one to eight damages: flips, cuts, copies, zeros, numbers."""
    data = bytearray(seed)
    for _ in range(chance.choice((1, 1, 2, 4, 8))):
        if not data:
            break
        place = chance.randrange(len(data))
        length = min(chance.choice((1, 2, 4, 8, 64, 512)), len(data) - place)
        match chance.randrange(6):
            case 0:
                data[place] ^= 1 << chance.randrange(8)
            case 1:
                data[place : place + length] = chance.randbytes(length)
            case 2:
                del data[place : place + length]
            case 3:
                data[place:place] = data[place : place + length] * chance.choice((1, 3, 50))
            case 4:
                number = chance.choice((0, 0x7FFFFFFF, 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF))
                data[place : place + 8] = number.to_bytes(8, "little")
            case 5:
                del data[place:]
    return bytes(data)


def damaged_within(seed: bytes, chance: random.Random) -> bytes:
    """Bytes of a gzip or zip file that is damaged inside its packing: its checksums are right."""
    if seed.startswith(GZIP):
        return gzip.compress(damaged(gzip.decompress(seed), chance), mtime=0)
    with ZipFile(BytesIO(seed)) as whole:
        members = {name: whole.read(name) for name in whole.namelist()}
    name = chance.choice(sorted(members))
    members[name] = damaged(members[name], chance)
    with ZipFile(file := BytesIO(), "w", ZIP_DEFLATED) as whole:
        for name, content in members.items():
            whole.writestr(name, content)
    return file.getvalue()


def attack(kind: str, count: int, seed: int, kept: Path) -> AttackResult:
    """Read damaged files of a format.

    Args:
        kind: a name of `SEEDS`.
        count: how many.
        seed: another one gives other files.
        kept: folder for files that broke a promise.
    """
    result = AttackResult(kind)
    suffix, seeds = SEEDS[kind][0], _seeds(kind)
    with TemporaryDirectory() as folder:
        if suffix in BAG_SUFFIXES:  # what is kept for all bags is made before the fork
            _read(_written(Path(folder) / f"drive{suffix}", seeds[0]))
        for number in range(count):
            chance = random.Random(f"{kind} {seed} {number}")
            sound = chance.choice(seeds)
            within = sound.startswith((GZIP, ZIP)) and chance.random() < 0.5
            content = (damaged_within if within else damaged)(sound, chance)
            path = _written(Path(folder) / f"drive{suffix}", content)
            if broken := _try(path, result):
                kept.mkdir(parents=True, exist_ok=True)
                copy = kept / f"{kind}_{seed}_{number}{suffix}"
                copy.write_bytes(path.read_bytes())
                result.broken.append(f"{copy.name}: {broken}")
    return result


def _written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def _read(path: Path) -> None:
    for _ in open_source(path, VEHICLE, trust_profile=True).readings():
        pass


def _seeds(kind: str) -> list[bytes]:
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "benchmarks.attack_seeds", kind, folder]
        subprocess.run(command, check=True, cwd=CHECKOUT)
        return [path.read_bytes() for path in sorted(Path(folder).iterdir())]


def _try(path: Path, result: AttackResult) -> str | None:
    """Read one file, add it to the result, and tell the promise that it broke."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ours)
        _be_the_reader(path, theirs)
    os.close(theirs)
    hangs = not select.select([ours], [], [], HANGING)[0]
    if hangs:
        os.kill(child, signal.SIGKILL)
    with os.fdopen(ours, errors="replace") as pipe:
        answer = pipe.read()
    _, status, used = os.wait4(child, 0)
    seconds, memory = used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6
    result.files += 1
    result.read += answer == "read"
    result.memory_mb = max(result.memory_mb, memory)
    result.slowest_s = max(result.slowest_s, seconds)
    if hangs:
        return f"hangs for {HANGING:g} s"
    if status or answer not in ("read", "refused"):
        return answer or f"ended with status {status}"
    if memory > MOST_MEMORY:
        return f"takes {memory:.0f} MB"
    if seconds > max(MOST_SECONDS, SECONDS_A_MB * path.stat().st_size / 1e6):
        return f"takes {seconds:.1f} s"
    return None


class _Forked:
    """A parser of `common.apart` that is forked, not started; limits and end are its own."""

    def __init__(self, command: Sequence[str], **_: object) -> None:
        function, path, out = command[-3:]
        self._errors, theirs = os.pipe()
        self._process = os.fork()
        if self._process == 0:
            os.dup2(theirs, 2)
            apart.be_the_parser(function, Path(path), Path(out))
        os.close(theirs)
        self.returncode = 0

    def __enter__(self) -> _Forked:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._errors)

    def communicate(self, *, timeout: float) -> tuple[None, str]:
        """Its end and its errors; `subprocess.TimeoutExpired` if it hangs."""
        if not select.select([self._errors], [], [], timeout)[0]:
            raise subprocess.TimeoutExpired("parser", timeout)
        with os.fdopen(os.dup(self._errors), errors="replace") as pipe:
            errors = pipe.read()
        self.returncode = os.waitstatus_to_exitcode(os.waitpid(self._process, 0)[1])
        return None, errors

    def kill(self) -> None:
        """End it."""
        os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)


def _be_the_reader(path: Path, pipe: int) -> None:
    if path.suffix in SHEET_SUFFIXES:
        subprocess.Popen = _Forked  # type: ignore[assignment,misc]
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (RUNAWAY, RUNAWAY))
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 2)
    answer = "read"
    try:
        _read(path)
    except InputError as error:
        text = str(error)
        answer = "refused" if text.isprintable() and text else f"refused in no line: {text!r}"
    except BaseException:
        answer = traceback.format_exc()[-1500:]
    os.write(pipe, answer.encode(errors="replace"))
    os._exit(0)


@dataclass(frozen=True, slots=True)
class WritersResult:
    """Outcome of reading a state that two processes wrote.

    Attributes:
        reads: how often it was read.
        torn: reads of a file, or of a half, that is not whole.
        saves: how often it was saved, by both.
        lost: saves that failed or that the file does not hold at the end.
        left: names that lie beside the state at the end.
    """

    reads: int
    torn: int
    saves: int
    lost: int
    left: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """True if nothing was torn, lost or left."""
        return not (self.torn or self.lost or self.left)


WRITER = f"""
import sys
from pathlib import Path
from evpinn_ros.estimation.state_file import Half, write_halves
half, number, lost = Half(sys.argv[2]), 0, 0
print("begun", flush=True)
while not Path(sys.argv[3]).exists():
    number += 1
    try:
        write_halves(Path(sys.argv[1]), {{half: {{"number": number, "bulk": [number] * {BULK}}}}})
    except Exception:
        lost += 1
print(number, lost)
"""


def two_writers(reads: int) -> WritersResult:
    """Read a state while two processes write its halves, each its own."""
    with TemporaryDirectory() as folder:
        path, stop = Path(folder) / "car.json", Path(folder) / "stop"
        command = [sys.executable, "-c", WRITER, str(path)]
        with contextlib.ExitStack() as stack:
            writers = [
                stack.enter_context(
                    subprocess.Popen(
                        [*command, half.value, str(stop)], stdout=subprocess.PIPE, text=True
                    )
                )
                for half in Half
            ]
            try:
                for writer in writers:
                    writer.stdout.readline()  # type: ignore[union-attr]
                while not path.exists():
                    time.sleep(0.01)
                torn = sum(not _is_whole(path) for _ in range(reads))
            finally:
                stop.touch()
            ends = [tuple(map(int, writer.communicate()[0].split())) for writer in writers]
        stop.unlink()
        lost = sum(failed for _, failed in ends)
        for half, (number, _) in zip(Half, ends, strict=True):
            kept = read_half(path, half)[0]
            lost += kept is None or kept["number"] != number
        left = tuple(sorted(each.name for each in path.parent.iterdir() if each != path))
    return WritersResult(reads, torn, sum(number for number, _ in ends), lost, left)


def _is_whole(path: Path) -> bool:
    try:
        state = read_state(path)
    except InputError:
        return False
    halves = (state or {}).values()
    return bool(halves) and all(set(half["bulk"]) == {half["number"]} for half in halves)


def attack_all(kinds: Sequence[str], count: int, seed: int, kept: Path) -> Iterator[AttackResult]:
    """Results of each format in turn."""
    for kind in kinds:
        yield attack(kind, count, seed, kept)
