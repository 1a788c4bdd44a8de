"""Signals that contradict each other, named so that a person can mend them."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple, TypeAlias

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.signals.sample import Sample

CURRENT_SIGN = "current_sign"
MEMORY = 60.0  # s of pulling away and braking that the verdict rests on
ENOUGH = 10.0  # s of them before there is a verdict
HARD = 0.5  # m/s^2: from here on inertia outweighs road load and auxiliaries
SUSPECT_BELOW, CLEAR_ABOVE = -0.5, 0.0  # of the share of power that goes with inertia, -1..1
MOVING = 2.0  # m/s

CHARGE_STEP = 0.02  # of state of charge: more than it creeps by itself while a battery rests
CHARGE_ENERGY = 1e6  # J: below this a step shows the car's bookkeeping rather than current
STANDING = 0.1  # m/s
HIGHEST_AT_REST = 20e3  # W, more than heating cabin and battery takes together
AT_REST_MEMORY = 30.0  # s


Sum: TypeAlias = Annotated[float, Range(-1e15, 1e15)]


class SignSums(NamedTuple):
    """Power signed by acceleration, its size, J, and the time of both, s."""

    signed: Sum = 0.0
    size: Sum = 0.0
    seconds: Sum = 0.0


@dataclass(frozen=True, slots=True)
class SavedSignDetector:
    """Verdict, whether there is one, and the sums it rests on."""

    suspected: bool
    told: bool
    sums: SignSums


class SignDetector(Saveable[SavedSignDetector]):
    """Detector of current of the wrong sign: to accelerate costs power, in every car.

    Followed is the sum of power signed by acceleration over the sum of its size, wherever the car
    pulls away or brakes with more than `HARD`: about +0.9 as it should be, -0.9 with the sign
    flipped.

    Attributes:
        suspected: the verdict.
        judged: whether there was enough to judge by.
    """

    def __init__(self) -> None:
        """Start without data."""
        self.suspected = self.judged = False
        self._sums = SignSums()

    def update(self, sample: Sample, power: float, step: float) -> None:
        """Learn from measured power, W, that stands for `step` seconds."""
        if abs(sample.acceleration) < HARD or sample.speed < MOVING:
            return
        keep = math.exp(-step / MEMORY)
        signed, size, seconds = (keep * each for each in self._sums)
        signed += math.copysign(power, power * sample.acceleration) * step
        size += abs(power) * step
        seconds += step
        self._sums = SignSums(signed, size, seconds)
        if seconds < ENOUGH or size <= 0.0:
            return
        share = signed / size
        self.suspected = bool(share < (CLEAR_ABOVE if self.suspected else SUSPECT_BELOW))
        self.judged = True

    def saved(self) -> SavedSignDetector:
        """State to save."""
        return SavedSignDetector(self.suspected, self.judged, self._sums)

    def take(self, saved: SavedSignDetector) -> None:
        """Go on from a saved state."""
        self.suspected, self.judged, self._sums = saved.suspected, saved.told, saved.sums


class ChargeDetector:
    """Detector of current of the wrong sign: charging fills the battery, drawing empties it.

    Two rules. Each `CHARGE_STEP` of the state of charge must go with the sign of the energy that
    flowed meanwhile, moving or not; and a car at rest does not draw more than `HIGHEST_AT_REST`
    for long, so what seems to is charging.

    Attributes:
        suspected: the verdict.
        judged: whether there was enough to judge by.
    """

    def __init__(self) -> None:
        """Start without data."""
        self.suspected = self.judged = False
        self._charge = math.nan
        self._drawn = self._at_rest = 0.0

    def update(self, power: float, charge: float, speed: float, step: float) -> None:
        """Learn from the readings of `step` seconds.

        Args:
            power: drawn from the battery, W.
            charge: state of charge, 0..1, NaN where unknown.
            speed: m/s, NaN where unknown.
            step: s.
        """
        self._follow_charge(power * step, charge)
        standing = abs(speed) < STANDING
        keep = math.exp(-step / AT_REST_MEMORY) if standing else 0.0
        self._at_rest = keep * self._at_rest + (1.0 - keep) * (power if standing else 0.0)
        if abs(self._at_rest) > HIGHEST_AT_REST:
            self.suspected, self.judged = self._at_rest > 0.0, True

    def _follow_charge(self, drawn: float, charge: float) -> None:
        self._drawn += drawn
        if math.isnan(self._charge):
            self._charge, self._drawn = charge, 0.0
        change = charge - self._charge
        if not abs(change) >= CHARGE_STEP:  # nor when it is not known
            return
        if abs(self._drawn) >= CHARGE_ENERGY:
            self.suspected, self.judged = change * self._drawn > 0.0, True
        self._charge, self._drawn = charge, 0.0
