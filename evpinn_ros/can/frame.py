"""One frame of a CAN bus, whatever adapter or log it came from."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from typing import Any, TypeAlias

from evpinn_ros.core.signals.readings import NANOSECONDS

MOST_IDS = 4096
"""Ids of a bus that are followed: twice the 11-bit ids. Garbage of 29 bits has millions."""

BusId = tuple[int, bool]
"""An id, and whether it has 29 bits."""

RECENT = 3  # frames of an id that are compared with another bus
JUDGED = 100  # frames of an id on another bus, enough to compare
LEAST_SHARED = 2  # ids with different data that mean two cars

EPOCH_S = 1e9
"""Times above this count from 1970; smaller ones from the start of a log or an adapter."""


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A data frame of classical CAN or CAN FD, with its time of arrival."""

    stamp_ns: int  # when it was received
    can_id: int  # identifier, 11 bits, or 29 when `extended`
    data: bytes  # 0 to 64 bytes
    extended: bool = False  # True if the identifier has 29 bits

    @property
    def key(self) -> BusId:
        """The identifier, and True if it has 29 bits."""
        return self.can_id, self.extended

    @classmethod
    def of(cls, message: Any, stamp_ns: int) -> CanFrame:
        """The frame in a message of python-can or isotp."""
        data, extended = bytes(message.data), message.is_extended_id
        return cls(stamp_ns, message.arbitration_id, data, extended)

    @classmethod
    def of_ros(cls, message: Any, arrived_ns: int) -> CanFrame:
        """The data frame in a `can_msgs/Frame`, stamped at its arrival if it has no stamp."""
        stamp = message.header.stamp
        return cls(
            stamp.sec * NANOSECONDS + stamp.nanosec or arrived_ns,
            int(message.id),
            bytes(message.data[: message.dlc]),
            bool(message.is_extended),
        )


RawFrames: TypeAlias = deque[tuple[int, CanFrame]]
"""Frames queued from a bridge to a recorder, with their arrival, ns."""


class FirstBus:
    """Reads each id from the first bus that sent it: other buses may use it for other data."""

    def __init__(self, only: str | None = None) -> None:
        self._only = only
        self._buses: dict[BusId, Any] = {}
        self._data: dict[BusId, deque[bytes]] = {}  # newest data of ids that other buses have too
        self._others: dict[BusId, list[int]] = {}  # frames on another bus; those with other data
        self._seen: Counter[Any] = Counter()  # ids first sent by each bus
        self.cars = ""  # evidence of two cars, else empty

    def takes(self, key: BusId, bus: Any, data: bytes = b"") -> bool:
        """True if a frame of this bus is to be read, as is any id beyond `MOST_IDS`."""
        if self._only is not None:
            self._seen[bus] += 1
            return str(bus) == self._only
        if key not in self._buses and len(self._buses) < MOST_IDS:
            self._buses[key] = bus
            self._seen[bus] += 1
        first = self._buses.get(key, bus)
        if first == bus:
            if key in self._data:
                self._data[key].append(bytes(data))
            return True
        self._compare(key, first, bus, bytes(data))
        return False

    @property
    def missing(self) -> str:
        """Message if the requested bus does not exist, else empty."""
        if self._only is None or self._only in map(str, self._seen):
            return ""
        return f"no frame of the bus {self._only!r}; there are {', '.join(map(str, self._seen))}"

    def _compare(self, key: BusId, first: Any, bus: Any, data: bytes) -> None:
        """Check whether another bus with the same id repeats the data of the first."""
        counts = self._others.setdefault(key, [0, 0])
        recent = self._data.setdefault(key, deque(maxlen=RECENT))
        counts[0] += bool(recent)
        counts[1] += bool(recent) and data not in recent
        if counts[0] % JUDGED or not counts[0]:
            return
        judged = [(both, other) for both, other in self._others.values() if both >= JUDGED]
        differ = sum(other > 0.5 * both for both, other in judged)
        if len(judged) >= LEAST_SHARED and 2 * differ > max(self._seen[first], 2 * LEAST_SHARED):
            self.cars = (
                f"buses {first} and {bus} send different data under the same {differ} ids, as two "
                f"cars do; say --car {first} or --car {bus}"
            )


def nanoseconds(seconds: float) -> int:
    """A time, s, in ns, rounded to 1 us: floats of epoch seconds resolve only 240 ns."""
    if abs(seconds) > EPOCH_S:
        return round(seconds * 1e6) * 1000
    return round(seconds * 1e9)
