"""`mode: hybrid`: one physics-informed network of a car, learned online.

Battery power is that of the one equation (`estimation.terms`): eq. 12-21 and a tanh network, whose
coefficients and output weights have one mean and one covariance (`estimation.posterior`). They
are learned from energies of intervals (the weak form), once a second on the intervals that ended
in it, in a thread beside the callbacks. Since all is linear, updates one after another are the
same estimate as a solve over the window of all intervals with the prior as its arrival cost.

Published power has a trim beside it (`estimation.trim`): what the last seconds had beyond the
car. During a battery dropout the trim fades, and the energy since the battery was last measured is
that of the posterior, with its exact variance, and what the trim gave until it had faded.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

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
    Journey,
    Tail,
    wandered,
)
from evpinn_ros.core.estimation.learner import (
    NO_MOMENTS,
    LearnerReport,
    Moments,
    Predictions,
    Step,
    gates,
)
from evpinn_ros.core.estimation.parameter_set import TrustHysteresis, deviations, parameter_set
from evpinn_ros.core.estimation.payload import PayloadDetector, SavedPayload, Stamp
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
from evpinn_ros.core.signals.sample import NO_SAMPLES, joined_samples
from evpinn_ros.core.signals.sign_detectors import GradeDetector, SignDetector
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED

SAMPLE_STEP = 0.1  # s that the first sample stands for
AT_ONCE = 256  # samples whose power is computed together
PARKED = 600.0  # s without speed, then it is another drive
SILENT_NS = NANOSECONDS  # without a measured sample, then energy is predicted


class _Ahead:
    """Samples of a block of one kind, with power of the car without the trim and its 1-sigma, W.

    Power is computed some samples ahead, by one product, and anew once the car is another.

    Attributes:
        first: place of their first among the samples of all kinds.
        rows: what the trim takes of them.
        computed: how many powers are those of the present car.
        passed: how many moments are over.
        predicted: how many are predicted; those between wait for the trim.
        ages: s since the trim last learned, of those that wait.
    """

    def __init__(self, stamps: np.ndarray, first: int, rows: np.ndarray) -> None:
        self.stamps, self.first = stamps.tolist(), first
        self.rows = rows[first : first + len(stamps)]
        self.power, self.sigma = np.zeros(len(stamps)), np.zeros(len(stamps))
        self.computed = self.passed = self.predicted = 0
        self.ages: list[float] = []

    def let_pass(self, age: float) -> None:
        """Let the next moment be over, at an age of the trim, s."""
        self.passed += 1
        self.ages.append(age)


@dataclass(frozen=True, slots=True)
class SavedPinn:
    """Everything learned of a car; `seen_ns` is the newest stamp."""

    car: CarState
    driven: Driven
    payload: SavedPayload
    grade: GradeDetector
    current_suspicion: SignDetector
    seen_ns: Stamp | None
    hills: Hills = field(default_factory=Hills)
    # Of another name than `unevenness`, a table by states that older files hold.
    uneven: Unevenness = field(default_factory=Unevenness.none)


class PinnLearner(Saveable[SavedPinn]):
    """Learner of `mode: hybrid`."""

    learns_samples = False

    def __init__(self, vehicle: Vehicle, *, seed: int = 0, keep_drives: bool = False) -> None:
        """Start at the vehicle's priors, with a network whose output is zero."""
        self._keep_drives = keep_drives
        self._equation = equation_of(vehicle, seed)
        self._trim, self._trim_age = Trim(), 0.0  # s since it was last learned
        self._sign = SignDetector()
        self._trust = TrustHysteresis()
        self._waiting: list[Interval] = []
        self._last_ns: int | None = None  # of what was learned from
        self._seen_ns: int | None = None  # of what was predicted
        self._passed = 0.0  # s that the newest predicted sample stands for
        self.gated: Counter[str] = Counter()
        self._tail, self._moments, self._in_tail = Tail(self._equation), NO_MOMENTS, 0
        self._smoothed = _Ahead(NO_SAMPLES.stamp_ns, 0, np.empty((0, 0)))
        self.begin(NO_MOMENTS)
        self._measured_ns: int | None = None  # newest measured sample
        self._trimmed = 0.0  # J that the trim gave since `_trimmed_from`
        self._trimmed_from: int | None = None
        self._before: Journey | None = None  # from the last interval measured to that sample
        # What the present car publishes, suspected or not, and its drive, once asked for.
        self._judged: tuple[bool, ParameterSet] | None
        self._together: Breakdowns | None
        self._use(LearnedCar.new(self._equation))

    def begin(self, moments: Moments) -> Predictions:
        """Begin to follow a block; gives the predictions, which `follow` fills."""
        self._extend_tail()
        self._moments, self._predictions = moments, Predictions.of(moments)
        kinds = moments.newest, moments.smoothed, moments.measured
        self._samples = joined_samples(kinds)
        rows, first = trim_rows(self._samples), 0
        self._ahead: list[_Ahead] = []
        for samples in kinds:
            self._ahead.append(_Ahead(samples.stamp_ns, first, rows))
            first += samples.size
        self._newest, self._smoothed, self._measured = self._ahead
        self._gates = gates(moments.measured, moments.power)
        self._powers, measured = moments.power.tolist(), moments.measured
        self._speeds, self._accelerations = measured.speed.tolist(), measured.acceleration.tolist()
        self._in_tail = 0  # smoothed samples of the block that are in the tail
        # Of smoothed samples: since when the battery is not measured, and s of that.
        self._dropout: list[tuple[int | None, float]] = []
        self._trims: list[float] = []  # `_trimmed` at each
        self._silent: list[int] = []
        return self._predictions

    def follow(self, first: int, last: int) -> None:
        """Let the steps from one place to before another happen: predict, and learn."""
        for kind, index in self._moments.steps[first:last]:
            if kind is Step.NEWEST:
                self._newest.let_pass(self._trim_age)
            elif kind is Step.SMOOTHED:
                self._advance(index)
                self._smoothed.let_pass(self._trim_age)
                self._follow_dropout(index)
            elif kind is Step.MEASURED:
                self._observe(index)
            else:
                if self._silent:
                    self._add_energies()
                self._measured_ns, self._before = self._moments.battery_ns[index], None
            if AT_ONCE in (len(self._newest.ages), len(self._smoothed.ages)):
                self._predict()
        if last == len(self._moments.steps):
            self._add_energies()

    def _advance(self, index: int) -> None:
        """Let time pass up to a smoothed sample.

        After a pause of `PARKED`, or before what was last seen, the road is another. It is
        another drive when the two are that far apart: a clock that is set right by some seconds
        ends none.
        """
        stamp_ns = self._smoothed.stamps[index]
        seen_ns, self._seen_ns = self._seen_ns, stamp_ns
        passed = 0.0 if seen_ns is None else (stamp_ns - seen_ns) / NANOSECONDS
        if abs(passed) > PARKED:
            self._add_energies()
            self._begin_drive(goes_on=True)
        elif passed < 0.0:
            self._add_energies()
            self._begin_tail()
            self._use(self._car.forget_road())
        self._passed = min(max(passed, 0.0), PARKED)
        self._trim_age += self._passed

    def _predict(self) -> None:
        """Predict the samples that wait."""
        kinds = self._newest, self._smoothed
        if any(ahead.passed > ahead.computed for ahead in kinds):
            self._compute()
        parts = [slice(ahead.predicted, ahead.passed) for ahead in kinds]
        rows = [ahead.rows[part] for ahead, part in zip(kinds, parts, strict=True)]
        ages = np.array([*self._newest.ages, *self._smoothed.ages])
        beside, sigma = self._trim.predict(np.concatenate(rows), ages)
        begin = 0
        predictions = self._predictions.newest, self._predictions.smoothed
        for ahead, part, of_kind in zip(kinds, parts, predictions, strict=True):
            end = begin + ahead.passed - ahead.predicted
            of_kind[part, 0] = ahead.power[part] + beside[begin:end]
            of_kind[part, 1] = np.hypot(ahead.sigma[part], sigma[begin:end])
            ahead.predicted, begin = ahead.passed, end
            ahead.ages.clear()
        self._follow_trim(beside[end - (parts[1].stop - parts[1].start) : end])

    def _follow_dropout(self, index: int) -> None:
        """Note for how long a smoothed sample stands without the battery."""
        stamp_ns, begin_ns = self._smoothed.stamps[index], self._measured_ns
        since_ns = stamp_ns if begin_ns is None else begin_ns
        if begin_ns is None or stamp_ns - begin_ns >= SILENT_NS:
            self._silent.append(index)
        seconds = min(self._passed, (stamp_ns - since_ns) / NANOSECONDS, MAX_STEP)
        self._dropout.append((begin_ns, max(0.0, seconds)))

    def _follow_trim(self, power: np.ndarray) -> None:
        """Add up what the trim gives since the battery was last measured, by power, W."""
        first = len(self._trims)
        for (begin_ns, seconds), given in zip(self._dropout[first:], power.tolist(), strict=True):
            if begin_ns != self._trimmed_from:
                self._trimmed, self._trimmed_from = 0.0, begin_ns
            self._trimmed += given * seconds
            self._trims.append(self._trimmed)

    def _observe(self, index: int) -> None:
        """Let the trim learn from a measured sample."""
        ahead, power, speed = self._measured, self._powers[index], self._speeds[index]
        ahead.predicted = index
        step = self._step(ahead.stamps[index])
        if (reason := self._gates[index]) is not None:
            self.gated[reason] += 1
            return
        self._sign = self._sign.after(speed, self._accelerations[index], power, step)
        if (fault := self._sign.detected) is not None:
            self.gated[fault] += 1
            return
        if abs(speed) < STANDSTILL_SPEED:
            return
        latest = self._smoothed.passed - 1
        if latest >= 0 and self._smoothed.stamps[latest] == ahead.stamps[index]:
            ahead, index = self._smoothed, latest  # whose power is computed anyway
        self._predict()
        if index >= ahead.computed:
            self._compute()
        residuals = power - ahead.power[index : index + 1]
        ages, self._trim_age = np.array([self._trim_age]), 0.0
        self._trim = self._trim.learned(ahead.rows[index : index + 1], residuals, ages).last()

    def add_interval(self, interval: Interval) -> bool:
        """Keep an interval for the next update."""
        if self._sign.detected:
            return False
        self._waiting.append(interval)
        return True

    def prepare_update(self) -> Callable[[], LearnedCar] | None:
        """Learn the intervals that wait, None where there are none."""
        if not self._waiting:
            return None
        car, intervals, self._waiting = self._car, self._waiting, []
        return lambda: car.after(intervals)

    def consider(self, candidate: LearnedCar) -> str | None:
        """Take the result of an update, unless it is not finite or of a drive that ended."""
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
        """Energy of this drive and of others before it, as that of one."""
        if before:
            return self._car.together(before)
        if self._together is None:
            self._together = self._car.together(())
        return self._together

    def breakdowns(self) -> Breakdowns | None:
        """Energy of this drive, and of those kept before it, by where it went."""
        return self._car.breakdowns()

    def model(self) -> CarModel:
        """The car as forecasts take it; after a restart they are of another drive."""
        car = self._car
        if self._last_ns is None and car.state.intervals:
            return car.begin_drive().model()
        return self._model

    def evidence(self) -> Evidence:
        """Likelihood of the parameters without their prior, for populations of cars."""
        return evidence_of(self._car.state, self._equation, self._car.driven)

    def report(self) -> LearnerReport:
        """Changes of payload, a current or grade of the wrong sign.

        Without current no grade can be checked.
        """
        payload, sign = self._car.payload, self._sign.detected or self._car.grade.detected
        return LearnerReport(payload.change, payload.found, payload.withdrawn, sign)

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time; keep what was learned."""
        self._waiting.clear()
        self._last_ns = None
        self._trim_age += PARKED
        self._begin_tail()
        self._use(self._car.forget_road())

    def end_drive(self) -> None:
        """Begin another drive."""
        self._begin_drive(goes_on=False)

    def _begin_drive(self, *, goes_on: bool) -> None:
        """Begin another drive; the breakdown goes on, or begins with it."""
        self.forget_window()
        self._use(self._car.begin_drive(compare=self._keep_drives, goes_on=goes_on))

    def saved(self) -> SavedPinn:
        """State to save."""
        return SavedPinn(
            car=saved_state(self._car.judged()),
            uneven=self._car.uneven(),
            hills=self._car.hills.next_drive(),
            driven=self._car.driven,
            payload=self._car.payload.saved(),
            grade=self._car.grade,
            current_suspicion=self._sign,
            seen_ns=self._seen_ns,
        )

    def take(self, saved: SavedPinn) -> None:
        """Go on from a saved state."""
        state = state_of(saved.car, self._equation)
        car = replace(
            LearnedCar.new(self._equation),
            state=state,
            unevenness=saved.uneven.possible(),
            hills=saved.hills,
            driven=saved.driven.of_this_version(),
            rehearsals=Rehearsals(Rehearsal(state)),
            payload=PayloadDetector.of(saved.payload),
            grade=saved.grade,
        )
        self._sign = saved.current_suspicion
        self._seen_ns = saved.seen_ns
        self._use(car)

    def _use(self, car: LearnedCar) -> None:
        """Use this car from now on, and the one before for all that is over."""
        self._add_energies()
        self._car, self._model = car, car.model()
        self._warmth = Warmth.after(car.state.seconds + car.dropout.seconds)
        for ahead in self._ahead:
            ahead.computed = 0
        self._judged = self._together = None

    def _compute(self) -> None:
        """Power of the car alone at the next samples of each kind, by one product for all."""
        places, model = [], self._model
        for ahead in self._ahead:
            # The last smoothed sample may be measured yet, and is learned from by the present car.
            begin = max(0, ahead.predicted - 1)
            ahead.computed = min(ahead.predicted + AT_ONCE, len(ahead.stamps))
            places.append(np.arange(ahead.first + begin, ahead.first + ahead.computed))
        samples = self._samples.where(np.concatenate(places))
        rows = self._equation.rows_of(samples, self._warmth)
        left, _, _ = wandered(self._car.dropout.seconds)
        rows[:, State.LOAD] = left
        variance = ((rows @ model.covariance) * rows).sum(axis=1)
        variance += (1.0 - left**2) * model.load_variance
        noise = POWER_NOISE**2 + FORCE_NOISE**2 * model.noise[1] * samples.speed**2
        power, sigma = rows @ model.mean, np.sqrt(np.maximum(variance, 0.0) + noise)
        begin = 0
        for ahead, of_kind in zip(self._ahead, places, strict=True):
            part = slice(ahead.computed - len(of_kind), ahead.computed)
            end = begin + len(of_kind)
            ahead.power[part], ahead.sigma[part] = power[begin:end], sigma[begin:end]
            begin = end

    def _begin_tail(self) -> None:
        """Join nothing to the samples before."""
        self._tail, self._measured_ns, self._before = Tail(self._equation), None, None
        self._in_tail = self._smoothed.passed

    def _extend_tail(self) -> None:
        """Join the smoothed samples that are over to those before."""
        end = self._smoothed.passed
        self._tail.extend(self._moments.smoothed.where(slice(self._in_tail, end)))
        self._in_tail = end

    def _add_energies(self) -> None:
        """Energies since the battery was last measured or a drive began, J, of silent samples."""
        if self._newest.ages or self._smoothed.ages:
            self._predict()
        self._extend_tail()
        silent, self._silent = self._silent, []
        if not silent:
            return
        trimmed = np.array([self._trims[index] for index in silent])
        stamps = self._moments.smoothed.stamp_ns[silent]
        car, begin_ns = self._car, self._dropout[silent[0]][0]
        if car.measured:
            driven = self._tail.between(begin_ns or 0, stamps, self._warmth)
        else:
            # Intervals begin where the battery was last known, a little before its last sample.
            if self._before is None:
                end_ns = np.array([begin_ns or 0])
                self._before = self._tail.between(car.known_ns, end_ns, self._warmth)
            driven = self._tail.between(car.end_ns, stamps, self._warmth)
            driven = driven.plus(car.dropout).less(self._before)
        energies, sigmas = self._model.predicted(driven)
        self._predictions.energies[silent] = np.column_stack((energies + trimmed, sigmas))

    def _step(self, stamp_ns: int) -> float:
        """Seconds a measured sample stands for."""
        last, self._last_ns = self._last_ns, stamp_ns
        if last is None:
            return SAMPLE_STEP
        return min(MAX_STEP, max(1e-3, (stamp_ns - last) / NANOSECONDS))


def new_learner(vehicle: Vehicle, settings: EstimatorSettings) -> PinnLearner:
    """The learner of `mode: hybrid`."""
    return PinnLearner(vehicle, seed=settings.seed, keep_drives=settings.keep_drives)
