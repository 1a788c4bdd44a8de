"""Payload that came or went at a stop, found from mass/eta after it against before it.

mass/eta needs no prior, and eta does not change at a stop, so the ratio of two estimates of it is
the ratio of two masses, whatever the absolute mass is (Vahidi 2005 has mass and grade; that the
ratio is free of the gauge is what makes it sharp). Each stop begins one more hypothesis: a state
that keeps all that is known of the car but lets its mass go by `LOAD_SPREAD`, so after some
driving its m/eta rests on what came after the stop alone. Once it differs from that before the
stop by more than chance and by more than `LEAST_CHANGE`, this state becomes the car's.

What chance does is learned from the stops at which nothing changed: their changes over their
sigmas have a root mean square (`Chance`). A car whose stops are not known yet is given
no change. The limit is far out because there are 5000 stops in 100 hours.

A change is reported as soon as it is certain that there is one, and sharpened for `MOST_MOTION`
since the stop. An earlier stop may be certain first, having seen both loads; so later stops that
were on trial then go on, and the most significant has it. Undone: for `PROBATION` of motion a
change is compared with what the filter learns further. If m/eta comes back past half of it, the
change is withdrawn; the next stop may also take it back.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math
from typing import Annotated, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.calibration import MOST_SUM
from evpinn_ros.core.estimation.posterior import OUTLIER, CarState, Learned, PassedInterval, learn
from evpinn_ros.core.estimation.published import Driven, mass_over_eta
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.signals.detector import ANOTHER_MASS, PAYLOAD
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

STOP = 5.0  # s of standstill, or without intervals, in which someone may get in or out
LOAD_SPREAD = 0.15  # 1-sigma of the logarithm of mass across a stop: full load of a passenger car
MOST_MOTION = 150.0  # s of motion after which a stop is judged no more
KNOWN = 0.06  # 1-sigma of the logarithm of m/eta that must be reached before
LEAST_CHANGE = 85.0  # kg: one grown person with a bag
LEAST_STOPS = 3.0  # without a change, before one is reported
FORKS = 4  # stops on trial at once, the likeliest
PROBATION = 600.0  # s of motion in which a change may be withdrawn
MOST_MASS = 1e6  # kg
CHANCE_KEPT = 40.0  # stops that `Chance` is learned from
PRIOR_STOPS = 8.0  # that its prior, true sigmas, weighs
Stamp: TypeAlias = Annotated[int, Range(0, 2**62)]  # ns; to the year 2116
Share: TypeAlias = Annotated[float, Range(0.0, 20.0)]


@dataclass(frozen=True, slots=True)
class Chance:
    """Scatter of normalised errors: `count` cases seen, sum of `squares` of sigmas."""

    count: Annotated[float, Range(0.0, MOST_SUM)] = 0.0
    squares: Annotated[float, Range(0.0, MOST_SUM)] = 0.0

    def after(self, deviate: float) -> Chance:
        """With one more case: how far it strayed over its 1-sigma."""
        keep = min(1.0, (CHANCE_KEPT - 1.0) / max(self.count, 1.0))
        return Chance(keep * self.count + 1.0, keep * self.squares + deviate**2)

    @property
    def scale(self) -> float:
        """By which sigmas are too small, at least 1."""
        mean = (PRIOR_STOPS + self.squares) / (PRIOR_STOPS + self.count)
        return math.sqrt(max(1.0, mean))


@dataclass(frozen=True, slots=True)
class PayloadChange:
    """A change of payload: stamp of its stop, kg (positive when load was added), 1-sigma, kg."""

    stamp_ns: Stamp
    delta_mass: Annotated[float, Range(-MOST_MASS, MOST_MASS)]
    std: Annotated[float, Range(0.0, MOST_MASS)]


@dataclass(frozen=True, slots=True)
class _Trial:
    """A stop on trial.

    `before`, log m/eta at it, and mass, kg; `motion`, s since; `odds`, logarithm of how much
    likelier the trial made what came than the car as it was; `change` of log m/eta and its
    `significance` when it was found; `rival` if it was on trial when another change was found.
    """

    stamp_ns: Stamp
    before: Share
    mass: Annotated[float, Range(0.0, MOST_MASS)]
    motion: Annotated[float, Range(0.0, 1e6)] = 0.0
    change: Annotated[float, Range(-20.0, 20.0)] = 0.0
    significance: Annotated[float, Range(0.0, 1e6)] = 0.0
    odds: Annotated[float, Range(-1e12, 1e12)] = 0.0
    rival: bool = False

    @property
    def sigmas(self) -> float:
        """By how many sigmas the trial differs: twice its log likelihood ratio is their square."""
        return math.sqrt(2.0 * max(self.odds, 0.0))

    def payload_change(self, change: float) -> PayloadChange:
        """The change of mass, kg, of one of log m / eta, as sure as it is significant."""
        mass = self.mass * math.expm1(change)
        return PayloadChange(self.stamp_ns, mass, abs(mass) / max(self.significance, 1.0))


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


@dataclass(frozen=True, slots=True, eq=False)
class PayloadDetector:
    """Detector of changed payload.

    Attributes:
        change: the last change of payload, None when none was found or it was withdrawn.
        found: changes found.
        withdrawn: changes withdrawn.
        chance: how far m / eta strays at stops where nothing changed.
        trials: stops on trial, each with the state of its hypothesis.
        given_up: as it seems now, stops without a change.
        watched: the change on probation.
        standing: s that the car stands.
        last_ns: end of the last interval.
        taken: state of the hypothesis that the last interval decided for, to go on with.
    """

    change: PayloadChange | None = None
    found: int = 0
    withdrawn: int = 0
    chance: Chance = field(default_factory=Chance)
    trials: tuple[tuple[_Trial, CarState], ...] = ()
    given_up: tuple[_Trial, ...] = ()
    watched: _Trial | None = None
    standing: float = 0.0
    last_ns: int | None = None
    taken: CarState | None = None

    @property
    def detected(self) -> str | None:
        """`PAYLOAD` or None."""
        return PAYLOAD if self.change is not None else None

    @classmethod
    def of(cls, saved: SavedPayload) -> PayloadDetector:
        """The detector of a saved state; the car may have stood since."""
        change, watched = saved.change, saved.found
        return cls(change, chance=saved.chance, watched=watched, standing=STOP)

    def saved(self) -> SavedPayload:
        """State to save."""
        return SavedPayload(self.chance, self.change, self.watched)

    def forget_time(self) -> PayloadDetector:
        """After a jump of time or a gap: the car may have stood, and drive elsewhere."""
        return replace(self, trials=(), given_up=(), last_ns=None, standing=STOP)

    def after(
        self,
        before: CarState,
        now: CarState,
        learned: Learned,
        equation: Equation,
        driven: Driven,
        done: PassedInterval,
    ) -> PayloadDetector:
        """The detector after one more interval, with the car's states before and after."""
        interval = done.interval
        unseen = 0.0 if self.last_ns is None else (interval.start_ns - self.last_ns) * 1e-9
        stood, standing, moved = _stands(done, max(self.standing, unseen))
        trials = tuple(_tried(stop, state, learned, equation, done) for stop, state in self.trials)
        detector = replace(
            self, trials=trials, standing=standing, last_ns=interval.end_ns, taken=None
        )
        if moved == 0.0:
            return detector
        if stood >= STOP:
            detector = detector._begin(before, learned, equation, driven, done)
        detector = detector._watch(mass_over_eta(now, equation, driven)[0], moved)
        return detector._judge(equation, driven, moved)

    def _begin(
        self,
        before: CarState,
        learned: Learned,
        equation: Equation,
        driven: Driven,
        done: PassedInterval,
    ) -> PayloadDetector:
        """The car sets off again after a stop: try a state that knows its mass less well."""
        log, std = mass_over_eta(before, equation, driven)
        if std > KNOWN:
            return self
        mean = before.mean.copy()
        spread = np.zeros((len(mean), mean.shape[1]))
        load = [State.MASS, State.ROLLING]  # tyres carry the load too
        spread[:, load] = LOAD_SPREAD * mean[:, load]
        covariance = before.covariance + spread[:, :, None] * spread[:, None, :]
        state = replace(before, covariance=covariance)
        mass = math.exp(log) * (equation.eta + float(before.weights @ mean[:, State.ETA]))
        stop = _Trial(done.interval.start_ns, log, mass)
        trial = _tried(stop, state, learned, equation, done)
        trials = sorted((*self.trials, trial), key=lambda trial_and_fork: trial_and_fork[0].odds)
        kept = sorted(trials[-FORKS:], key=lambda trial_and_fork: trial_and_fork[0].stamp_ns)
        return replace(self, trials=tuple(kept))

    def _judge(self, equation: Equation, driven: Driven, moved: float) -> PayloadDetector:
        """Take the stop that the data speak for most."""
        trials = []
        for old, state in self.trials:
            stop = replace(old, motion=old.motion + moved)
            if stop.motion >= ANOTHER_MASS.least and self.chance.count >= LEAST_STOPS:
                change = mass_over_eta(state, equation, driven)[0] - stop.before
                significance = stop.sigmas / self.chance.scale
                stop = replace(stop, change=change, significance=significance)
            trials.append((stop, state))
        detector = replace(self, trials=tuple(trials))
        certain = [trial_and_fork for trial_and_fork in trials if self._decides(trial_and_fork[0])]
        if not certain:
            return detector._give_up(moved)
        return detector._take(
            *max(certain, key=lambda trial_and_fork: trial_and_fork[0].significance)
        )

    def _decides(self, stop: _Trial) -> bool:
        """True if a stop is certain to have changed the payload."""
        if abs(stop.mass * math.expm1(stop.change)) < LEAST_CHANGE:
            return False
        rival = self.watched if stop.rival else None
        if rival is not None and stop.significance <= rival.significance:
            return False
        return ANOTHER_MASS.judge(None, stop.significance, stop.motion) is True

    def _take(self, stop: _Trial, state: CarState) -> PayloadDetector:
        """A change is found, or found to be of a later stop than it seemed."""
        later = (
            trial_and_fork
            for trial_and_fork in self.trials
            if trial_and_fork[0].stamp_ns > stop.stamp_ns
        )
        return replace(
            self,
            found=self.found + (not stop.rival),
            change=stop.payload_change(stop.change),
            watched=stop,
            trials=tuple(
                (replace(trial_and_fork, rival=True), fork) for trial_and_fork, fork in later
            ),
            given_up=(),
            taken=state,
        )

    def _give_up(self, moved: float) -> PayloadDetector:
        """Learn what chance does where nothing changed, once it is sure that nothing did."""
        over = [stop for stop, _ in self.trials if stop.motion > MOST_MOTION and not stop.rival]
        given_up = [replace(stop, motion=stop.motion + moved) for stop in (*self.given_up, *over)]
        chance = self.chance
        for stop in given_up:
            if stop.motion > 2 * MOST_MOTION:
                chance = chance.after(stop.sigmas)
        return replace(
            self,
            trials=tuple(
                trial_and_fork
                for trial_and_fork in self.trials
                if trial_and_fork[0].motion <= MOST_MOTION
            ),
            given_up=tuple(stop for stop in given_up if stop.motion <= 2 * MOST_MOTION),
            chance=chance,
        )

    def _watch(self, log: float, moved: float) -> PayloadDetector:
        """Sharpen a change by what is learned after it, or withdraw it."""
        stop = self.watched
        if stop is None or self.change is None:
            return self
        stop = replace(stop, motion=stop.motion + moved)
        change = log - stop.before
        if stop.motion > PROBATION:
            return replace(self, watched=None)
        if change / stop.change < 0.5:
            chance = self.chance.after(stop.significance * self.chance.scale)  # chance did that
            return replace(
                self, watched=None, change=None, withdrawn=self.withdrawn + 1, chance=chance
            )
        if stop.motion > MOST_MOTION:
            return replace(self, watched=stop)
        return replace(self, watched=stop, change=stop.payload_change(change))


def _tried(
    stop: _Trial, state: CarState, learned: Learned, equation: Equation, done: PassedInterval
) -> tuple[_Trial, CarState]:
    """A stop on trial after one more interval, with the state of its hypothesis."""
    state, own = learn(state, equation, done)
    return replace(stop, odds=stop.odds + _likelihood(own) - _likelihood(learned)), state


def _likelihood(seen: Learned) -> float:
    """Logarithm of the likelihood of an interval, its tails as heavy as the posterior's."""
    away = min((seen.residual / seen.sigma) ** 2, 2.0 * OUTLIER**2)
    return -0.5 * away - math.log(seen.sigma)


def _stands(done: PassedInterval, standing: float) -> tuple[float, float, float]:
    """Seconds of the longest stand that ends in an interval, of the one at its end, of motion."""
    steps = done.interval.steps
    longest = moved = 0.0
    for distance, duration in zip(steps.distance.tolist(), steps.duration.tolist(), strict=True):
        if distance < STANDSTILL_SPEED * duration:
            standing += duration
        else:
            longest, standing, moved = max(longest, standing), 0.0, moved + duration
    return longest, standing, moved
