"""`mode: hybrid`: one physics-informed network of a car, learned online.

Battery power is P = P_physics(x) + v N(u; w): eq. 12-21 with the states of the car (`car_state`)
and a tanh network (`residual_network`) under a physics prior. The states are learned from energies
of intervals (the weak form), the weights from what physics leaves at each sample. The states are
conditioned once a second on the intervals that ended in it, in a thread beside the callbacks; the
same filter solved again over a window of the last minute, linearised anew, was measured and gains
nothing. The network's weights return to their prior within ten seconds: its sliding window.

What is unseen of the road is the network's part in power. During a battery dropout the network
fades and the energy of the intervals, with the exact heights and speeds of the weak form, leads:
power is corrected, slowly, by what it missed.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import Annotated

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.estimation.breakdown import Breakdowns
from evpinn_ros.estimation.calibration import Chance
from evpinn_ros.estimation.car_filter import CarFilter, SavedFilter, lasting
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.energy_debt import MAX_STEP, EnergyDebt
from evpinn_ros.estimation.estimate import ParameterSet
from evpinn_ros.estimation.evidence import Evidence
from evpinn_ros.estimation.forecast_model import linear_power
from evpinn_ros.estimation.gaussian import Gaussian
from evpinn_ros.estimation.grade_detector import GRADE_SIGN, GradeSuspicion, SavedGradeSuspicion
from evpinn_ros.estimation.interval_noise import STANDING_NOISE
from evpinn_ros.estimation.learner import LearnerReport, PowerPrediction, gate, gate_interval
from evpinn_ros.estimation.parameter_set import StateHysteresis, deviations, parameter_set
from evpinn_ros.estimation.payload import PayloadDetector, SavedPayload, Stamp
from evpinn_ros.estimation.published import EnergySums, evidence_of, published
from evpinn_ros.estimation.rehearsal import Rehearsal
from evpinn_ros.estimation.reported_loads import ReportedLoads, SavedLoads
from evpinn_ros.estimation.residual_network import (
    MOST_EVIDENCE,
    Persistence,
    ResidualNetwork,
)
from evpinn_ros.estimation.weak_form import spent, unit_step
from evpinn_ros.signals.interval import Interval
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.signals.sign_detectors import CURRENT_SIGN, SavedSignSuspicion, SignSuspicion
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.linear_power import LinearPower
from evpinn_ros.vehicle.physics import GRAVITY

SAMPLE_STEP = 0.1  # s that the first sample stands for
POWERS_KEPT = 20  # latest predictions of the physics, of samples whose battery is yet to come
PARKED = 600.0  # s without speed, then it is another drive


class LearnedCar:
    """Everything learned of a car from intervals, as one value that an update replaces.

    Attributes:
        filter: the states of car and drive.
        sums: energies that the published parameters stand for.
        rehearsal: how far the sigma of a dropout's energy is to be trusted.
        payload: changes of payload.
        grade: sign of the reported grade.
        loads: what the car reports of heating and cooling.
        gated: intervals not learned from, by reason.
        end_ns: of the last interval.
        known_ns: up to where the battery was measured: before `end_ns` during a dropout.
        stretches: of road and drives begun so far; what began meanwhile outdates an update.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        """Start at the priors of a vehicle file."""
        self.filter, self.sums, self.rehearsal = CarFilter(vehicle), EnergySums(), Rehearsal()
        self.payload, self.grade, self.loads = PayloadDetector(), GradeSuspicion(), ReportedLoads()
        self.gated: Counter[str] = Counter()
        self.end_ns = self.known_ns = self.stretches = 0

    def after(self, intervals: list[Interval]) -> LearnedCar:
        """The car after some more intervals; this one is left as it is."""
        other = object.__new__(LearnedCar)
        other.filter, other.payload = self.filter.copy(), self.payload.copy()
        other.rehearsal = self.rehearsal.copy()
        other.sums = replace(self.sums)
        other.grade, other.loads = GradeSuspicion(), ReportedLoads()
        other.grade.take(self.grade.saved())
        other.loads.take(self.loads.saved())
        other.gated = Counter()
        other.end_ns, other.known_ns = self.end_ns, self.known_ns
        other.stretches = self.stretches
        for interval in intervals:
            other.learn(interval)
        return other

    def learn(self, interval: Interval) -> None:
        """Take one more interval, its battery measured or not."""
        conditions = interval.conditions
        self.loads.add(conditions.load, conditions.celsius, interval.duration)
        reason = gate_interval(interval)
        if reason is not None:
            self.gated[reason] += 1
            return
        found = spent(
            self.filter.state.mean,
            interval.steps,
            conditions,
            self.filter.warmth,
            self.filter.constants,
        )
        self.rehearsal.learn(self.filter, interval)
        learned = self.filter.learn(interval)
        if self.measured:  # before it; a gap between two intervals is not accounted for
            self.known_ns = interval.start_ns
        self.end_ns = interval.end_ns
        if learned is None:
            return
        self.known_ns = interval.end_ns
        self.sums.add(interval, found, self.filter.weights, self.filter.warmth.tyres)
        mean = self.filter.mixture().mean
        weight = GRAVITY * math.exp(mean[State.MASS] - mean[State.ETA])
        self.grade.learn(interval, learned.residual, weight)
        self.filter = self.payload.learn(self.filter, self.sums, interval)

    def breakdowns(self) -> Breakdowns | None:
        """Energy of this drive, and of those kept before it, by where it went."""
        car = self.filter
        if car.parts is None:
            return None
        weight = GRAVITY * math.exp(car.mixture().mean[State.MASS])
        return car.parts.breakdowns(car.weights, weight, car.hilliness)

    @property
    def measured(self) -> bool:
        """True while no energy is predicted without a battery."""
        return self.known_ns == self.end_ns

    def forget_road(self) -> None:
        """After a jump of time: another place on the road, and the car may have stood."""
        self.stretches += 1
        self.payload.forget_time()
        self.rehearsal.end()
        self.filter.forget_road()
        self.known_ns = self.end_ns

    def begin_drive(self, keep: bool = False, *, goes_on: bool = False) -> None:
        """Another drive of this car; `keep` and `goes_on` as in `CarFilter.begin_drive`."""
        self.stretches += 1
        self.loads.end_drive()
        self.rehearsal.end()
        self.filter.begin_drive(keep, goes_on=goes_on)
        self.sums.begin_drive()
        self.payload.forget_time()

    def is_finite(self) -> bool:
        """True if every number is finite."""
        state = self.filter.state
        return bool(np.isfinite(state.mean).all() and np.isfinite(state.covariance).all())


@dataclass(frozen=True, slots=True)
class SavedPinn:
    """Everything learned of a car; `network` is its evidence, `seen_ns` the newest stamp."""

    filter: SavedFilter
    energies: EnergySums
    payload: SavedPayload
    rehearsals: Chance
    loads: SavedLoads
    grade_suspicion: SavedGradeSuspicion
    current_suspicion: SavedSignSuspicion
    network: Annotated[float, Range(-MOST_EVIDENCE, MOST_EVIDENCE)]
    seen_ns: Stamp | None
    persistence: Persistence


class PinnLearner(Saveable[SavedPinn]):
    """See the module's text."""

    def __init__(self, vehicle: Vehicle, *, seed: int = 0, keep_drives: bool = False) -> None:
        """Start at the vehicle's priors, with a network whose output is zero."""
        self._vehicle, self._keep_drives = vehicle, keep_drives
        self._network = ResidualNetwork(seed)
        self._suspicion = SignSuspicion()
        self._states = StateHysteresis()
        self._waiting: list[Interval] = []
        self._last_ns: int | None = None  # of what was learned from
        self._seen_ns: int | None = None  # of what was predicted
        self._debt = EnergyDebt()
        self._powers: deque[tuple[Sample, float]] = deque(maxlen=POWERS_KEPT)
        self.gated: Counter[str] = Counter()
        self._use(LearnedCar(vehicle))

    def advance(self, sample: Sample) -> None:
        """Let time pass up to a smoothed sample.

        After a pause of `PARKED`, or before what was last seen, the road is another. It is
        another drive when the two are that far apart: a clock that is set right by some seconds
        ends none.
        """
        seen_ns, self._seen_ns = self._seen_ns, sample.stamp_ns
        passed = 0.0 if seen_ns is None else (sample.stamp_ns - seen_ns) / NANOSECONDS
        if abs(passed) > PARKED:
            self._begin_drive(goes_on=True)
        elif passed < 0.0:
            self._car.forget_road()
        self._network.advance(min(max(passed, 0.0), PARKED))

    def predict(self, sample: Sample) -> PowerPrediction:
        """Power of physics and network, W, and of the energy since the battery, 1-sigma, J."""
        power, of_car = self._physics(sample)
        if not sample.newest:
            self._powers.append((sample, power))
        correction = self._network.correct(sample)
        power += correction.power
        noise = self._car.filter.force_noise() * sample.speed
        sigma = math.hypot(of_car, noise, STANDING_NOISE, correction.sigma)
        if sample.newest:
            return PowerPrediction(power, sigma)
        power += self._debt.repay(sample.stamp_ns, power, of_car)
        if self._car.measured:
            return PowerPrediction(power, sigma)
        energy, energy_sigma = self._unmeasured
        since = self._debt.sigma_since(self._car.end_ns) * self._car.rehearsal.chance.scale
        return PowerPrediction(power, sigma, energy, math.hypot(energy_sigma, since))

    def observe(self, sample: Sample, power: float) -> None:
        """Let the network learn from a measured sample."""
        step = self._step(sample)
        reason = gate(sample, power)
        if reason is not None:
            self.gated[reason] += 1
            return
        self._suspicion.update(sample, power, step)
        if self._suspicion.suspected:
            self.gated[CURRENT_SIGN] += 1
            return
        self._network.learn(sample, power - self._power(sample), step)

    def add_interval(self, interval: Interval) -> bool:
        """Keep an interval for the next update."""
        if self._suspicion.suspected:
            return False
        self._waiting.append(interval)
        return True

    def prepare_update(self) -> Callable[[], LearnedCar] | None:
        """Condition a copy of the car on the intervals that wait, None where there are none."""
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
        energy = 0.0 if candidate.measured else self._unmeasured[0]
        self._debt.owe(candidate.known_ns, candidate.end_ns, energy)
        return None

    def parameters(self) -> ParameterSet:
        """Present estimate of the parameters, in the sense of eq. 12-21."""
        found = published(self._car.filter, self._car.sums)
        now = parameter_set(self._last_ns or 0, found)
        return self._states.judge(now, deviations(found), suspected=self._suspicion.suspected)

    def breakdowns(self) -> Breakdowns | None:
        """Energy of this drive, and of those kept before it, by where it went."""
        return self._car.breakdowns()

    def linear_power(self, celsius: float | None) -> LinearPower:
        """Linear power model of the car for forecasts."""
        return linear_power(self._car.filter, self._car.loads, self._vehicle, celsius)

    def evidence(self) -> Evidence:
        """Likelihood of the parameters without their prior, for populations of cars."""
        return evidence_of(self._car.filter, self._car.sums)

    def report(self) -> LearnerReport:
        """Changes of payload, a current or grade of the wrong sign."""
        payload = self._car.payload
        return LearnerReport(payload.change, payload.found, payload.withdrawn, self._suspected())

    def forget_window(self) -> None:
        """Drop recent samples after a jump of time; keep what was learned."""
        self._waiting.clear()
        self._last_ns = None
        self._network.advance(PARKED)
        self._car.forget_road()
        self._debt = EnergyDebt()
        self._use(self._car)

    def end_drive(self) -> None:
        """Begin another drive."""
        self._begin_drive(goes_on=False)

    def _begin_drive(self, *, goes_on: bool) -> None:
        """Likewise; the breakdown goes on, or begins with it."""
        self.forget_window()
        self._car.begin_drive(self._keep_drives, goes_on=goes_on)
        self._use(self._car)

    def saved(self) -> SavedPinn:
        """State to save."""
        return SavedPinn(
            filter=self._car.filter.saved(),
            energies=self._car.sums,
            payload=self._car.payload.saved(),
            rehearsals=self._car.rehearsal.chance,
            loads=self._car.loads.saved(),
            grade_suspicion=self._car.grade.saved(),
            current_suspicion=self._suspicion.saved(),
            network=self._network.evidence,
            seen_ns=self._seen_ns,
            persistence=replace(self._network.persistence),
        )

    def take(self, saved: SavedPinn) -> None:
        """Go on from a saved state."""
        car = LearnedCar(self._vehicle)
        car.filter.take(saved.filter)
        car.payload.take(saved.payload)
        car.loads.take(saved.loads)
        car.grade.take(saved.grade_suspicion)
        car.sums, car.rehearsal.chance = saved.energies, saved.rehearsals
        self._suspicion.take(saved.current_suspicion)
        self._network.evidence, self._seen_ns = saved.network, saved.seen_ns
        self._network.persistence = replace(saved.persistence)
        self._use(car)

    def _use(self, car: LearnedCar) -> None:
        """Use this car from now on; its mixture is what samples are predicted by."""
        self._car = car
        self._powers.clear()
        mean, covariance = car.filter.mixture()
        # What is unseen of this place is the network's part: here it would count twice.
        self._mixture = Gaussian(lasting(mean), covariance)
        self._unmeasured = (math.nan, math.nan)
        if not car.measured:
            energy, sigma = car.filter.unmeasured()
            self._unmeasured = (energy, sigma * car.rehearsal.chance.scale)

    def _physics(self, sample: Sample) -> tuple[float, float]:
        """Power of the physics alone, W, and its 1-sigma by the states, W."""
        mean, covariance = self._mixture
        steps, conditions = unit_step(sample)
        filter_ = self._car.filter
        found = spent(mean[None], steps, conditions, filter_.warmth, filter_.constants)
        gradient = found.gradient[0]
        gradient[State.SLOPE] = gradient[State.CLIMB] * abs(sample.speed)
        gradient[State.CLIMB] = 0.0
        variance = float(gradient @ covariance @ gradient)
        return float(found.energy[0]), math.sqrt(max(variance, 0.0))

    def _power(self, sample: Sample) -> float:
        """Power of the physics alone, W, that of the prediction where the car is the same."""
        for predicted, power in self._powers:
            if predicted is sample:
                return power
        return self._physics(sample)[0]

    def _suspected(self) -> str | None:
        """Signal whose sign the data contradict; without current no grade can be checked."""
        if self._suspicion.suspected:
            return CURRENT_SIGN
        return GRADE_SIGN if self._car.grade.suspected else None

    def _step(self, sample: Sample) -> float:
        """Seconds this sample stands for."""
        last, self._last_ns = self._last_ns, sample.stamp_ns
        if last is None:
            return SAMPLE_STEP
        return min(MAX_STEP, max(1e-3, (sample.stamp_ns - last) / NANOSECONDS))
