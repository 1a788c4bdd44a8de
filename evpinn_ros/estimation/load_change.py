"""Payload that came or went at a stop, found from mass/eta after it against before it.

mass/eta needs no prior, and eta does not change at a stop, so the ratio of two estimates of it is
the ratio of two masses, whatever the absolute mass is (Vahidi 2005 has mass and grade; that the
ratio is free of the gauge is what makes it sharp). At each stop the filter is forked: the fork
keeps all that is known of the car but lets its mass go by `LOAD_SPREAD`, so after some driving its
m/eta rests on what came after the stop alone. Once it differs from that before the stop by more
than chance and by more than `LEAST_CHANGE`, the fork becomes the filter.

A change is told as soon as it is certain that there is one, and sharpened for `MOST_MOTION` since
the stop. Undone: for `PROBATION` of motion it is held against what the filter learns further. If
m/eta comes back past half of it, the change is withdrawn; the next stop may also take it back.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

from evpinn_ros.estimation.published_filter import PublishedFilter
from evpinn_ros.signals.sample import Sample
from evpinn_ros.vehicle.physics import STANDSTILL_SPEED

STOP = 5.0  # s of standstill, or of silence, in which someone may get in or out
LOAD_SPREAD = 0.15  # 1-sigma of the logarithm of mass across a stop: full load of a passenger car
LEAST_MOTION = 60.0  # s of motion after a stop before it is judged
MOST_MOTION = 120.0  # s of motion after which a stop is judged no more
KNOWN = 0.02  # 1-sigma of the logarithm of m/eta that must be reached before and after
SIGNIFICANT = 3.5  # sigmas; those below hold far more than chance
LEAST_CHANGE = 85.0  # kg: one grown person with a bag
MAP_STD = 0.015  # of m/eta from one minute of motion to the next: efficiency is a map, roads hilly
MAP_TIME = 60.0  # s of motion that this is meant for; it averages out as any noise
FORKS = 4  # stops on trial at once
PROBATION = 600.0  # s of motion in which a change may be withdrawn


@dataclass(frozen=True, slots=True)
class LoadChange:
    """A change of payload.

    Attributes:
        stamp_ns: of the stop at which it happened.
        delta_mass: kg, positive when load was added.
        std: its 1-sigma, kg.
    """

    stamp_ns: int
    delta_mass: float
    std: float


@dataclass(slots=True)
class _Trial:
    """A stop on trial: the filter let go of the mass there, and log m/eta before it.

    `motion`, s since; `change` of log m/eta when it was found.
    """

    stamp_ns: int
    filter: PublishedFilter
    before: float
    before_std: float
    mass: float
    motion: float = 0.0
    change: float = 0.0


class LoadDetector:
    """See the module's text. Feed it every sample that the filter learns from, after the filter.

    Attributes:
        change: the last change of payload, None when none was found or it was withdrawn.
        found: changes found.
        withdrawn: changes withdrawn.
    """

    def __init__(self) -> None:
        """Nothing known of any stop."""
        self.change: LoadChange | None = None
        self.found = self.withdrawn = 0
        self._trials: deque[_Trial] = deque(maxlen=FORKS)
        self._found: _Trial | None = None  # the change on probation
        self._settled: tuple[float, float] | None = None
        self._standing = 0.0
        self._last_ns: int | None = None

    def forget_time(self) -> None:
        """After a jump of time or a gap: the car may have stood, and drive elsewhere."""
        self._trials.clear()
        self._last_ns = None
        self._standing = STOP

    def push(
        self, current: PublishedFilter, sample: Sample, power: float, step: float
    ) -> PublishedFilter:
        """Judge stops by one more sample; gives the filter to go on with, `current` or a fork."""
        silent = 0.0 if self._last_ns is None else (sample.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = sample.stamp_ns
        for trial in self._trials:
            trial.filter.advance(sample)
            trial.filter.update(sample, power, step)
        if abs(sample.speed) < STANDSTILL_SPEED:
            self._standing += step
            return current
        if max(self._standing, silent) >= STOP:
            self._begin(current, sample)
        self._standing = 0.0
        self._watch(current, step)
        return self._judge(current, step)

    def take_settled(self) -> tuple[float, float] | None:
        """A change that stood for `MOST_MOTION`: of log mass, and its 1-sigma; told once."""
        settled, self._settled = self._settled, None
        return settled

    def _begin(self, current: PublishedFilter, sample: Sample) -> None:
        """The car sets off again after a stop."""
        log, std = current.mass_over_eta()
        if std > KNOWN:
            return
        mass = current.published().parameters().mass
        fork = current.fork(LOAD_SPREAD)
        self._trials.append(_Trial(sample.stamp_ns, fork, log, std, mass))

    def _judge(self, current: PublishedFilter, step: float) -> PublishedFilter:
        """Take the earliest stop that the data speak for."""
        for trial in self._trials:
            trial.motion += step
        while self._trials and self._trials[0].motion > MOST_MOTION:
            self._trials.popleft()
        best: tuple[float, _Trial, float, float] | None = None
        for trial in self._trials:
            if trial.motion < LEAST_MOTION:
                continue
            log, std = trial.filter.mass_over_eta()
            change = log - trial.before
            spread = _spread(trial, std)
            significance = abs(change) / spread
            enough = abs(trial.mass * math.expm1(change)) >= LEAST_CHANGE
            decided = std <= KNOWN and significance >= SIGNIFICANT and enough
            if decided and (best is None or significance > best[0]):
                best = (significance, trial, change, std)
        if best is None:
            return current
        _, trial, trial.change, std = best
        self._found = trial
        self.change = _load_change(trial, trial.change, std)
        self.found += 1
        self._trials.clear()
        trial.filter.shift_mass(0.0, 0.0)
        return trial.filter

    def _watch(self, current: PublishedFilter, step: float) -> None:
        """Sharpen a change by what is learned after it, or withdraw it."""
        found = self._found
        if found is None or self.change is None:
            return
        unsettled = found.motion <= MOST_MOTION
        found.motion += step
        log, std = current.mass_over_eta()
        change = log - found.before
        if found.motion > PROBATION:
            self._found = None
        elif change / found.change < 0.5:
            self._found = self.change = None
            self.withdrawn += 1
        elif found.motion <= MOST_MOTION:
            self.change = _load_change(found, change, std)
        elif unsettled:
            self._settled = change, _spread(found, std)


def _load_change(trial: _Trial, change: float, std: float) -> LoadChange:
    """The change of mass, kg, of a change of the logarithm of m / eta, whose 1-sigma is given."""
    delta = trial.mass * math.expm1(change)
    return LoadChange(trial.stamp_ns, delta, trial.mass * _spread(trial, std))


def _spread(trial: _Trial, std: float) -> float:
    """1-sigma of a change of log m / eta, from its 1-sigma now."""
    varies = MAP_STD * math.sqrt(MAP_TIME / trial.motion)
    return math.hypot(std, trial.before_std, varies)
