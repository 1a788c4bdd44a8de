"""Distance, and what a kilometre costs: over the last 1, 10 and 100 km."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import math
from typing import Any, NamedTuple

from evpinn_ros.common.errors import InputError
from evpinn_ros.energy.plausible import MOST_DISTANCE, MOST_ENERGY
from evpinn_ros.energy.quadrature import MAX_GAP, CompensatedSum, EnergyIntegral
from evpinn_ros.energy.saved import number, numbers, section
from evpinn_ros.signals.stream import MAX_SPEED

WINDOWS = (1e3, 1e4, 1e5)  # m
BUCKETS = 20  # of a window


class Stretch(NamedTuple):
    """Distance driven, m, and the energy that it took, J."""

    distance: float
    energy: float


class DistanceWindow:
    """Energy over the last so many metres, in a bounded number of buckets.

    It holds whole buckets of a 20th of its length and the one being filled. So it spans up to a
    20th more than its length, and energy over distance is exact for what it spans.
    """

    def __init__(self, length: float) -> None:
        """An empty window of this length, m."""
        self.length = length
        self._full: deque[Stretch] = deque()
        self._distance, self._energy = CompensatedSum(), CompensatedSum()

    @property
    def whole(self) -> tuple[Stretch, ...]:
        """The buckets that are full, oldest first."""
        return tuple(self._full)

    @property
    def known(self) -> bool:
        """True if the whole length has been driven."""
        return self.total.distance >= self.length

    @property
    def total(self) -> Stretch:
        """Sum of its whole span."""
        buckets = (*self._full, Stretch(self._distance.value, self._energy.value))
        return Stretch(*(math.fsum(column) for column in zip(*buckets, strict=True)))

    def add(self, stretch: Stretch) -> None:
        """Take what was driven since the last."""
        self._distance.add(stretch.distance)
        self._energy.add(stretch.energy)
        if self._distance.value < self.length / BUCKETS:
            return
        self._full.append(Stretch(self._distance.value, self._energy.value))
        self._distance, self._energy = CompensatedSum(), CompensatedSum()
        while self.total.distance - self._full[0].distance >= self.length:
            self._full.popleft()

    def exported(self) -> list[list[float]]:
        """All buckets, the one being filled last."""
        return [list(each) for each in (*self._full, (self._distance.value, self._energy.value))]

    def restore(self, saved: Any) -> None:
        """Continue from what `exported` gave.

        Raises:
            InputError: it is something else; nothing is changed then.
        """
        if not isinstance(saved, list) or not 0 < len(saved) <= BUCKETS + 1:
            raise InputError(f"saved energy: no window of {self.length:g} m")
        most = [MOST_DISTANCE, MOST_ENERGY]
        *full, last = (Stretch(*numbers({"window": each}, "window", most)) for each in saved)
        least = self.length / BUCKETS
        if not (0 <= last.distance < least and all(each.distance >= least for each in full)):
            raise InputError(f"saved energy: window of {self.length:g} m: out of range")
        self._full = deque(full)
        self._distance, self._energy = CompensatedSum(last.distance), CompensatedSum(last.energy)


class TripLog:
    """Joins speed and energy to consumption by distance.

    Energy that was taken while speed was silent has no distance: it is in no stretch.

    Attributes:
        windows: over the last 1, 10 and 100 km; a reset of the trip leaves them.
    """

    def __init__(self, max_gap: float = MAX_GAP) -> None:
        """Nothing driven yet; across more than `max_gap`, s, speed is not joined."""
        self._max_gap = max_gap
        self.windows = tuple(DistanceWindow(length) for length in WINDOWS)
        self._energy = CompensatedSum()
        self._begin(EnergyIntegral(max_gap))

    def _begin(self, speed: EnergyIntegral) -> None:
        self._speed = speed
        self._energy_before: float | None = None

    @property
    def total(self) -> Stretch:
        """Since the last reset."""
        return Stretch(self._speed.drawn, self._energy.value)

    @property
    def unknown_s(self) -> float:
        """Time across which speed was silent, s."""
        return self._speed.gap_s

    def update(self, stamp_ns: int, speed: float, energy: float) -> None:
        """Take a speed, m/s, and the net energy since whenever, J, at that moment."""
        dropped = self._speed.dropped
        # The integral of speed is distance: one way to deal with gaps and doubled stamps.
        step = self._speed.append(stamp_ns, abs(speed))
        if self._speed.dropped > dropped:
            return
        if step is not None and self._energy_before is not None:
            stretch = Stretch(step.energy, energy - self._energy_before)
            self._energy.add(stretch.energy)
            for window in self.windows:
                window.add(stretch)
        self._energy_before = energy

    def correct(self, energy: float) -> None:
        """Add energy, J, that turned out later to belong to the trip."""
        self._energy.add(energy)

    def reset_trip(self) -> None:
        """Count the trip from zero."""
        self._energy = CompensatedSum()
        self._begin(EnergyIntegral(self._max_gap))

    def begin_anew(self) -> None:
        """Join nothing to the speed before: time jumped."""
        before, speed = self._speed.exported(), EnergyIntegral(self._max_gap)
        speed.restore(before, MAX_SPEED)
        self._begin(speed)

    def exported(self) -> dict[str, Any]:
        """Everything `restore` needs."""
        return {
            "speed": self._speed.exported(),
            "energy": self._energy.value,
            "windows": [window.exported() for window in self.windows],
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from what `exported` gave.

        Raises:
            InputError: something is missing or wrong; nothing is changed then.
        """
        rows, energy = saved.get("windows"), number(saved, "energy", most=MOST_ENERGY)
        if not isinstance(rows, list) or len(rows) != len(WINDOWS):
            raise InputError("saved energy: 'windows' are missing")
        integral = EnergyIntegral(self._max_gap)
        integral.restore(section(saved, "speed"), MAX_SPEED)
        windows = tuple(DistanceWindow(length) for length in WINDOWS)
        for window, row in zip(windows, rows, strict=True):
            window.restore(row)
        self.windows, self._energy = windows, CompensatedSum(energy)
        self._begin(integral)
