"""Battery power at the moments of the samples, interpolated between readings."""

from __future__ import annotations

from bisect import bisect_left

from evpinn_ros.signals.readings import NANOSECONDS

TRACK_LENGTH = 10.0  # s of power kept


class PowerTrack:
    """The last seconds of battery power in order of stamps."""

    def __init__(self, max_gap: float) -> None:
        """Never interpolate between readings further apart than max_gap, s."""
        self._max_gap_ns = int(max_gap * NANOSECONDS)
        self._stamps: list[int] = []
        self._powers: list[float] = []

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest reading, None before the first."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp_ns: int, power: float) -> bool:
        """Insert one power, W, in order; False when this stamp is already there."""
        index = bisect_left(self._stamps, stamp_ns)
        if index < len(self._stamps) and self._stamps[index] == stamp_ns:
            return False
        self._stamps.insert(index, stamp_ns)
        self._powers.insert(index, power)
        surplus = bisect_left(self._stamps, self._stamps[-1] - int(TRACK_LENGTH * NANOSECONDS))
        del self._stamps[:surplus], self._powers[:surplus]
        return True

    def next_ns(self, stamp_ns: int) -> int | None:
        """Stamp of the first reading at a moment or after it, None while there is none."""
        index = bisect_left(self._stamps, stamp_ns)
        return self._stamps[index] if index < len(self._stamps) else None

    def at(self, stamp_ns: int) -> float | None:
        """Power, W, at a moment, linear between its neighbours; None where it was not measured."""
        index = bisect_left(self._stamps, stamp_ns)
        if index == len(self._stamps):
            return None
        if self._stamps[index] == stamp_ns:
            return self._powers[index]
        if index == 0 or self._stamps[index] - self._stamps[index - 1] > self._max_gap_ns:
            return None
        before, after = self._stamps[index - 1], self._stamps[index]
        share = (stamp_ns - before) / (after - before)
        return self._powers[index - 1] + share * (self._powers[index] - self._powers[index - 1])
