"""Baselines: the prior alone, energy per kilometre, least squares, a fast Kalman filter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
import math

import numpy as np

from benchmarks.unseen.kalman import FiveStateFilter
from benchmarks.unseen.method import Estimate, Factory, Prediction
from benchmarks.unseen.steps import DrivingStep, StepStream
from benchmarks.unseen.weak_form import WeakFormLeastSquares
from evpinn_ros.core.estimation.journey import NOWHERE, Journey, standing, unexplained
from evpinn_ros.core.estimation.size import model_of_file
from evpinn_ros.core.estimation.terms import Warmth
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.signals.readings import NANOSECONDS, Reading
from evpinn_ros.core.signals.road import Conditions
from evpinn_ros.core.signals.sample import Sample
from evpinn_ros.core.vehicle.files import Vehicle

LEAST_DISTANCE = 1000.0  # m, below which the prior is used for the energy of a kilometre
MOVING = 0.3  # m/s, below which acceleration is not used


class StepMethod(ABC):
    """Predicts each step, and learns from it once its power is known, as subclasses define."""

    pairs = True

    def __init__(self, vehicle: Vehicle) -> None:
        self._stream = StepStream(vehicle)

    def add_reading(self, reading: Reading) -> Iterable[Prediction]:
        """Predict or learn the steps that a reading completes."""
        for step in self._stream.add_reading(reading):
            if math.isnan(step.power):
                yield self.predict(step)
            else:
                self.learn(step)

    def begin_next_drive(self) -> None:
        """Join nothing to what was before."""
        self._stream.begin_next_drive()

    def combinations(self) -> Mapping[str, Estimate]:
        """Nothing is known of the car's parameters."""
        return {}

    @abstractmethod
    def predict(self, step: DrivingStep) -> Prediction:
        """Power of a step."""

    @abstractmethod
    def learn(self, step: DrivingStep) -> None:
        """Learn from a step whose power is known."""


class PriorAlone(StepMethod):
    """The vehicle file alone: a new car of our own model, with temperature and reported loads."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._model, self._begin_ns, self._unmeasured = model_of_file(vehicle), 0, NOWHERE

    def begin_next_drive(self) -> None:
        """The car is cold again, as ours is."""
        super().begin_next_drive()
        self._begin_ns, self._unmeasured = 0, NOWHERE

    def learn(self, step: DrivingStep) -> None:
        """Keep the prior."""
        self._unmeasured = NOWHERE

    def predict(self, step: DrivingStep) -> Prediction:
        """Power of the prior car, W, and the 1-sigma of its energy."""
        journey = self._journey(step)
        self._unmeasured = self._unmeasured.plus(journey)
        _, sigma = self._model.predicted(self._unmeasured)
        return Prediction(step.middle_ns, self.power(step, journey), energy_sigma=float(sigma))

    def power(self, step: DrivingStep, journey: Journey | None = None) -> float:
        """Power of the prior car over a step, W."""
        return float((journey or self._journey(step)).row @ self._model.mean) / step.dt

    def _journey(self, step: DrivingStep) -> Journey:
        self._begin_ns = self._begin_ns or step.begin_ns
        dt, way = step.dt, step.speed * step.dt
        moved = dt, way, step.cube * dt, step.kinetic * dt, step.climb * dt
        conditions = Conditions(step.density, 0.0, step.celsius, step.known, step.known > 0.0)
        warmth = Warmth.after((step.middle_ns - self._begin_ns) / NANOSECONDS)
        steps = Steps(*np.array(moved)[:, None])
        row = self._model.equation.rows(steps, conditions, warmth)[0]
        stood, square = standing(dt, way), way**2 / dt
        unseen = 0.0 if step.grade else abs(way)
        return Journey(row, dt, np.array((*unexplained(dt, stood, square), 0.0)), unseen)


class EnergyPerKilometre(PriorAlone):
    """Energy over distance of everything driven so far; at first the prior.

    Its interval follows from the differences between earlier drives.
    """

    START, WEIGHT = 0.25, 2.0  # 1-sigma of one drive's consumption over the mean; in drives

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._drives: list[tuple[float, float]] = []
        self._now, self._alone = np.zeros(2), 0.0

    def begin_next_drive(self) -> None:
        """Keep the drive's sum."""
        super().begin_next_drive()
        if self._now[1] > 0:
            self._drives.append((float(self._now[0]), float(self._now[1])))
        self._now, self._alone = np.zeros(2), 0.0

    def learn(self, step: DrivingStep) -> None:
        """Add energy and distance."""
        self._now += np.array((step.power, abs(step.speed))) * step.dt
        self._alone = 0.0

    def predict(self, step: DrivingStep) -> Prediction:
        """Consumption times speed, W."""
        sums = np.array([*self._drives, self._now])
        energy, distance = sums.sum(axis=0)
        known = distance >= LEAST_DISTANCE
        power = energy / distance * abs(step.speed) if known else self.power(step)
        self._alone += power * step.dt
        shares = [e * distance / (d * energy) - 1 for e, d in self._drives if d > 0 and energy]
        squares = self.WEIGHT * self.START**2 + sum(part**2 for part in shares)
        share = math.sqrt(squares / (self.WEIGHT + len(shares)))
        sigma = share * abs(self._alone)
        return Prediction(step.middle_ns, float(power), energy_sigma=sigma)


class FastKalman(StepMethod):
    """The extended Kalman filter of `benchmarks.unseen.kalman`, whose states wander fast."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._filter = FiveStateFilter(vehicle)
        self._unmeasured = np.zeros(2)  # energy's 1-sigma by a lasting error, J, and its variance

    def begin_next_drive(self) -> None:
        """The filter goes on."""
        super().begin_next_drive()
        self._unmeasured = np.zeros(2)

    def learn(self, step: DrivingStep) -> None:
        """One step of the filter."""
        self._filter.observe(_sample(step), step.power)
        self._unmeasured = np.zeros(2)

    def predict(self, step: DrivingStep) -> Prediction:
        """Power of the present state; its error is taken to last for the whole dropout."""
        power, sigma = self._filter.predict(_sample(step))
        self._unmeasured[0] += sigma * step.dt
        return Prediction(step.middle_ns, power, sigma, energy_sigma=float(self._unmeasured[0]))

    def combinations(self) -> Mapping[str, Estimate]:
        """States of the filter."""
        drag, rolling, mass, back, p_aux = self._filter.mean.tolist()
        std = np.sqrt(np.diag(self._filter.covariance)).tolist()
        return {
            "mass_over_eta": (mass, std[2]),
            "regeneration": (back, std[3]),
            "rolling_over_eta": (rolling, std[1]),
            "drag_area_over_eta": (drag, std[0]),
            "p_aux": (p_aux, std[4]),
        }


BASELINES: Mapping[str, Factory] = {
    "prior": PriorAlone,
    "per_km": EnergyPerKilometre,
    "weak_ls": WeakFormLeastSquares,
    "ekf_fast": FastKalman,
}


def _sample(step: DrivingStep) -> Sample:
    """The middle of a step as a sample."""
    moving = abs(step.speed) > MOVING
    return Sample(
        stamp_ns=step.middle_ns,
        speed=step.speed,
        acceleration=step.kinetic / step.speed if moving else 0.0,
        grade=step.grade,
        air_density=step.density,
        known_auxiliary=step.known,
    )
