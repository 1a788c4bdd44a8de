"""Payload that came or went at a stop, found from mass/eta after it against before it.

mass/eta needs no prior, and eta does not change at a stop, so the ratio of two estimates of it is
the ratio of two masses, whatever the absolute mass is (Vahidi 2005 has mass and grade; that the
ratio is free of the gauge is what makes it sharp). At each stop the filter is forked: the fork
keeps all that is known of the car but lets its mass go by `LOAD_SPREAD`, so after some driving its
m/eta rests on what came after the stop alone. Once it differs from that before the stop by more
than chance and by more than `LEAST_CHANGE`, the fork becomes the filter.

What chance does is learned from the stops at which nothing changed: their changes over their
sigmas have a root mean square (`calibration.Chance`). A car whose stops are not known yet is given
no change. `SIGNIFICANT` is far out because there are 5000 stops in 100 hours.

A change is reported as soon as it is certain that there is one, and sharpened for `MOST_MOTION`
since the stop. An earlier stop may be certain first, having seen both loads; so later stops that
were on trial then go on, and the most significant has it. Undone: for `PROBATION` of motion a
change is compared with what the filter learns further. If m/eta comes back past half of it, the
change is withdrawn; the next stop may also take it back.
"""

from __future__ import annotations

from collections import deque
import copy
from dataclasses import dataclass, replace
import math
from typing import Annotated, Any, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.estimation.calibration import Chance
from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.published import EnergySums, mass_over_eta, published
from evpinn_ros.signals.interval import Interval
from evpinn_ros.vehicle.physics import STANDSTILL_SPEED

STOP = 5.0  # s of standstill, or without intervals, in which someone may get in or out
LOAD_SPREAD = 0.15  # 1-sigma of the logarithm of mass across a stop: full load of a passenger car
LEAST_MOTION = 70.0  # s of motion after a stop before it is judged
MOST_MOTION = 120.0  # s of motion after which a stop is judged no more
KNOWN = 0.02  # 1-sigma of the logarithm of m/eta that must be reached before and after
SIGNIFICANT = 4.8  # sigmas
LEAST_CHANGE = 85.0  # kg: one grown person with a bag
LEAST_STOPS = 3.0  # without a change, before one is reported
FORKS = 4  # stops on trial at once
PROBATION = 600.0  # s of motion in which a change may be withdrawn
MOST_MASS = 1e6  # kg
Stamp: TypeAlias = Annotated[int, Range(0, 2**62)]  # ns; to the year 2116
Share: TypeAlias = Annotated[float, Range(0.0, 20.0)]


@dataclass(frozen=True, slots=True)
class PayloadChange:
    """A change of payload.

    Attributes:
        stamp_ns: of the stop at which it happened.
        delta_mass: kg, positive when load was added.
        std: its 1-sigma, kg.
    """

    stamp_ns: Stamp
    delta_mass: Annotated[float, Range(-MOST_MASS, MOST_MASS)]
    std: Annotated[float, Range(0.0, MOST_MASS)]


@dataclass(slots=True)
class _Trial:
    """A stop on trial.

    `before`, log m/eta at it with 1-sigma and mass, kg; `motion`, s since; `change` of log m/eta
    and its `significance` when it was found; `rival` of the change found, when it was on trial
    already then.
    """

    stamp_ns: Stamp
    before: Share
    before_std: Share
    mass: Annotated[float, Range(0.0, MOST_MASS)]
    motion: Annotated[float, Range(0.0, 1e6)] = 0.0
    change: Annotated[float, Range(-20.0, 20.0)] = 0.0
    significance: Annotated[float, Range(0.0, 1e6)] = 0.0
    rival: bool = False


@dataclass(frozen=True, slots=True)
class SavedPayload:
    """Chance, the last change, and the one on probation; stops on trial end with the process."""

    chance: Chance
    change: PayloadChange | None
    found: _Trial | None

    def __post_init__(self) -> None:
        """Refuse a change that is none."""
        if self.found is not None and self.found.change == 0.0:
            raise ValueError("the change of payload found is none")


class PayloadDetector(Saveable[SavedPayload]):
    """See the module's text. Feed it every interval that the filter learns from, after the filter.

    Attributes:
        change: the last change of payload, None when none was found or it was withdrawn.
        found: changes found.
        withdrawn: changes withdrawn.
    """

    def __init__(self) -> None:
        """Nothing known of any stop."""
        self.change: PayloadChange | None = None
        self.found = self.withdrawn = 0
        self._chance = Chance()
        self._trials: deque[tuple[_Trial, CarFilter]] = deque(maxlen=FORKS)
        self._given_up: list[_Trial] = []  # as it seems now, stops without a change
        self._found: _Trial | None = None  # the change on probation
        self._standing = 0.0
        self._last_ns: int | None = None

    def forget_time(self) -> None:
        """After a jump of time or a gap: the car may have stood, and drive elsewhere."""
        self._trials.clear()
        self._given_up.clear()
        self._last_ns = None
        self._standing = STOP

    def copy(self) -> PayloadDetector:
        """An independent copy."""
        other = copy.copy(self)
        other._chance, other._found = replace(self._chance), copy.copy(self._found)
        other._trials = deque(
            ((replace(trial), fork.copy()) for trial, fork in self._trials), maxlen=FORKS
        )
        other._given_up = [replace(trial) for trial in self._given_up]
        return other

    def learn(self, current: CarFilter, sums: EnergySums, interval: Interval) -> CarFilter:
        """Judge stops by one more interval; gives the filter to go on with."""
        last, self._last_ns = self._last_ns, interval.end_ns
        unseen = 0.0 if last is None else (interval.start_ns - last) * 1e-9
        for _, fork in self._trials:
            fork.learn(interval)
        steps = interval.steps
        stands = steps.distance < STANDSTILL_SPEED * steps.duration
        moved = interval.duration - float(steps.duration @ stands)
        before = self._standing + (interval.duration if stands.all() else _leading(stands, steps))
        if moved > 0.0 and max(before, unseen) >= STOP:
            self._begin(current, sums, interval.start_ns)
        self._standing = _trailing(stands, steps) if moved > 0.0 else before
        if moved == 0.0:
            return current
        self._watch(current, sums, moved)
        return self._judge(current, sums, moved)

    def saved(self) -> SavedPayload:
        """State to save."""
        return SavedPayload(self._chance, self.change, self._found)

    def take(self, saved: SavedPayload) -> None:
        """Go on from a saved state; the car may have stood since."""
        self._chance, self.change, self._found = saved.chance, saved.change, saved.found
        self._standing = STOP

    def _begin(self, current: CarFilter, sums: EnergySums, stamp_ns: int) -> None:
        """The car sets off again after a stop."""
        log, std = mass_over_eta(current, sums)
        if std > KNOWN:
            return
        mass = math.exp(float(published(current, sums).now.mean[2]))
        self._trials.append((_Trial(stamp_ns, log, std, mass), current.fork(LOAD_SPREAD)))

    def _judge(self, current: CarFilter, sums: EnergySums, moved: float) -> CarFilter:
        """Take the stop that the data speak for most."""
        best: tuple[_Trial, CarFilter, float] | None = None
        for trial, fork in self._trials:
            trial.motion += moved
            if trial.motion < LEAST_MOTION or self._chance.count < LEAST_STOPS:
                continue
            log, std = mass_over_eta(fork, sums)
            trial.change = log - trial.before
            trial.significance = abs(trial.change) / self._spread(trial, std)
            enough = abs(trial.mass * math.expm1(trial.change)) >= LEAST_CHANGE
            decided = std <= KNOWN and enough and trial.significance >= SIGNIFICANT
            rival = self._found if trial.rival else None
            decided = decided and (rival is None or trial.significance > rival.significance)
            if decided and (best is None or trial.significance > best[0].significance):
                best = trial, fork, std
        if best is not None:
            best[1].parts = current.parts  # what went before the stop is known as it was
            return self._take(*best)
        self._give_up(sums, moved)
        return current

    def _take(self, trial: _Trial, fork: CarFilter, std: float) -> CarFilter:
        """A change is found, or found to be of a later stop than it seemed."""
        self.found += not trial.rival
        self.change = self._payload_change(trial, trial.change, std)
        self._found = trial
        later = [each for each in self._trials if each[0].stamp_ns > trial.stamp_ns]
        self._trials.clear()
        self._trials.extend(later)
        self._given_up.clear()
        for each, _ in later:
            each.rival = True
        return fork

    def _give_up(self, sums: EnergySums, moved: float) -> None:
        """Learn what chance does where nothing changed, once it is sure that nothing did."""
        while self._trials and self._trials[0][0].motion > MOST_MOTION:
            trial, fork = self._trials.popleft()
            log, std = mass_over_eta(fork, sums)
            if std <= KNOWN and not trial.rival:
                trial.significance = abs(log - trial.before) / math.hypot(std, trial.before_std)
                self._given_up.append(trial)
        for trial in self._given_up:
            trial.motion += moved
        while self._given_up and self._given_up[0].motion > 2 * MOST_MOTION:
            self._chance.learn(self._given_up.pop(0).significance)

    def _watch(self, current: CarFilter, sums: EnergySums, moved: float) -> None:
        """Sharpen a change by what is learned after it, or withdraw it."""
        found = self._found
        if found is None or self.change is None:
            return
        found.motion += moved
        log, std = mass_over_eta(current, sums)
        change = log - found.before
        if found.motion > PROBATION:
            self._found = None
        elif change / found.change < 0.5:
            self._found = self.change = None
            self.withdrawn += 1
            self._chance.learn(found.significance * self._chance.scale)  # chance did that
        elif found.motion <= MOST_MOTION:
            self.change = self._payload_change(found, change, std)

    def _spread(self, trial: _Trial, std: float) -> float:
        """1-sigma of a change of log m / eta, from that of log m / eta now."""
        return self._chance.scale * math.hypot(std, trial.before_std)

    def _payload_change(self, trial: _Trial, change: float, std: float) -> PayloadChange:
        """The change of mass, kg, of a change of log m / eta, from the 1-sigma of this now."""
        delta = trial.mass * math.expm1(change)
        return PayloadChange(trial.stamp_ns, delta, trial.mass * self._spread(trial, std))


def _leading(stands: np.ndarray, steps: Any) -> float:
    """Seconds that the car stands at the begin of an interval in which it moves."""
    return float(steps.duration[: int(np.argmin(stands))].sum())


def _trailing(stands: np.ndarray, steps: Any) -> float:
    """Seconds that it stands at its end."""
    count = int(np.argmin(stands[::-1]))
    return float(steps.duration[len(stands) - count :].sum())
