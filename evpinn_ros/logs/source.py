"""A recorded drive of any kind, as one stream of readings in blocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.logs.column import Column

STRAGGLING_NS = 10 * NANOSECONDS  # by which readings may be late; further back time began anew


class Source(ABC):
    """A recorded drive, opened: its readings and what of it was not used."""

    rules: tuple[Column, ...] = ()  # columns of a table that are used, in the order of the file
    ignored: Mapping[str, str] = MappingProxyType({})  # other columns, each with the reason
    dated: str | None = None  # tells a table's day: `log`, `name` of the file, "" for nothing
    zoned = True  # the clock is UTC or names its zone
    in_order = True  # False: rows of a table were sorted by time
    stops_s = 0.0  # s between its first and last reading that are no part of the drive

    def __init__(self, path: Path, log: Source | None = None) -> None:
        """Nothing was dropped yet; columns and clock are those of the log that it is made of."""
        self.path = path  # where it lies
        self.dropped: Counter[str] = Counter()  # by reason, complete at the end
        self._ahead: deque[Block] | None = None
        if log is not None:
            self.rules, self.ignored, self.in_order = log.rules, log.ignored, log.in_order
            self.dated, self.zoned = log.dated, log.zoned

    @property
    @abstractmethod
    def seconds(self) -> float | None:
        """Length of the drive, s; None where only reading it tells."""

    @property
    @abstractmethod
    def problem(self) -> str | None:
        """Unreadable part, in one line; None while all is well, final when exhausted."""

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Units and signs that the data do not decide, each with the option to say otherwise."""
        return tuple(filter(None, (rule.assumption for rule in self.rules)))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for a person on how it was read; complete once exhausted."""
        return ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences on why its totals are not certain; complete once exhausted."""
        return ()

    @abstractmethod
    def read(self) -> Iterator[Block]:
        """Read the drive: `blocks`, some of which may be without a reading."""

    def read_ahead(self) -> Sequence[Block]:
        """Read the whole drive; the next `blocks` are these, each forgotten once it is given."""
        self._ahead = deque(self.blocks())
        return self._ahead

    def blocks(self) -> Iterator[Block]:
        """Readings in recorded order, in blocks, as far as readable; InputError if none."""
        if self._ahead is None:
            yield from filter(len, self.read())
            return
        ahead, self._ahead = self._ahead, None
        while ahead:
            yield ahead.popleft()

    def readings(self) -> Iterator[Reading]:
        """The same one by one."""
        for block in self.blocks():
            yield from block.readings()
