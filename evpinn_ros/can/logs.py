"""CAN logs: candump .log, Vector .asc and .blf, PEAK .trc, .csv of two kinds; also gzipped.

Damaged .mf4 can crash asammdf (extra `mf4`), and python-can trusts every length in a damaged .blf:
both are read in a process of their own. The .csv of SavvyCAN and GVRET has a reader here, with a
hexadecimal frame per row: `Time Stamp,ID,Extended,Dir,Bus,LEN,D1,...,D8`, in microseconds; version
1 has no `Dir`.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
import csv
from datetime import datetime
from functools import partial
import io
from itertools import pairwise
import logging
from pathlib import Path
import re
from tempfile import TemporaryDirectory
from typing import IO, Any

import can
from can.io import mf4

from evpinn_ros.can.frame import CanFrame, FirstBus, nanoseconds
from evpinn_ros.can.log_names import GVRET_HEADER, LOG_SUFFIXES, MF4
from evpinn_ros.common.errors import InputError, as_input_error, one_line
from evpinn_ros.common.months import MONTHS
from evpinn_ros.common.opener import LONGEST_LINE, open_file, open_unpacked
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.sandbox import run_apart
from evpinn_ros.common.writer import new_table, replaced
from evpinn_ros.core.signals.readings import NANOSECONDS

SAME_MOMENT = 60.0  # s between a log's date and its first time of day
# s: if the first time of a log is later, it does not count from the date
LATEST_FIRST = 3600.0
EPOCH = 1e6  # s: larger times are absolute, not relative to the line before
LOOKED_AT = 200  # lines that are examined
GOES_BACK = 0.3  # share of the steps between lines

_DATE = re.compile(
    r"(?:date|begin\s+triggerblock)\s+\w+\.?\s+(\w+)\.?\s+(\d+)\s+"
    r"(\d+):(\d+):(\d+(?:\.\d+)?)(?:\s*([ap]m))?\s+(\d{4})",
    re.IGNORECASE,
)
_TIME = re.compile(r"\s*(-?\d+\.\d+)(\s.*)", re.DOTALL)
_FRAME = re.compile(r"\s+(\d+\s+(\w+\s+(Tx|Rx)|ErrorFrame)|CANFD)", re.ASCII | re.IGNORECASE)
_STAMP = re.compile(r"\s*\((\d+\.\d+)\)(.*)", re.DOTALL)


def _date(match: re.Match[str]) -> datetime | None:
    month, day, hour, minute, second, half, year = match.groups()
    number = MONTHS.get(month.lower()[:4]) or MONTHS.get(month.lower()[:3])
    if number is None:
        return None
    hours = int(hour) % 12 + (12 if half.lower() == "pm" else 0) if half else int(hour)
    text = f"{year}-{number:02d}-{int(day):02d} {hours:02d}:{minute}:{float(second):09.6f}"
    try:
        return datetime.strptime(text, "%Y-%m-%d %H:%M:%S.%f")
    except ValueError:
        return None


def _base(start: datetime | None, first: float) -> float:
    """Offset of the times of a log, s, given its start and its first time."""
    if start is None:
        return max(0.0, -first)
    midnight = start.replace(hour=0, minute=0, second=0, microsecond=0)
    if abs(first - (start - midnight).total_seconds()) < SAME_MOMENT:
        return midnight.timestamp()
    return start.timestamp() - (first if first > LATEST_FIRST else 0.0)


FORMATS = (
    "supported are candump -L (.log), Vector .asc and .blf, PEAK .trc, .csv of SavvyCAN and "
    "python-can, ASAM .mf4; a table of a drive is a .csv, .tsv or .txt"
)
LAST_ID, LAST_EXTENDED_ID, LONGEST_DATA = 0x7FF, 0x1FFFFFFF, 64
LAST_TIME = 2.0**33  # s since 1970: the year 2242
END = 64 << 10  # bytes at each end of a log that show its length
MICROSECOND = 1e-6
COUNTER = 2**32  # microseconds after which counters of some adapters wrap
APART = {MF4: "convert_mf4", ".blf": "convert_blf"}  # functions that run in another process
NO_FRAME = 1 << 30  # no valid id, so it is counted when the converted log is read

# They would print every line of a damaged log to the terminal.
logging.getLogger("can.io").setLevel(logging.CRITICAL)


class LogFile:
    """A CAN log, read once by `frames()`; the attributes are complete after that."""

    def __init__(self, path: str | Path, channel: str | None = None) -> None:
        """Detect the format, or raise InputError; `channel` selects one of several buses."""
        self.path = Path(path)  # of the log
        self.count = 0  # frames read so far
        # unread frames by kind: `error_frame`, `remote_frame`, `impossible_frame`, one of a
        # damaged log that no bus can carry, and `other_bus` (see `FirstBus`)
        self.skipped: Counter[str] = Counter()
        self.problem: str | None = None  # why reading stopped early
        self.notes: tuple[str, ...] = ()  # a log has no files beside it
        self._first_bus = FirstBus(channel)
        suffixes = [suffix.lower() for suffix in self.path.suffixes]
        self._gzipped = suffixes[-1:] == [".gz"]
        self._suffix = "".join(suffixes[:-1][-1:] if self._gzipped else suffixes[-1:])
        if self._suffix not in LOG_SUFFIXES:
            known = ", ".join(LOG_SUFFIXES)
            raise InputError(f"{self.path}: not a CAN log; known are {known}, also as .gz")
        if self._suffix == MF4:
            with optional_imports():
                import asammdf  # noqa: F401
        with as_input_error(self.path):
            empty = self.path.stat().st_size == 0
        if empty:
            raise InputError(f"{self.path}: the file is empty")

    @property
    def seconds(self) -> float | None:
        """Time between the frames at both ends of the file, s; None if unknown."""
        if self._gzipped or self._suffix == MF4:
            return None
        ends = LogFile(self.path)  # a second reader: `skipped` of this one stays unchanged
        try:
            with open_file(self.path) as file:
                if self._suffix == ".blf":
                    reader = can.BLFReader(file)
                    seconds = reader.stop_timestamp - reader.start_timestamp
                else:
                    lines = _Lines(_ends(file), self._suffix)
                    frames = list(ends._read(lines, self._suffix))
                    if lines.summed:  # sums of intervals need every line
                        return None
                    seconds = (frames[-1].stamp_ns - frames[0].stamp_ns) / NANOSECONDS
        except Exception:  # third-party readers fail in any way; `frames` reports why
            return None
        return seconds if seconds > 0.0 else None

    def frames(self) -> Iterator[CanFrame]:
        """Every data frame up to the end or the first damage; InputError if there is none."""
        failed, suffix = None, self._suffix
        with as_input_error(self.path):
            if suffix in APART:
                file, failed, suffix = *self._converted(), ".log"
            else:
                file = open_unpacked(self.path)
        for frame in self._until_broken(file, suffix):
            self.count += 1
            yield frame
        if failed:
            self.problem = f"{self.path}: broken after {self.count} frames: {failed}"
        if self.count == 0:
            nothing = self._first_bus.missing or "no CAN frame in it"
            raise InputError(self.problem or f"{self.path}: {nothing}")

    def _until_broken(self, packed: IO[bytes], suffix: str) -> Iterator[CanFrame]:
        with io.TextIOWrapper(packed, encoding="utf-8", errors="replace") as file:
            lines = _Lines(file, suffix)
            # Third-party readers raise anything for a damaged file, and it means that the log ends
            # here. The consumer of the frames runs outside of the try.
            try:
                yield from self._read(lines, suffix)
            except InputError:  # frames of two cars
                raise
            except Exception as error:
                place = f"{self.path}:{lines.number}"
                self.problem = f"{place}: broken after {self.count} frames: {one_line(error)}"
                if self.count == 0 and lines.line:
                    self.problem = (
                        f"{place}: {lines.line[:40]!r} is no line of a CAN log; {FORMATS}"
                    )

    def _converted(self) -> tuple[IO[bytes], str | None]:
        """Candump log converted by another process, and why it ends early, or None."""
        with TemporaryDirectory() as folder:
            path = Path(folder) / "converted.log"
            failed = run_apart(f"{__name__}:{APART[self._suffix]}", self.path, path)
            # An open file stays readable after its folder is deleted.
            return open_file(path) if path.exists() else io.BytesIO(), failed

    def _read(self, lines: _Lines, suffix: str) -> Iterator[CanFrame]:
        for message in _READERS[suffix](lines):
            if message.is_error_frame:
                self.skipped["error_frame"] += 1
            elif message.is_remote_frame:
                self.skipped["remote_frame"] += 1
            elif not _is_possible(message):
                self.skipped["impossible_frame"] += 1
            elif not self._first_bus.takes(
                (message.arbitration_id, message.is_extended_id), message.channel, message.data
            ):
                self.skipped["other_bus"] += 1
                if cars := self._first_bus.cars:
                    raise InputError(f"{self.path}: {cars}")
            else:
                yield CanFrame.of(message, nanoseconds(message.timestamp))
        # These readers accept a truncated file; gzip detects it by itself.
        if lines.cut_off:
            self.problem = f"{self.path}: cut off after {self.count} frames"


def _ends(file: IO[bytes]) -> io.StringIO:
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    text = file.read(2 * END)
    if size > len(text):
        text = text[: text.rfind(b"\n", 0, END) + 1]
        file.seek(size - END)
        file.readline()
        text += file.read()
    return io.StringIO(text.decode("utf-8", errors="replace"), newline=None)


def _is_possible(message: Any) -> bool:
    """True if id and data fit into a frame; the readers accept any number."""
    last_id = LAST_EXTENDED_ID if message.is_extended_id else LAST_ID
    possible = 0 <= message.arbitration_id <= last_id and len(message.data) <= LONGEST_DATA
    return possible and abs(message.timestamp) < LAST_TIME


def _csv_reader(lines: _Lines) -> Any:
    is_gvret = lines.peek(1)[0].startswith(GVRET_HEADER)
    return gvret_messages(lines) if is_gvret else can.CSVReader(lines)


class _Lines:
    """Complete lines of a text file; times of .asc and .log are made continuous.

    A last line without a line end is dropped as truncated.
    """

    def __init__(self, file: IO[str], suffix: str) -> None:
        self.number, self.cut_off, self.line = 0, False, ""
        self.summed = False  # True if times are relative to the line before
        self.read, self.close = file.read, file.close
        self._readline = partial(file.readline, LONGEST_LINE + 1)
        self._peeked: deque[str] = deque()
        self._timed = {".asc": self._asc, ".log": self._candump}.get(suffix, self._whole)()

    def peek(self, count: int) -> list[str]:
        """The next lines without consuming them, fewer if long; empty at the end."""
        while len(self._peeked) < count and sum(map(len, self._peeked)) <= LONGEST_LINE:
            self._peeked.append(self._readline())
        return [line.lstrip("\ufeff") for line in self._peeked]

    def __iter__(self) -> Iterator[str]:
        return self._timed

    def __next__(self) -> str:  # python-can reads headers by next()
        return next(self._timed)

    def _whole(self) -> Iterator[str]:
        while line := self._peeked.popleft() if self._peeked else self._readline():
            if len(line) > LONGEST_LINE:
                raise ValueError(f"a line is longer than {LONGEST_LINE} characters")
            self.number, self.line = self.number + 1, line
            self.cut_off = not line.endswith("\n")
            if self.cut_off:
                return
            yield line

    def _asc(self) -> Iterator[str]:
        """Lines with times since 1970 if the date is known."""
        start: datetime | None = None
        base: float | None = None
        passed = 0.0
        for line in self._whole():
            if match := _DATE.match(line.strip()):
                start, base = _date(match), None
            elif line.lower().startswith("base"):
                self.summed = "relative" in line.lower()
            if not (match := _TIME.fullmatch(line)):
                yield line
                continue
            passed = float(match[1]) + (passed if self.summed else 0.0)
            if base is None and _FRAME.match(match[2]):
                base = _base(start, passed)
            if base is not None:
                yield f"{base + passed:.9f}{match[2]}"

    def _candump(self) -> Iterator[str]:
        """Lines with times since 1970 or since the first line."""
        ahead = self.peek(LOOKED_AT)
        stamps = [float(stamp[1]) for line in ahead if (stamp := _STAMP.fullmatch(line))]
        back = sum(later < earlier for earlier, later in pairwise(stamps))
        self.summed = back > GOES_BACK * len(stamps) and max(stamps) < EPOCH
        passed = 0.0
        for line in self._whole():
            stamp = _STAMP.fullmatch(line) if self.summed else None
            if stamp is None:
                yield line
                continue
            passed += float(stamp[1])
            yield f"({passed:.6f}){stamp[2]}"


def convert_mf4(path: Path, out: Path) -> None:
    """Write the frames of an .mf4 as a candump log, up to the first damage."""
    with open_file(path) as file:
        _convert(mf4.MF4Reader(file), out)


def convert_blf(path: Path, out: Path) -> None:
    """Write the frames of a .blf as a candump log, up to the first damage."""
    with open_unpacked(path) as file:
        reader = can.BLFReader(file)
        _convert(reader, out)
        if path.suffix.lower() != ".gz" and reader.file_size > path.stat().st_size:
            raise ValueError("cut off")  # the reader does not notice this; gzip does


def _convert(messages: Iterable[Any], out: Path) -> None:
    # Line buffered: frames before the damage are kept if this process is killed.
    with (
        new_table(out, by_line=True) as lines,
        can.CanutilsLogWriter(lines) as log,
    ):
        for message in messages:
            if not _is_possible(message):
                message.arbitration_id, message.is_extended_id = NO_FRAME, True
            log.on_message_received(message)


def write_log(path: str | Path, frames: Iterable[CanFrame]) -> int:
    """Write frames as a candump log (`candump -L`), in microseconds; returns their number."""
    count = 0
    with as_input_error(path), replaced(Path(path)) as draft:
        for frame in frames:
            draft.write(_candump_line(frame).encode("ascii"))
            count += 1
    return count


def _candump_line(frame: CanFrame) -> str:
    seconds, rest = divmod(round(frame.stamp_ns / 1000), 1_000_000)
    can_id = f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"
    # Two marks and a digit of flags denote CAN FD, the only frames longer than 8 bytes.
    mark = "##0" if len(frame.data) > 8 else "#"
    return f"({seconds}.{rest:06d}) can0 {can_id}{mark}{frame.data.hex().upper()}\n"


def gvret_messages(lines: Iterable[str]) -> Iterator[can.Message]:
    """The frames of SavvyCAN's CSV with its header; ValueError for an invalid row."""
    reader = csv.reader(lines)
    names = [name.strip("\ufeff ") for name in next(reader)]
    first = names.index("LEN") + 1
    before, added = 0, 0
    for row in filter(any, reader):
        cells = dict(zip(names, row, strict=False))
        length = int(cells["LEN"])
        data = bytes(int(cell, 16) for cell in row[first : first + length])
        if len(data) < length:
            raise ValueError(f"{len(data)} of {length} bytes")
        micros = int(cells["Time Stamp"])
        if before == 0 and micros < 0:  # the counter overflowed: the time has no date
            added = -micros
        elif 0 <= micros < before - COUNTER // 2 and before < COUNTER:
            added += COUNTER
        before = micros
        yield can.Message(
            timestamp=(micros + added) * MICROSECOND,
            arbitration_id=int(cells["ID"], 16),
            is_extended_id=cells["Extended"].strip().lower() in ("true", "1"),
            is_rx=cells.get("Dir", "").strip().lower() != "tx",
            channel=cells.get("Bus"),
            dlc=length,
            data=data,
            is_fd=length > 8,
        )


_READERS: dict[str, Callable[..., Any]] = {
    ".log": can.CanutilsLogReader,
    ".asc": can.ASCReader,
    ".trc": can.TRCReader,
    ".csv": _csv_reader,
}
