"""Everything learned of a car from intervals, as one value.

`after` gives the car after some more intervals and leaves this one as it is, so an update can be
computed in a thread beside the callbacks, and its result can be dropped.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np

from evpinn_ros.core.estimation.bands import Hills
from evpinn_ros.core.estimation.breakdown import Breakdowns, DriveParts, EndedDrive, breakdowns
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.even import Path
from evpinn_ros.core.estimation.journey import NOWHERE, Journey
from evpinn_ros.core.estimation.learner import gate_interval
from evpinn_ros.core.estimation.payload import Payload
from evpinn_ros.core.estimation.posterior import (
    OUTLIER,
    CarState,
    advance,
    begin_drive,
    forget_present,
    forget_road,
    initial_state,
    interval_terms,
    learn,
)
from evpinn_ros.core.estimation.published import Driven
from evpinn_ros.core.estimation.rehearsal import Rehearsal, Rehearsals
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Equation, coldness
from evpinn_ros.core.estimation.unevenness import Unevenness
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.signals.sign_detectors import GradeDetector
from evpinn_ros.core.vehicle.physics import GRAVITY

MOST_INTERVALS = 5000  # of one drive that unevenness is learned from, fourteen hours
# Compared drives share none of their offsets.
KEPT_WHEN_COMPARED = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LearnedCar:
    """Everything learned of a car from intervals.

    Attributes:
        equation: of the car.
        state: the posterior.
        driven: sums over driving, to which the published parameters are fitted.
        rehearsals: predictions under way whose errors will scale the bands.
        parts: energy of this drive by part.
        ended: parts of earlier drives, if kept for comparison, and of this drive before a long
            stop; each after the number of its drive.
        number: of this drive.
        payload: of this drive against the drive before.
        grade: sign of the reported grade.
        unevenness: energy of uneven speed beyond even speed, by ended drives.
        hills: net climbs of drives with known heights.
        steps: of this drive, from which `unevenness` is learned at its end.
        dropout: driving since the battery was last measured.
        end_ns: end of the last interval.
        known_ns: end of measured energy: `end_ns`, in a dropout less.
        stretches: number of roads and drives begun; one begun meanwhile outdates an update.
        gated: intervals not learned from in this update, by reason.
    """

    equation: Equation
    state: CarState
    driven: Driven
    rehearsals: Rehearsals
    parts: DriveParts = field(default_factory=DriveParts.none)
    ended: tuple[tuple[int, EndedDrive], ...] = ()
    number: int = 0
    payload: Payload = field(default_factory=Payload)
    grade: GradeDetector = field(default_factory=GradeDetector)
    unevenness: Unevenness = field(default_factory=Unevenness.none)
    hills: Hills = field(default_factory=Hills)
    steps: tuple[Path, ...] = ()
    dropout: Journey = NOWHERE
    end_ns: int = 0
    known_ns: int = 0
    stretches: int = 0
    gated: Counter[str] = field(default_factory=Counter)

    @classmethod
    def new(cls, equation: Equation) -> LearnedCar:
        """A car before its first drive."""
        state = initial_state(equation)
        return cls(equation, state, Driven.nowhere(), Rehearsals(Rehearsal(state)))

    @property
    def measured(self) -> bool:
        """True while no energy is predicted without a battery."""
        return self.known_ns == self.end_ns

    def after(self, intervals: Iterable[Interval]) -> LearnedCar:
        """The car after some more intervals."""
        car = replace(self, gated=Counter())
        for interval in intervals:
            if math.isnan(interval.energy):
                car = car._without(interval)
            elif (reason := gate_interval(interval)) is not None:
                car.gated[reason] += 1
            else:
                car = car._with(interval)
        return car

    def model(self) -> CarModel:
        """The car for predictions from here on, with the unevenness of the drives that ended."""
        model = self.state.model(self.equation)
        growth = max(model.growth, self.hills.growth)
        return replace(model, growth=growth, unevenness=self.unevenness)

    def drive(self) -> tuple[EndedDrive, ...]:
        """Parts of this drive so far, as functions of the states of the car alone."""
        before_stops = [parts for number, parts in self.ended if number == self.number]
        return (*before_stops, self.parts.ended(self.state))

    def together(self, before: Sequence[EndedDrive]) -> Breakdowns:
        """Breakdown of this drive and of others before it, summed."""
        drives = (*before, *self.drive()[:-1])
        of_drives = breakdowns(drives, self.parts, self.state, self.equation)
        return of_drives.joined([0] * len(of_drives.drives)).possible()

    def breakdowns(self) -> Breakdowns:
        """Breakdowns of the drives that were kept, and of this one, last."""
        drives = [parts for _, parts in self.ended]
        of_drives = breakdowns(drives, self.parts, self.state, self.equation)
        owners = [*(number for number, _ in self.ended), self.number]
        return of_drives.joined(owners).possible()

    def forget_road(self) -> LearnedCar:
        """The car after a jump of time: at another place, and it may have stood."""
        state = forget_road(self._after_dropout())
        return replace(
            self,
            state=state,
            rehearsals=replace(self.rehearsals, dropouts={}),
            dropout=NOWHERE,
            known_ns=self.end_ns,
            stretches=self.stretches + 1,
        )

    def begin_drive(self, *, compare: bool = False, goes_on: bool = False) -> LearnedCar:
        """The car at the begin of another drive.

        Args:
            compare: keep the parts of earlier drives for comparison, and no offset.
            goes_on: continue the breakdown, as over a long stop in a recording.
        """
        car = self.forget_road()
        ended, number = self.ended, self.number
        if self.parts.totals.seconds:
            ended = (*ended, (number, self.parts.ended(car.state)))
        if not goes_on and any(ended_number == number for ended_number, _ in ended):
            number += 1
        if not (compare or goes_on):
            ended, number = (), 0
        keep = KEPT_WHEN_COMPARED if compare else 1.0
        state = begin_drive(car.judged(), self.equation, keep=keep)
        return replace(
            car,
            state=state,
            driven=self.driven.next_drive(),
            payload=self.payload.next_drive(self.state, self.equation),
            unevenness=self.uneven(),
            hills=self.hills.next_drive(),
            steps=(),
            rehearsals=Rehearsals(Rehearsal(state)),
            parts=DriveParts.none(),
            ended=ended,
            number=number,
        )

    def uneven(self) -> Unevenness:
        """`unevenness` with this drive."""
        if not self.steps:
            return self.unevenness
        mean = self.state.weights @ self.state.mean
        drive = Path(*map(np.concatenate, zip(*self.steps, strict=True)))
        return self.unevenness.after(self.equation, mean, drive)

    def judged(self) -> CarState:
        """The state with the error of this drive in its bands, as if it ended here."""
        return self.rehearsals.end_drive(self.state, self.equation)

    def is_finite(self) -> bool:
        """True if every number is finite."""
        mean, covariance = self.state.gaussian
        return bool(np.isfinite(mean).all() and np.isfinite(covariance).all())

    def _without(self, interval: Interval) -> LearnedCar:
        """The car after an interval whose battery was not measured."""
        seconds = self.state.seconds + self.dropout.seconds
        return replace(
            self._along(interval),
            dropout=self.dropout.plus(interval_terms(self.equation, interval, seconds).journey),
            rehearsals=replace(self.rehearsals, dropouts={}),
            known_ns=interval.start_ns if self.measured else self.known_ns,
        )

    def _with(self, interval: Interval) -> LearnedCar:
        """The car after an interval whose battery was measured."""
        equation, before = self.equation, self._after_dropout()
        terms = interval_terms(equation, interval, before.seconds)
        way, planned = abs(interval.distance), terms.journey
        if interval.steps.motor_known:  # no plan knows it
            by_speed = replace(interval, steps=interval.steps.without_motor)
            planned = interval_terms(equation, by_speed, before.seconds).journey
        rehearsals, bands = self.rehearsals.learn(
            before, equation, terms.journey, planned, way, interval.energy
        )
        before = replace(before, bands=bands)
        state, learned = learn(before, equation, terms)
        driven = self.driven.plus(terms)
        cold = coldness(interval.conditions.celsius)
        parts = equation.split(terms.rows, terms.wheels, cold, terms.warmth.tyres)
        noise = float(state.weights @ state.scale @ terms.journey.noise)
        noise += max(0.0, (learned.residual / OUTLIER) ** 2 - learned.sigma**2)  # an outlier
        weight = GRAVITY * float(state.weights @ state.mean[:, State.MASS_OVER_ETA])  # over eta, N
        return replace(
            self._along(interval),
            state=state,
            driven=driven,
            rehearsals=rehearsals,
            parts=self.parts.plus(interval, parts, noise),
            payload=self.payload.after(state, equation, interval.start_ns),
            grade=self.grade.after(interval, learned.residual, weight),
            dropout=NOWHERE,
            known_ns=interval.end_ns,
        )

    def _along(self, interval: Interval) -> LearnedCar:
        """The car after the road of one more interval."""
        steps, hills = interval.steps, self.hills
        ones = np.ones(len(steps.duration))
        path = Path(*steps[:5], interval.conditions.air_density * ones, 0.0 * ones)
        if interval.height_known:
            hills = hills.plus(abs(interval.distance), float(steps.climb.sum()))
        newest = (*self.steps, path)[-MOST_INTERVALS:]
        return replace(self, steps=newest, hills=hills, end_ns=interval.end_ns)

    def _after_dropout(self) -> CarState:
        """The state after a dropout: time has passed, and its energy is in no sum."""
        if self.dropout.seconds == 0.0:
            return self.state
        return forget_present(advance(self.state, self.dropout.seconds))
