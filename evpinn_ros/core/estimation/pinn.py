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
import math
from typing import Annotated

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
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
    unevenness_of,
)
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Warmth, equation_of
from evpinn_ros.core.estimation.trim import MOST_TRIM_EVIDENCE, Persistence, Trim, inputs_of
from evpinn_ros.core.estimation.unevenness import Unevenness
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.sample import NO_SAMPLES, Samples
from evpinn_ros.core.signals.sign_detectors import GradeDetector, SignDetector
from evpinn_ros.core.vehicle.files import Vehicle

SAMPLE_STEP = 0.1  # s that the first sample stands for
AT_ONCE = 256  # samples whose power is computed together
NO_ENERGY = (math.nan, math.nan)
PARKED = 600.0  # s without speed, then it is another drive
SILENT_NS = NANOSECONDS  # without a measured sample, then energy is predicted


class _Ahead:
    """Power of the car without the trim at samples, W, and its 1-sigma with noise, W.

    They are computed some samples ahead, by one product, and anew once the car is another.
    """

    def __init__(self, samples: Samples) -> None:
        self.samples, self.inputs = samples, list(inputs_of(samples)) if samples.size else []
        self.speed, self.stamps = samples.speed.tolist(), samples.stamp_ns.tolist()
        self.power, self.sigma = [0.0] * samples.size, [0.0] * samples.size
        self.computed = 0  # so many of them are


@dataclass(frozen=True, slots=True)
class SavedPinn:
    """Everything learned of a car; `trim` is its evidence, `seen_ns` the newest stamp."""

    car: CarState
    unevenness: Unevenness
    driven: Driven
    payload: SavedPayload
    grade: GradeDetector
    current_suspicion: SignDetector
    trim: Annotated[float, Range(-MOST_TRIM_EVIDENCE, MOST_TRIM_EVIDENCE)]
    seen_ns: Stamp | None
    persistence: Persistence
    hills: Hills = field(default_factory=Hills)


class PinnLearner(Saveable[SavedPinn]):
    """Learner of `mode: hybrid`."""

    learns_samples = False

    def __init__(self, vehicle: Vehicle, *, seed: int = 0, keep_drives: bool = False) -> None:
        """Start at the vehicle's priors, with a network whose output is zero."""
        self._keep_drives = keep_drives
        self._equation = equation_of(vehicle, seed)
        self._trim = Trim(seed)
        self._sign = SignDetector()
        self._trust = TrustHysteresis()
        self._waiting: list[Interval] = []
        self._last_ns: int | None = None  # of what was learned from
        self._seen_ns: int | None = None  # of what was predicted
        self._passed = 0.0  # s that the newest predicted sample stands for
        self.gated: Counter[str] = Counter()
        self._tail = Tail(self._equation)
        self.begin(NO_MOMENTS)
        self._measured_ns: int | None = None  # newest measured sample
        self._trimmed = 0.0  # J that the trim gave since then
        self._before: Journey | None = None  # from the last interval measured to that sample
        # What the present car publishes, suspected or not, once asked for.
        self._judged: tuple[bool, ParameterSet] | None
        self._use(LearnedCar.new(self._equation))

    def begin(self, moments: Moments) -> Predictions:
        """Begin to follow a block; gives the predictions, which `follow` fills."""
        self._moments, self._predictions = moments, Predictions()
        self._newest, self._smoothed = _Ahead(moments.newest), _Ahead(moments.smoothed)
        self._measured = _Ahead(moments.measured)
        self._gates = gates(moments.measured, moments.power)
        self._powers = moments.power.tolist()
        self._accelerations = moments.measured.acceleration.tolist()
        self._in_tail = 0  # smoothed samples of the block that are in the tail
        self._silent: list[tuple[int, int | None, float]] = []
        return self._predictions

    def follow(self, first: int, last: int) -> None:
        """Let the steps from one place to before another happen: predict, and learn."""
        predictions = self._predictions
        for kind, index in self._moments.steps[first:last]:
            if kind is Step.NEWEST:
                predictions.newest.append(self._predicted(self._newest, index)[0])
            elif kind is Step.SMOOTHED:
                self._advance(index)
                prediction, correction = self._predicted(self._smoothed, index)
                predictions.smoothed.append(prediction)
                predictions.energies.append(NO_ENERGY)
                self._follow_dropout(index, correction)
            elif kind is Step.MEASURED:
                self._observe(index)
            else:
                if self._silent:
                    self._add_energies()
                self._measured_ns = self._moments.battery_ns[index]
                self._before, self._trimmed = None, 0.0
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
        self._trim.advance(self._passed)

    def _predicted(self, ahead: _Ahead, index: int) -> tuple[tuple[float, float], float]:
        """Power of car and trim with its 1-sigma, W, and the trim's share of it, W."""
        if index >= ahead.computed:
            done, seen = len(self._predictions.newest), len(self._predictions.smoothed)
            # The last smoothed sample may be measured yet, and is learned from by the present car.
            self._compute((self._newest, done), (self._smoothed, max(0, seen - 1)))
        correction = self._trim.correct(ahead.inputs[index], ahead.speed[index])
        power = ahead.power[index] + correction.power
        return (power, math.hypot(ahead.sigma[index], correction.sigma)), correction.power

    def _follow_dropout(self, index: int, correction: float) -> None:
        """Follow what the trim gives since the battery was last measured, W."""
        stamp_ns, begin_ns = self._smoothed.stamps[index], self._measured_ns
        if begin_ns is not None and stamp_ns > begin_ns:
            since = (stamp_ns - begin_ns) / NANOSECONDS
            self._trimmed += correction * min(self._passed, since, MAX_STEP)
        if begin_ns is None or stamp_ns - begin_ns >= SILENT_NS:
            self._silent.append((index, begin_ns, self._trimmed))

    def _observe(self, index: int) -> None:
        """Let the trim learn from a measured sample."""
        ahead, power = self._measured, self._powers[index]
        step = self._step(ahead.stamps[index])
        if (reason := self._gates[index]) is not None:
            self.gated[reason] += 1
            return
        speed = ahead.speed[index]
        self._sign = self._sign.after(speed, self._accelerations[index], power, step)
        if (fault := self._sign.detected) is not None:
            self.gated[fault] += 1
            return
        latest = len(self._predictions.smoothed) - 1
        if latest >= 0 and self._smoothed.stamps[latest] == ahead.stamps[index]:
            ahead, index = self._smoothed, latest  # whose output the trim has
        if index >= ahead.computed:
            self._compute((ahead, index))
        self._trim.learn(ahead.inputs[index], speed, power - ahead.power[index], step)

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

    def together(self, before: Sequence[EndedDrive]) -> Breakdowns | None:
        """Energy of this drive and of others before it, as that of one."""
        return self._car.together(before)

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
        self._trim.advance(PARKED)
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
            unevenness=self._car.uneven(),
            hills=self._car.hills.next_drive(),
            driven=self._car.driven,
            payload=self._car.payload.saved(),
            grade=self._car.grade,
            current_suspicion=self._sign,
            trim=self._trim.evidence,
            seen_ns=self._seen_ns,
            persistence=replace(self._trim.persistence),
        )

    def take(self, saved: SavedPinn) -> None:
        """Go on from a saved state."""
        state = state_of(saved.car, self._equation)
        car = replace(
            LearnedCar.new(self._equation),
            state=state,
            unevenness=unevenness_of(saved.unevenness, self._equation),
            hills=saved.hills,
            driven=saved.driven,
            rehearsals=Rehearsals(Rehearsal(state)),
            payload=PayloadDetector.of(saved.payload),
            grade=saved.grade,
        )
        self._sign = saved.current_suspicion
        self._trim.evidence, self._seen_ns = saved.trim, saved.seen_ns
        self._trim.persistence = replace(saved.persistence)
        self._use(car)

    def _use(self, car: LearnedCar) -> None:
        """Use this car from now on."""
        self._car, self._model = car, car.model()
        self._warmth = Warmth.after(car.state.seconds + car.dropout.seconds)
        for ahead in (self._newest, self._smoothed, self._measured):
            ahead.computed = 0
        self._judged = None

    def _compute(self, *wanted: tuple[_Ahead, int]) -> None:
        """Power of the car alone at the next samples of each kind, by one product for all."""
        parts = [(ahead, slice(first, first + AT_ONCE)) for ahead, first in wanted]
        samples, model = NO_SAMPLES, self._model
        for ahead, part in parts:
            samples = samples.and_then(ahead.samples.where(part))
        rows = self._equation.rows_of(samples, self._warmth)
        left, _, _ = wandered(self._car.dropout.seconds)
        rows[:, State.LOAD] = left
        variance = np.einsum("ij,ij->i", rows @ model.covariance, rows)
        variance += (1.0 - left**2) * model.load_variance
        noise = POWER_NOISE**2 + FORCE_NOISE**2 * model.noise[1] * samples.speed**2
        power, sigma = rows @ model.mean, np.sqrt(np.maximum(variance, 0.0) + noise)
        begin = 0
        for ahead, part in parts:
            ahead.computed = min(part.stop, ahead.samples.size)
            of_kind = slice(begin, begin + ahead.computed - part.start)
            ahead.power[part], ahead.sigma[part] = power[of_kind].tolist(), sigma[of_kind].tolist()
            begin = of_kind.stop

    def _begin_tail(self) -> None:
        """Join nothing to the samples before."""
        self._tail, self._trimmed = Tail(self._equation), 0.0
        self._measured_ns, self._before = None, None

    def _add_energies(self) -> None:
        """Energies since the battery was last measured or a drive began, J, of silent samples.

        All samples so far are in the tail then.
        """
        end = len(self._predictions.smoothed)
        self._tail.extend(self._moments.smoothed.where(slice(self._in_tail, end)))
        self._in_tail = end
        silent, self._silent = self._silent, []
        if not silent:
            return
        places, begins, trimmed = zip(*silent, strict=True)
        stamps = self._moments.smoothed.stamp_ns[list(places)]
        car, begin_ns = self._car, begins[0]
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
        rows = zip(places, (energies + trimmed).tolist(), sigmas.tolist(), strict=True)
        for place, energy, sigma in rows:
            self._predictions.energies[place] = energy, sigma

    def _step(self, stamp_ns: int) -> float:
        """Seconds a measured sample stands for."""
        last, self._last_ns = self._last_ns, stamp_ns
        if last is None:
            return SAMPLE_STEP
        return min(MAX_STEP, max(1e-3, (stamp_ns - last) / NANOSECONDS))


def new_learner(vehicle: Vehicle, settings: EstimatorSettings) -> PinnLearner:
    """The learner of `mode: hybrid`."""
    return PinnLearner(vehicle, seed=settings.seed, keep_drives=settings.keep_drives)
