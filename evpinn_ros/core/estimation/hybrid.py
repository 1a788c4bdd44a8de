"""`mode: hybrid`: one physics-informed network of a car, learned online.

Battery power is that of the one equation (`estimation.terms`): eq. 12-21 and a tanh network, whose
coefficients and output weights have one mean and one covariance (`estimation.posterior`). They
are learned from energies of intervals (the weak form), once a second on the intervals that ended
in it, in a thread beside the callbacks. Since all is linear, updates one after another are the
same estimate as a solve over the window of all intervals with the prior as its arrival cost.

Published power also has a trim (`estimation.trim`): the error of the model in the last seconds.
During a battery dropout the trim fades. The energy since the battery was last measured is that of
the posterior, with its exact variance, plus that of the fading trim.

A span of samples is predicted and learned from in arrays; only the trim goes sample by sample.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np

from evpinn_ros.common.saved_fields import Saveable
from evpinn_ros.core.estimation.bands import Hills
from evpinn_ros.core.estimation.breakdown import Breakdowns, EndedDrive
from evpinn_ros.core.estimation.car import LearnedCar
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.evidence import Evidence
from evpinn_ros.core.estimation.journey import (
    FORCE_NOISE,
    MAX_STEP,
    POWER_NOISE,
    Tail,
    wandered,
)
from evpinn_ros.core.estimation.learner import (
    LearnerReport,
    Predictions,
    Span,
    gates,
    joined_predictions,
)
from evpinn_ros.core.estimation.parameter_set import TrustHysteresis, deviations, parameter_set
from evpinn_ros.core.estimation.payload import Payload, Stamp
from evpinn_ros.core.estimation.posterior import CarState
from evpinn_ros.core.estimation.published import Driven, evidence_of, published
from evpinn_ros.core.estimation.rehearsal import Rehearsal, Rehearsals
from evpinn_ros.core.estimation.saved_car import (
    saved_state,
    state_of,
)
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Warmth, equation_of
from evpinn_ros.core.estimation.trim import Trim, trim_rows
from evpinn_ros.core.estimation.unevenness import Unevenness
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import Sample, Samples, joined_samples
from evpinn_ros.core.signals.sign_detectors import GradeDetector, SignDetector
from evpinn_ros.core.signals.track import NEVER
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

SAMPLE_STEP = 0.1  # s that the first sample represents
PARKED_NS = 600 * NANOSECONDS  # without speed, after which another drive begins
SILENT_NS = NANOSECONDS  # without the battery, after which energy is predicted


@dataclass(frozen=True, slots=True)
class SavedHybrid:
    """Everything learned of a car; `seen_ns` is the newest stamp."""

    car: CarState
    driven: Driven
    payload: Payload
    grade: GradeDetector
    current_suspicion: SignDetector
    seen_ns: Stamp | None
    hills: Hills = field(default_factory=Hills)
    uneven: Unevenness = field(default_factory=Unevenness.none)


class HybridLearner(Saveable[SavedHybrid]):
    """Learner of `mode: hybrid`."""

    learns_samples = False

    def __init__(self, vehicle: Vehicle, *, seed: int = 0, keep_drives: bool = False) -> None:
        """Start at the vehicle's priors, with a network whose output is zero."""
        self._keep_drives = keep_drives
        self._equation = equation_of(vehicle, seed)
        self._sign = SignDetector()
        self._trust = TrustHysteresis()
        self._waiting: list[Interval] = []
        self._last_ns: int | None = None  # of what was learned from
        self._seen_ns: int | None = None  # of what was predicted
        self.gated: Counter[str] = Counter()
        # Parameters of the present car, suspected or not, and its drive, computed when asked for.
        self._judged: tuple[bool, ParameterSet] | None
        self._together: Breakdowns | None
        self._forget_seconds()
        self._use(LearnedCar.new(self._equation))

    def _forget_seconds(self) -> None:
        """Join nothing to the samples before."""
        self._trim, self._trim_ns = Trim(), 0  # the stamp at which it last learned
        self._tail = Tail(self._equation)
        self._trimmed, self._trimmed_from_ns = 0.0, NEVER  # J that the trim gave since a stamp

    def follow(self, span: Span) -> Predictions:
        """Predict the samples of a span, each by what was learned before it, and learn.

        After a pause of `PARKED_NS`, or if stamps go back, the road is another one. If the gap is
        `PARKED_NS` or more in either direction, so is the drive: a clock that is corrected by some
        seconds ends no drive.
        """
        parts: list[Predictions] = []
        while True:
            stamps = span.smoothed.stamp_ns
            seen_ns = stamps[:1] if self._seen_ns is None else (self._seen_ns,)
            passed_ns = stamps - np.concatenate((seen_ns, stamps[:-1]))[: len(stamps)]
            (pauses,) = ((passed_ns > PARKED_NS) | (passed_ns < 0)).nonzero()
            if not len(pauses):
                return joined_predictions([*parts, self._follow(span, passed_ns)])
            first, span = span.cut(int(pauses[0]))
            parts.append(self._follow(first, passed_ns[: pauses[0]]))
            self._seen_ns = int(span.smoothed.stamp_ns[0])
            if abs(passed_ns[pauses[0]]) > PARKED_NS:
                self._begin_drive(goes_on=True)
            else:
                self._forget_seconds()
                self._use(self._car.forget_road())

    def _follow(self, span: Span, passed_ns: np.ndarray) -> Predictions:
        """`follow` without a pause; passed_ns: step before each smoothed sample, shape (m,)."""
        count, passed, _ = span.sizes
        samples = joined_samples((span.newest, span.smoothed, span.measured))
        power, sigma = self._car_power(samples)
        rows = trim_rows(samples)
        newest, smoothed = slice(count), slice(count, count + passed)
        predicted, measured = slice(count + passed), slice(count + passed, None)
        learned = self._learnable(span.measured, span.power)
        learned_ns = np.concatenate(((self._trim_ns,), span.measured.stamp_ns[learned]))
        residuals = (span.power - power[measured])[learned]
        trim = self._trim.learned(rows[measured][learned], residuals, _seconds(learned_ns))
        self._trim, self._trim_ns = trim.last(), int(learned_ns[-1])
        # Number of samples that the trim learned from before each prediction.
        before = np.concatenate((span.newest_learned, span.smoothed_learned))
        index = np.concatenate(((0,), learned.cumsum()))[before]
        ages = np.maximum(samples.stamp_ns[predicted] - learned_ns[index], 0) / NANOSECONDS
        given, unsure = trim.predict(rows[predicted], ages, index)
        powers = self._possible(power[predicted] + given)
        both = np.stack((powers, np.hypot(sigma[predicted], unsure)), axis=1)
        energies = self._energies(span, given[smoothed], passed_ns / NANOSECONDS)
        if passed:
            self._seen_ns = int(span.smoothed.stamp_ns[-1])
        return Predictions(both[newest], both[smoothed], energies)

    def predict(self, sample: Sample) -> tuple[float, float]:
        """Power and its 1-sigma, W, at a sample by what is learned now: `follow` for a scalar."""
        model = self._model
        row = self._equation.row_of(sample, self._warmth)
        row[State.LOAD] = self._load_left
        variance = max(float(row.dot(model.covariance).dot(row)), 0.0)
        age = max(sample.stamp_ns - self._trim_ns, 0) / NANOSECONDS
        given, unsure = self._trim.predict_one(sample, age)
        power = float(row.dot(model.mean)) + given
        variance += self._variance_beside(sample.speed) + unsure
        return power if self._regenerates else max(power, 0.0), math.sqrt(variance)

    def _possible(self, power: np.ndarray) -> np.ndarray:
        """Power, W, not negative for a car that was never seen to regenerate."""
        return power if self._regenerates else np.maximum(power, 0.0)

    def _car_power(self, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
        """Power of the car without the trim, and its 1-sigma, W, shape (n,) each."""
        model = self._model
        rows = self._equation.rows_of(samples, self._warmth)
        rows[:, State.LOAD] = self._load_left
        variance = np.maximum(((rows @ model.covariance) * rows).sum(axis=1), 0.0)
        return rows @ model.mean, np.sqrt(variance + self._variance_beside(samples.speed))

    def _variance_beside(self, speed: Any) -> Any:
        """Variance beside that of the states, W^2, at speeds, m/s: a number, or n of them."""
        model, left = self._model, self._load_left
        noise = POWER_NOISE**2 + FORCE_NOISE**2 * model.noise[1] * speed**2
        return (1.0 - left**2) * model.load_variance + noise

    def _learnable(self, samples: Samples, power: np.ndarray) -> np.ndarray:
        """Mask of the measured samples that the trim learns from; the others are counted."""
        reasons = gates(samples, power)
        moving = np.abs(samples.speed) >= STANDSTILL_SPEED
        columns = samples.stamp_ns, samples.speed, samples.acceleration, power
        for index, row in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            step, reason = self._step(row[0]), reasons[index]
            if reason is None:
                _, speed, acceleration, watts = row
                self._sign = self._sign.after(speed, acceleration, watts, step)
                reason = self._sign.detected
            if reason is not None:
                self.gated[reason] += 1
                moving[index] = False
        learnable: np.ndarray = moving
        return learnable

    def _energies(self, span: Span, given: np.ndarray, passed: np.ndarray) -> np.ndarray:
        """Energies since the battery was last measured, or a drive began, J, and 1-sigma.

        Args:
            span: of the smoothed samples.
            given: power of the trim at them, W, shape (m,).
            passed: s from the one before to each, shape (m,).

        Returns:
            Shape (m, 2), NaN where the battery is measured.
        """
        stamps, begins_ns = span.smoothed.stamp_ns, span.battery_ns
        energies = np.full((len(stamps), 2), np.nan)
        if not len(stamps):
            return energies
        self._tail.extend(span.smoothed)
        since = np.where(begins_ns == NEVER, 0, stamps - begins_ns) / NANOSECONDS
        steps = given * np.clip(np.minimum(passed, since), 0.0, MAX_STEP)
        silent = (begins_ns == NEVER) | (since >= SILENT_NS / NANOSECONDS)
        for begin_ns in np.unique(begins_ns).tolist():
            of_begin = begins_ns == begin_ns
            if begin_ns != self._trimmed_from_ns:
                self._trimmed, self._trimmed_from_ns = 0.0, begin_ns
            trimmed = self._trimmed + steps[of_begin].cumsum()
            self._trimmed = float(trimmed[-1])
            if silent[of_begin].any():
                energy, sigma = self._dropout(begin_ns, stamps[of_begin])
                energies[of_begin] = np.column_stack((energy + trimmed, sigma))
        energies[~silent] = np.nan
        return energies

    def _dropout(self, begin_ns: int, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy of the car, J, and its 1-sigma, from a begin to stamps, ns, shape (n,)."""
        car, begin_ns = self._car, max(begin_ns, 0)
        if car.measured:
            driven = self._tail.between(begin_ns, stamps, self._warmth)
        else:
            # Intervals begin where the battery was last known, a little before its last sample.
            before = self._tail.between(car.known_ns, np.array([begin_ns]), self._warmth)
            driven = self._tail.between(car.end_ns, stamps, self._warmth)
            driven = driven.plus(car.dropout).less(before)
        return self._model.predicted(driven)

    def add_interval(self, interval: Interval) -> bool:
        """Keep an interval for the next update."""
        if self._sign.detected:
            return False
        self._waiting.append(interval)
        return True

    def prepare_update(self) -> Callable[[], LearnedCar] | None:
        """Work that learns the waiting intervals; None if there are none."""
        if not self._waiting:
            return None
        car, intervals, self._waiting = self._car, self._waiting, []
        return lambda: car.after(intervals)

    def consider(self, candidate: LearnedCar) -> str | None:
        """Use the result of an update; the reason why not if it is not finite or outdated."""
        if not candidate.is_finite():
            return "not_finite"
        if candidate.stretches != self._car.stretches:
            return "outdated"
        self.gated.update(candidate.gated)
        self._use(candidate)
        return None

    def parameters(self) -> ParameterSet:
        """Present estimate of the parameters, in the sense of eq. 12-21."""
        suspected = bool(self._sign.detected)
        if self._judged is None or self._judged[0] != suspected:
            projected = published(self._car.state, self._equation, self._car.driven)
            now, away = parameter_set(0, projected), deviations(projected)
            self._judged = suspected, self._trust.judge(now, away, suspected=suspected)
        return replace(self._judged[1], stamp_ns=self._last_ns or 0)

    def drive(self) -> tuple[EndedDrive, ...]:
        """Parts of this drive so far, to be kept for `together`."""
        return self._car.drive()

    def together(self, before: Sequence[EndedDrive]) -> Breakdowns:
        """Breakdown of this drive and of others before it, summed."""
        if before:
            return self._car.together(before)
        if self._together is None:
            self._together = self._car.together(())
        return self._together

    def breakdowns(self) -> Breakdowns | None:
        """Breakdowns of the drives that were kept, and of this one, last."""
        return self._car.breakdowns()

    def model(self) -> CarModel:
        """The car for forecasts; after a restart, at the begin of another drive."""
        car = self._car
        if self._last_ns is None and car.state.intervals:
            return car.begin_drive().model()
        return self._model

    def evidence(self) -> Evidence:
        """Likelihood of the parameters without their prior, for populations of cars."""
        return evidence_of(self._car.state, self._equation, self._car.driven)

    def report(self) -> LearnerReport:
        """Change of payload, and a wrong sign of the current, or else of the grade.

        The grade is checked by the current.
        """
        sign = self._sign.detected or self._car.grade.detected
        return LearnerReport(self._car.payload.change, sign)

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time; keep what was learned."""
        self._waiting.clear()
        self._last_ns = None
        self._forget_seconds()
        self._use(self._car.forget_road())

    def end_drive(self) -> None:
        """Begin another drive, whose breakdown begins anew."""
        self._begin_drive(goes_on=False)

    def _begin_drive(self, *, goes_on: bool) -> None:
        """Begin another drive; the breakdown goes on or begins anew."""
        self.forget_window()
        self._use(self._car.begin_drive(compare=self._keep_drives, goes_on=goes_on))

    def saved(self) -> SavedHybrid:
        """State to save: the car, without the present road and the last seconds."""
        return SavedHybrid(
            car=saved_state(self._car.judged()),
            uneven=self._car.uneven(),
            hills=self._car.hills.next_drive(),
            driven=self._car.driven,
            payload=self._car.payload,
            grade=self._car.grade,
            current_suspicion=self._sign,
            seen_ns=self._seen_ns,
        )

    def take(self, saved: SavedHybrid) -> None:
        """Go on from a saved state."""
        state = state_of(saved.car, self._equation)
        car = replace(
            LearnedCar.new(self._equation),
            state=state,
            unevenness=saved.uneven.possible(),
            hills=saved.hills,
            driven=saved.driven.of_this_version(),
            rehearsals=Rehearsals(Rehearsal(state)),
            payload=saved.payload,
            grade=saved.grade,
        )
        self._sign = saved.current_suspicion
        self._seen_ns = saved.seen_ns
        self._use(car)

    def _use(self, car: LearnedCar) -> None:
        """Use this car from now on."""
        self._car, self._model = car, car.model()
        self._load_left, _, _ = wandered(car.dropout.seconds)
        self._regenerates = car.driven.regenerates(self._equation)
        self._warmth = Warmth.after(car.state.seconds + car.dropout.seconds)
        self._judged = self._together = None

    def _step(self, stamp_ns: int) -> float:
        """Seconds that a measured sample represents."""
        last, self._last_ns = self._last_ns, stamp_ns
        if last is None:
            return SAMPLE_STEP
        return min(MAX_STEP, max(1e-3, (stamp_ns - last) / NANOSECONDS))


def _seconds(stamps: np.ndarray) -> np.ndarray:
    """Steps between n stamps, ns, not below zero, s, shape (n - 1,)."""
    return np.maximum(np.diff(stamps), 0) / NANOSECONDS


def new_learner(vehicle: Vehicle, settings: EstimatorSettings) -> HybridLearner:
    """The learner of `mode: hybrid`."""
    return HybridLearner(vehicle, seed=settings.seed, keep_drives=settings.keep_drives)
