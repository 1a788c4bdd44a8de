"""A recorded drive in memory."""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import Reading
from evpinn_ros.logs.source import Source


class Recorded(Source):
    """Readings as a source, with counts of those that were dropped on reading."""

    problem = seconds = None

    def __init__(
        self, readings: Iterable[Reading], path: Path = Path("drive"), **dropped: int
    ) -> None:
        super().__init__(path)
        self._readings = list(readings)
        self.dropped = Counter(dropped)

    def read(self) -> Iterator[Block]:
        yield Block.of(self._readings)
