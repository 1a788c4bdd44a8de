"""A recorded drive of any kind as a stream of readings in blocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.logs.column import Column

STRAGGLING_NS = 10 * NANOSECONDS  # largest lateness of readings; further back, time restarted


class Source(ABC):
    """A recorded drive, opened: its readings, and reports on unused data."""

    rules: tuple[Column, ...] = ()  # columns of a table that are used, in the order of the file
    ignored: Mapping[str, str] = MappingProxyType({})  # other columns, each with the reason
    dated: str | None = None  # source of a table's day: `log`, `name` of the file, "" for none
    zoned = True  # True if the clock is UTC or names its zone
    in_order = True  # False if rows of a table were sorted by time
    stops_s = 0.0  # s of stops between first and last reading that are not part of the drive

    def __init__(self, path: Path, log: Source | None = None) -> None:
        """Count no drops yet; a part of `log` has its columns and clock."""
        self.path = path  # of the file or folder
        self.dropped: Counter[str] = Counter()  # by reason; complete at the end
        self._ahead: deque[Block] | None = None
        if log is not None:
            self.rules, self.ignored, self.in_order = log.rules, log.ignored, log.in_order
            self.dated, self.zoned = log.dated, log.zoned

    @property
    @abstractmethod
    def seconds(self) -> float | None:
        """Length of the drive, s; None if only reading it shows that."""

    @property
    @abstractmethod
    def problem(self) -> str | None:
        """Unreadable part, in one line; None without one. Final once exhausted."""

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumed units and signs, each with the option that changes it."""
        return tuple(filter(None, (rule.assumption for rule in self.rules)))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for a person on how the drive was read; complete once exhausted."""
        return ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences on why totals are uncertain; complete once exhausted."""
        return ()

    @abstractmethod
    def read(self) -> Iterator[Block]:
        """Read the drive, as `blocks`; blocks may be empty."""

    def read_ahead(self) -> Sequence[Block]:
        """Read all blocks; the next call of `blocks` yields these and frees each after use."""
        self._ahead = deque(self.blocks())
        return self._ahead

    def blocks(self) -> Iterator[Block]:
        """Blocks of readings in recorded order, up to any damage; InputError if none."""
        if self._ahead is None:
            yield from filter(len, self.read())
            return
        ahead, self._ahead = self._ahead, None
        while ahead:
            yield ahead.popleft()

    def readings(self) -> Iterator[Reading]:
        """The same readings one by one."""
        for block in self.blocks():
            yield from block.readings()
