"""One frame of a CAN bus, whatever adapter or log it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

MOST_IDS = 4096
"""Ids of a bus that are followed: twice what 11 bits can tell. Garbage of 29 bits has millions."""

BusId = tuple[int, bool]
"""An id, and whether it has 29 bits."""

EPOCH_S = 1e9
"""Times above this count from 1970, times below it from the start of a log or an adapter."""


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A data frame."""

    stamp_ns: int  # when it was received, ns
    can_id: int  # identifier, 11 bits, or 29 when `extended`
    data: bytes  # 0 to 64 bytes
    extended: bool = False  # whether the identifier has 29 bits

    @property
    def key(self) -> BusId:
        """The identifier, and whether it has 29 bits."""
        return self.can_id, self.extended

    @classmethod
    def of(cls, message: Any, stamp_ns: int) -> CanFrame:
        """The frame in a message of python-can or isotp."""
        data, extended = bytes(message.data), message.is_extended_id
        return cls(stamp_ns, message.arbitration_id, data, extended)


class FirstBus:
    """Takes each id of a recording of several buses from the one that showed it first.

    On another bus the id may mean something else, and two streams of one id make one of nonsense.
    """

    def __init__(self) -> None:
        self._buses: dict[BusId, Any] = {}

    def takes(self, key: BusId, bus: Any) -> bool:
        """True if a frame of this bus, by whatever name the recording gives it, is to be read.

        With more than `MOST_IDS` ids the log is garbage; what comes then is taken.
        """
        if key not in self._buses and len(self._buses) < MOST_IDS:
            self._buses[key] = bus
        return bool(self._buses.get(key, bus) == bus)


def nanoseconds(seconds: float) -> int:
    """The stamp of a time in seconds, ns.

    A float that holds an epoch is 240 ns coarse: it is rounded to the microsecond, which gives
    back the digits that the log or the kernel wrote. Shorter times keep their nanoseconds.
    """
    if abs(seconds) > EPOCH_S:
        return round(seconds * 1e6) * 1000
    return round(seconds * 1e9)
