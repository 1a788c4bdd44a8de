"""State of charge between its readings, and the capacity learned from it.

If the state of charge drops by d while the battery gives the measured energy E, the full battery
holds E / d. Readings are rounded, so d is as uncertain as their step, which is learned from them;
in addition, the energy of a percent varies with temperature and age by `CAPACITY_SPREAD`. These
capacities and the prior of the vehicle file are averaged by their variance.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.signals.readings import NANOSECONDS

CHARGE_TIMEOUT_NS = 60 * NANOSECONDS  # without a reading, after which charge is projected
LEAST_CHANGE = 0.1  # of the state of charge, that capacity is learned from
LEAST_STEPS = 10  # rounding steps in that change
FIRST_STEP = 0.01  # rounding step of the readings before one was seen
SMALLEST_STEP, LARGEST_STEP = 0.005, 0.05  # the car interpolates finer steps
CAPACITY_PRIOR = 0.2  # relative 1-sigma of the vehicle file: usable or gross, new or aged
CAPACITY_SPREAD = 0.05  # relative 1-sigma of one capacity, without rounding
MOST_LEARNED = 1e9  # changes that a saved capacity rests on
CAPACITY_LIMITS = (1e6, 5e9)  # J
OUTLIER = 3.0  # sigma


MOST = 1e15  # of saved values, in any unit


class Uncertain(NamedTuple):
    """A value and its 1-sigma; NaN where unknown."""

    value: Annotated[float, Range(-MOST, MOST, unknown=True)]
    sigma: Annotated[float, Range(0.0, MOST, unknown=True)]

    @property
    def known(self) -> bool:
        """True if there is a value."""
        return math.isfinite(self.value)


UNKNOWN = Uncertain(math.nan, math.nan)


class _ChargeSample(NamedTuple):
    """A state of charge with the totals at that moment.

    Attributes:
        stamp_ns: of the reading.
        charge: 0..1.
        consumed: net energy, J, measured or predicted.
        variance: of `consumed`, J^2.
        unmeasured_s: time without a measured battery so far, s; None during a dropout.
    """

    stamp_ns: int
    charge: float
    consumed: float
    variance: float
    unmeasured_s: float | None


@dataclass(frozen=True, slots=True)
class SavedGauge:
    """Learned capacity, and rounding step of the readings, each None before it is known."""

    capacity: Uncertain | None = None
    learned: Annotated[int, Range(0, MOST_LEARNED)] = 0
    step: Annotated[float, Range(SMALLEST_STEP, LARGEST_STEP)] | None = None


class ChargeGauge(Saveable[SavedGauge]):
    """Follows the state of charge and learns the capacity.

    Attributes:
        capacity: energy of the full battery, J.
        learned: number of changes of the state of charge that `capacity` rests on.
    """

    def __init__(self, capacity: float, limits: tuple[float, float] = CAPACITY_LIMITS) -> None:
        """Start from a capacity, J; or A s, to count charge in place of energy.

        Args:
            capacity: of the vehicle file, NaN if unknown.
            limits: of a learned capacity.
        """
        self._limits = limits
        self._prior = Uncertain(capacity, CAPACITY_PRIOR * capacity)
        self.reset()

    def reset(self) -> None:
        """Forget all readings and all that was learned."""
        self.take(SavedGauge())

    def take(self, saved: SavedGauge) -> None:
        """Go on from what was learned; ValueError for an impossible capacity."""
        low, high = self._limits
        capacity = saved.capacity
        if capacity is not None and not (low <= capacity[0] <= high and 0 < capacity[1] <= high):
            raise ValueError(f"the capacity is not within {low:g} to {high:g}")
        self.capacity, self.learned = capacity or self._prior, saved.learned
        self._step, self._step_seen = saved.step or FIRST_STEP, saved.step is not None
        self.begin_anew()

    def begin_anew(self) -> None:
        """Join nothing to earlier readings, after a jump of time or of the counted energy."""
        self._last: _ChargeSample | None = None
        self._anchor: _ChargeSample | None = None

    @property
    def rounding(self) -> float:
        """1-sigma of one reading, 0..1, from the size of its steps."""
        return self._step / math.sqrt(12.0)

    @property
    def least_change(self) -> float:
        """Least change of the state of charge, 0..1, that the capacity is learned from."""
        return max(LEAST_CHANGE, LEAST_STEPS * self._step)

    @property
    def health(self) -> Uncertain:
        """`capacity` over that of the vehicle file; unknown if none is learned."""
        if not self.learned:
            return UNKNOWN
        return Uncertain(*(joules / self._prior.value for joules in self.capacity))

    @property
    def contradicted(self) -> bool:
        """True if the capacity is more than that of the vehicle file: one of the two is wrong."""
        return self.health.value - OUTLIER * self.health.sigma > 1.0

    def is_new(self, charge: float, unmeasured_s: float | None) -> bool:
        """True if `update` would change anything but the newest stamp."""
        last, anchor = self._last, self._anchor
        if last is None or anchor is None or charge != last.charge:
            return True
        return unmeasured_s is None or anchor.unmeasured_s != unmeasured_s

    def update(
        self, stamp_ns: int, charge: float, consumed: Uncertain, unmeasured_s: float | None
    ) -> None:
        """Take a state of charge; one outside 0..1 is ignored.

        Args:
            stamp_ns: of the reading.
            charge: 0..1.
            consumed: net energy since any fixed moment, J.
            unmeasured_s: time without a measured battery so far, s; None during a dropout.
        """
        if not 0.0 <= charge <= 1.0:
            return
        sample = _ChargeSample(stamp_ns, charge, consumed.value, consumed.sigma**2, unmeasured_s)
        if self._last is not None:
            self._see_step(abs(charge - self._last.charge))
        self._last = sample
        anchor = self._anchor
        if anchor is None or unmeasured_s is None or anchor.unmeasured_s != unmeasured_s:
            self._anchor = sample
        else:
            self._learn(anchor, sample)

    def _see_step(self, step: float) -> None:
        if not 0.0 < step <= LARGEST_STEP:
            return
        step = max(step, SMALLEST_STEP)
        self._step = min(self._step, step) if self._step_seen else step
        self._step_seen = True

    def _learn(self, anchor: _ChargeSample, sample: _ChargeSample) -> None:
        change = anchor.charge - sample.charge
        if abs(change) < self.least_change:
            return
        self._anchor = sample
        capacity = (sample.consumed - anchor.consumed) / change
        if not self._limits[0] <= capacity <= self._limits[1]:
            return
        spread = math.hypot(CAPACITY_SPREAD, math.sqrt(2) * self.rounding / change)
        self._average(Uncertain(capacity, spread * capacity))
        self.learned += 1

    def _average(self, shown: Uncertain) -> None:
        """Average by variance; the 1-sigma is at least a fourth of `CAPACITY_SPREAD`.

        Outliers get a larger sigma: a winter trip of the i3 gives 29 kWh, others 23.
        """
        if not self.capacity.known:
            self.capacity = shown
            return
        difference = shown.value - self.capacity.value
        variance = max(shown.sigma, abs(difference) / OUTLIER) ** 2
        gain = self.capacity.sigma**2 / (self.capacity.sigma**2 + variance)
        value = self.capacity.value + gain * difference
        sigma = max(self.capacity.sigma * math.sqrt(1 - gain), CAPACITY_SPREAD * value / 4)
        self.capacity = Uncertain(value, sigma)

    def projected(self, stamp_ns: int) -> bool:
        """True if the state of charge at this moment follows from energy, not from a reading."""
        return self._last is not None and stamp_ns - self._last.stamp_ns > CHARGE_TIMEOUT_NS

    def charge(self, stamp_ns: int, consumed: Uncertain) -> Uncertain:
        """State of charge, 0..1, at a moment, by the net energy consumed until then, J.

        The last reading for `CHARGE_TIMEOUT_NS`; after that, less the energy taken since. Unknown
        without a reading, or then without a capacity.
        """
        last = self._last
        if last is None:
            return UNKNOWN
        if not self.projected(stamp_ns):
            return Uncertain(last.charge, self.rounding)
        if not self.capacity.known:
            return UNKNOWN
        taken = consumed.value - last.consumed
        value = last.charge - taken / self.capacity.value
        variance = (
            self.rounding**2
            + max(consumed.sigma**2 - last.variance, 0.0) / self.capacity.value**2
            + (taken * self.capacity.sigma / self.capacity.value**2) ** 2
        )
        return Uncertain(min(max(value, 0.0), 1.0), math.sqrt(variance))

    def energy_between(self, before: float, after: float) -> Uncertain:
        """Energy between two states of charge, 0..1, J; unknown without capacity."""
        drop = before - after
        sigma = math.hypot(
            math.sqrt(2) * self.rounding * self.capacity.value, drop * self.capacity.sigma
        )
        return Uncertain(drop * self.capacity.value, sigma)

    def usable(self, charge: Uncertain) -> Uncertain:
        """Energy left, J, at a state of charge."""
        sigma = math.hypot(charge.value * self.capacity.sigma, charge.sigma * self.capacity.value)
        return Uncertain(charge.value * self.capacity.value, sigma)

    def saved(self) -> SavedGauge:
        """Capacity and rounding step to save, each None before it is known."""
        capacity = self.capacity if self.learned > 0 else None
        return SavedGauge(capacity, self.learned, self._step if self._step_seen else None)
