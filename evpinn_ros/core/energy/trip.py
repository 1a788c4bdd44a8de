"""Distance and consumption over the last 1, 10 and 100 km."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Saveable
from evpinn_ros.core.energy.plausible import Joules, Metres
from evpinn_ros.core.energy.quadrature import MAX_GAP, EnergyIntegral, SavedIntegral
from evpinn_ros.core.signals.readings import MAX_SPEED

WINDOWS = (1e3, 1e4, 1e5)  # m
BUCKETS = 20  # of a window


class Stretch(NamedTuple):
    """Distance driven, m, and the energy that it took, J."""

    distance: Metres
    energy: Joules


NOTHING = Stretch(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class SavedTrip:
    """Distance and energy of a trip, and the buckets of each window, the unfinished one last."""

    speed: SavedIntegral
    energy: Joules
    windows: tuple[tuple[Stretch, ...], ...]

    def __post_init__(self) -> None:
        """Refuse impossible distances and energies."""
        self.speed.refuse_above(MAX_SPEED)
        if len(self.windows) != len(WINDOWS):
            raise ValueError("windows are missing")
        for length, buckets in zip(WINDOWS, self.windows, strict=True):
            least = length / BUCKETS
            *full, last = buckets or (Stretch(math.inf, 0.0),)
            fits = len(full) <= BUCKETS and last.distance < least
            if not fits or any(stretch.distance < least for stretch in full):
                raise ValueError(f"no window of {length:g} m")


class DistanceWindow:
    """Energy over the last `length` metres, in a bounded number of buckets.

    It holds full buckets of at least a 20th of its length and an unfinished one. So it spans a
    little more than its length, and energy over distance is exact for its span.
    """

    def __init__(self, length: float, buckets: tuple[Stretch, ...] = (NOTHING,)) -> None:
        """A window of this length, m, empty or with buckets, the unfinished one last."""
        self.length, self.buckets = length, buckets

    @property
    def whole(self) -> tuple[Stretch, ...]:
        """The buckets that are full, oldest first."""
        return self.buckets[:-1]

    @property
    def known(self) -> bool:
        """True if the whole length has been driven."""
        return self.total.distance >= self.length

    @property
    def total(self) -> Stretch:
        """Sum of its whole span."""
        return Stretch(*(math.fsum(column) for column in zip(*self.buckets, strict=True)))

    def extend(self, distance: np.ndarray, energy: np.ndarray) -> None:
        """Add steps: distances, m, and energies, J, shape (n,) each."""
        *full, last = self.buckets
        while True:
            metres = np.cumsum(np.append(last.distance, distance))[1:]
            joules = np.cumsum(np.append(last.energy, energy))[1:]
            ends = int(np.searchsorted(metres, self.length / BUCKETS, side="left"))
            if ends == len(metres):
                break
            full.append(Stretch(float(metres[ends]), float(joules[ends])))
            distance, energy, last = distance[ends + 1 :], energy[ends + 1 :], NOTHING
        if len(metres):
            last = Stretch(float(metres[-1]), float(joules[-1]))
        whole = math.fsum(bucket.distance for bucket in (*full, last))
        while full and whole - full[0].distance >= self.length:
            whole -= full.pop(0).distance
        self.buckets = (*full, last)


class TripLog(Saveable[SavedTrip]):
    """Joins speed and energy to consumption by distance.

    Energy taken while speed was silent has no distance, so it is in no stretch.

    Attributes:
        windows: over the last 1, 10 and 100 km; a reset of the trip keeps them.
    """

    def __init__(self) -> None:
        """Start at zero; speed is not joined across `MAX_GAP`."""
        self.windows = tuple(DistanceWindow(length) for length in WINDOWS)
        self._energy = 0.0
        self._go_on(SavedIntegral())

    def _go_on(self, saved: SavedIntegral) -> None:
        self._speed = EnergyIntegral(MAX_GAP, saved)
        self._energy_before: float | None = None

    @property
    def total(self) -> Stretch:
        """Since the last reset."""
        return Stretch(self._speed.total.drawn, self._energy)

    def extend(self, stamps: np.ndarray, speeds: np.ndarray, energies: np.ndarray) -> None:
        """Add speeds, m/s, with the net energy at them since any start, J; shape (n,) each."""
        # Distance is an `EnergyIntegral` of speed, which handles gaps and equal stamps.
        course = self._speed.extend(stamps, np.abs(speeds))
        used = energies[course.places]
        if not len(used):
            return
        before = used[0] if self._energy_before is None else self._energy_before
        joined = course.joined
        distance, energy = np.diff(course.drawn)[joined], np.diff(used, prepend=before)[joined]
        self._energy = float(np.cumsum(np.append(self._energy, energy))[-1])
        for window in self.windows:
            window.extend(distance, energy)
        self._energy_before = float(used[-1])

    def correct(self, energy: float) -> None:
        """Add energy, J, that later turns out to belong to the trip."""
        self._energy += energy

    def reset_trip(self) -> None:
        """Count the trip from zero."""
        self._energy = 0.0
        self._go_on(SavedIntegral())

    def begin_anew(self) -> None:
        """After a jump of time: join no speed to earlier ones."""
        self._go_on(self._speed.total)

    def saved(self) -> SavedTrip:
        """Distance, energy and windows of consumption, to be saved."""
        windows = tuple(window.buckets for window in self.windows)
        return SavedTrip(self._speed.total, self._energy, windows)

    def take(self, saved: SavedTrip) -> None:
        """Go on from a saved trip; the next speed is joined to none before."""
        self.windows = tuple(map(DistanceWindow, WINDOWS, saved.windows))
        self._energy = saved.energy
        self._go_on(saved.speed)
