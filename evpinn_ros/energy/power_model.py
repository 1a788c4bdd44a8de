"""A car as plans take it: the one equation (`estimation.terms`) over steps of a plan.

A plan is a row of steps, and its energy is the same terms times the same states that learned from
intervals of driving. So the forecast of a driven speed is the replay of it without its battery.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import like, namespace, within
from evpinn_ros.estimation.posterior import (
    FORCE_NOISE,
    LOAD_TIME,
    NOISE_TIME,
    STANDING_NOISE,
    CarModel,
    wandered,
)
from evpinn_ros.estimation.size import model_of_file
from evpinn_ros.estimation.states import PHYSICS, WEIGHTS, State
from evpinn_ros.estimation.terms import (
    STANDING,
    Warmth,
    Wheels,
    climate_powers,
    coldness,
)
from evpinn_ros.estimation.unevenness import Path, even_rows
from evpinn_ros.vehicle.files import Vehicle
from evpinn_ros.vehicle.identifiable import Identifiable

SAME_LENGTH = 1.0  # m by which plans along one road may differ in length
# Where the network is looked up for many trips, m/s and m/s^2; between them it is linear.
GRID_SPEED, GRID_FORCE = np.arange(0.0, 101.0, 1.0), np.linspace(-4.0, 4.0, 33)


class Motion(NamedTuple):
    """Steps of a plan, in order, numpy arrays or torch tensors of one shape (..., n).

    Attributes:
        duration: s.
        distance: m.
        air: integral of the flow's |u| u v, m^3/s^2.
        kinetic: difference of v^2 / 2, J/kg.
        climb: difference of height, m.
    """

    duration: Any
    distance: Any
    air: Any
    kinetic: Any
    climb: Any


class Weather(NamedTuple):
    """Surroundings of a plan.

    Attributes:
        air_density: kg/m^3.
        celsius: temperature outside; None: the last that the car knew.
        heating: power of heating and air conditioning, W; None: what the temperature makes
            likely, and of this drive so far.
        start: coldness of tyres and cabin when the plan begins. None: as the car is now.
    """

    air_density: float
    celsius: float | None = None
    heating: float | None = None
    start: Warmth | None = None


class PlanEnd(NamedTuple):
    """A plan at its end, to be compared with others.

    Attributes:
        row: energy by each state, J per unit, shape (SIZE,).
        elapsed: s.
        distance: m.
        noise: variance of what no state explains, J^2.
        unseen: m of road whose height is not known.
        uneven: energy expected of uneven speed, J.
    """

    row: np.ndarray
    elapsed: float
    distance: float
    noise: float
    unseen: float
    uneven: float


@dataclass(frozen=True, eq=False)
class PowerModel:
    """A car, ready for forecasts.

    Attributes:
        car: what is known of it.
    """

    car: CarModel

    def rows(self, motion: Motion, weather: Weather) -> Any:
        """Energy of each step by each state, J per unit, shape (..., n, SIZE)."""
        equation, duration = self.car.equation, motion.duration
        wheels = equation.wheels(*motion, weather.air_density)
        celsius, warmth = self._celsius(weather), self._warmth(duration, weather)
        rows = equation.moving_rows(wheels, duration, coldness(celsius), warmth.tyres)
        for state, power in self._loads(weather.heating, celsius, warmth).items():
            rows[..., state] = power * duration
        return rows

    def parts(self, motion: Motion, weather: Weather) -> np.ndarray:
        """Energy of all steps of one trip by part and state, J per unit, (COUNT, SIZE)."""
        wheels = self.car.equation.wheels(*motion, weather.air_density)
        tyres = self._warmth(motion.duration, weather).tyres
        rows = self.rows(motion, weather)
        return self.car.equation.split(rows, wheels, coldness(self._celsius(weather)), tyres)

    def leg_rows(self, legs: Path, weather: Weather) -> tuple[np.ndarray, np.ndarray]:
        """Energy of legs whose mean speed alone is known, J per unit, shape (n, SIZE) each.

        Args:
            legs: of one trip.
            weather: on the way.

        Returns:
            The whole, and the part of it that is expected of uneven speed.
        """
        equation, duration = self.car.equation, legs.duration
        celsius, warmth = self._celsius(weather), self._warmth(duration, weather)
        beyond = self.car.unevenness.of_legs(equation, legs)
        rows = even_rows(equation, legs) + beyond
        tyres = float(equation.mean[State.ROLLING]) * rows[:, State.ROLLING]
        rows[:, State.ROLLING_DRIVE] = tyres
        rows[:, State.ROLLING_COLD] = tyres * coldness(celsius)
        rows[:, State.ROLLING_START] = tyres * warmth.tyres
        for state, power in self._loads(weather.heating, celsius, warmth).items():
            rows[:, state] = power * duration
        return rows, beyond

    def summed_rows(self, motion: Motion, weather: Weather) -> np.ndarray:
        """Rows of whole trips, shape (batch, SIZE); the network by a table, for it is many."""
        wheels = self.car.equation.wheels(*motion, weather.air_density)
        rows = self._summed(wheels, motion.duration, weather)
        rows[:, WEIGHTS] += _looked_up(wheels, motion.distance, self._table)
        return rows

    def steps_onto(self, motion: Motion, weather: Weather, onto: np.ndarray) -> np.ndarray:
        """Rows of steps, each a trip of its own, times `onto`; the network by the same table.

        Args:
            motion: columns of shape (n, 1).
            weather: on the way.
            onto: combinations of the states, shape (SIZE, k).

        Returns:
            Shape (n, k). The rows themselves would be five times as much to compute.
        """
        wheels = self.car.equation.wheels(*motion, weather.air_density)
        found = self._summed(wheels, motion.duration, weather) @ onto
        table = (self._table @ onto[WEIGHTS]).reshape(-1, onto.shape[1])
        cell, shares = _nodes(wheels)
        way = np.abs(motion.distance)
        for shift, share in shares:
            found += table[cell[:, 0] + shift] * (share * way)
        return np.asarray(found)

    def _summed(self, wheels: Wheels, duration: np.ndarray, weather: Weather) -> np.ndarray:
        """Rows of whole trips without the force of the network, shape (batch, SIZE)."""
        celsius, warmth = self._celsius(weather), self._warmth(duration, weather)
        rows = self.car.equation.moving_sums(wheels, duration, coldness(celsius), warmth.tyres)
        for state, power in self._loads(weather.heating, celsius, warmth).items():
            rows[:, state] = (power * duration).sum(-1)
        return rows

    def predicted(
        self, rows: Any, elapsed: Any, square: Any, unseen: Any, uneven: Any = 0.0
    ) -> tuple[Any, Any]:
        """Energy, J, and its 1-sigma, J, of journeys of any shape (...).

        Args:
            rows: summed, shape (..., SIZE); changed here.
            elapsed: s since the start.
            square: integral of speed squared, m^2/s.
            unseen: m of road whose height is not known.
            uneven: energy expected of uneven speed, J.
        """
        car, xp = self.car, namespace(rows)
        _, rows[..., State.LOAD], rest = wandered(elapsed)
        mean, covariance = like(car.mean, rows), like(car.covariance, rows)
        variance = ((rows @ covariance) * rows).sum(-1) + car.load_variance * rest
        variance = variance + self.noise(elapsed, square)
        variance = car.trust * (variance + car.growth * car.weight_over_eta**2 * unseen)
        variance = variance + (car.unevenness.share * uneven) ** 2  # which is judged by itself
        return rows @ mean, xp.sqrt(within(variance, 0.0, math.inf))

    def noise(self, elapsed: Any, square: Any) -> Any:
        """Variance of energy that no state explains, J^2; arguments as in `predicted`."""
        standing, moving = self.car.noise[0], self.car.noise[1]
        own = standing * STANDING_NOISE**2 * elapsed + moving * FORCE_NOISE**2 * square
        return NOISE_TIME * own

    def difference(self, one: PlanEnd, other: PlanEnd) -> tuple[float, float]:
        """Energy that one plan takes more than another, J, and the 1-sigma of that, J.

        Both begin at one moment, with one car: what they share cancels. Of one length they are
        taken to lead along one road.
        """
        car, row = self.car, one.row - other.row
        _, integral, _ = wandered(np.array([one.elapsed, other.elapsed]))
        row[State.LOAD] = integral[0] - integral[1]
        _, alone, rest = wandered(abs(one.elapsed - other.elapsed))
        shorter = min(one.elapsed, other.elapsed)
        begun = -math.expm1(-2.0 * shorter / LOAD_TIME) * alone**2
        variance = float(row @ car.covariance @ row) + car.load_variance * (begun + rest)
        variance += one.noise + other.noise
        if abs(one.distance - other.distance) > SAME_LENGTH:
            variance += car.growth * car.weight_over_eta**2 * (one.unseen + other.unseen)
        variance = car.trust * max(variance, 0.0)
        variance += (car.unevenness.share * (one.uneven - other.uneven)) ** 2
        return float(row @ car.mean), math.sqrt(variance)

    def start(self, stood: float | None, prewarmed: float) -> Warmth:
        """Coldness at the start of a trip.

        Args:
            stood: s that the car stands before it; None: as the car is now, at the start of a
                drive cold.
            prewarmed: share of the cabin's warmth that the charger gave.
        """
        found = self._now
        if stood is not None:
            found = Warmth.after(self.car.seconds or self.car.last_drive).stood(stood)
        return found._replace(cabin=found.cabin * (1.0 - prewarmed))

    def with_payload(self, payload: float) -> PowerModel:
        """The car with so many kg more than it has; its tyres carry them too."""
        if not payload:
            return self
        mean, eta = self.car.mean.copy(), self.car.equation.eta + self.car.mean[State.ETA]
        c_rr = mean[State.ROLLING] / mean[State.MASS]
        mean[State.MASS] += payload / eta
        mean[State.ROLLING] += c_rr * payload / eta
        return PowerModel(replace(self.car, mean=mean))

    @property
    def _now(self) -> Warmth:
        return Warmth.after(self.car.seconds)

    @cached_property
    def _table(self) -> np.ndarray:
        """Force of the network on the grid, N per weight, shape (speeds, forces, NETWORK)."""
        speed, force = np.meshgrid(GRID_SPEED, GRID_FORCE, indexing="ij")
        found = self.car.equation.network.force(speed.ravel(), force.ravel())
        return np.asarray(found.reshape(*speed.shape, -1))

    def _celsius(self, weather: Weather) -> float | None:
        return self.car.celsius if weather.celsius is None else weather.celsius

    def _warmth(self, duration: Any, weather: Weather) -> Warmth:
        """Coldness of tyres and cabin in the middle of each step."""
        start = self._now if weather.start is None else weather.start
        return start.driven(namespace(duration).cumsum(duration, -1) - duration / 2)

    def _loads(
        self, heating: float | None, celsius: float | None, warmth: Warmth
    ) -> dict[State, Any]:
        """Standing power by state, W per unit, numbers or of the steps' shape."""
        found: dict[State, Any] = dict.fromkeys(STANDING, 1.0)
        if heating is not None:
            return found | {State.REPORTED: heating}
        if self.car.reports:
            found[State.CLIMATE_DRIVE] = 1.0
        return found | climate_powers(celsius, warmth)


def vehicle_model(vehicle: Vehicle, seed: int = 0) -> PowerModel:
    """The car of a vehicle file, of which nothing was learned yet."""
    return PowerModel(model_of_file(vehicle, seed))


def combined_model(combined: Identifiable, sigmas: Identifiable, vehicle: Vehicle) -> PowerModel:
    """The car that the identifiable combinations make, errors of these taken as independent.

    Args:
        combined: floats.
        sigmas: their 1-sigma.
        vehicle: for everything that they do not hold.
    """
    car = vehicle_model(vehicle).car
    mass, area, c_rr, regeneration, p_aux = combined
    mean, covariance = car.mean.copy(), car.covariance.copy()
    index = [*PHYSICS, State.P_AUX]
    mean[index] = area, c_rr * mass, mass, regeneration - car.equation.back, p_aux
    covariance[index] = covariance[:, index] = 0.0
    std = (
        sigmas.drag_area_over_eta,
        math.hypot(sigmas.c_rr * mass, c_rr * sigmas.mass_over_eta),
        sigmas.mass_over_eta,
        sigmas.regeneration,
        sigmas.p_aux,
    )
    covariance[index, index] = np.square(std)
    # What is not known of the mass is not known of its rolling either.
    both = [State.ROLLING, State.MASS], [State.MASS, State.ROLLING]
    covariance[both] = c_rr * np.square(sigmas.mass_over_eta)
    return PowerModel(replace(car, mean=mean, covariance=covariance))


def _nodes(wheels: Wheels) -> tuple[np.ndarray, list[tuple[int, np.ndarray]]]:
    """Numbers of the lower nodes of the grid below steps; shifts and shares of all four about."""
    forces = len(GRID_FORCE)
    x = np.minimum(wheels.speed * (1.0 / GRID_SPEED[1]), len(GRID_SPEED) - 1.001)
    y = (wheels.force - GRID_FORCE[0]) * (1.0 / (GRID_FORCE[1] - GRID_FORCE[0]))
    i, j = x.astype(np.int32), np.minimum(y, forces - 1.001).astype(np.int32)
    x, y = x - i, y - j
    shares = [
        (0, (1 - x) * (1 - y)),
        (1, (1 - x) * y),
        (forces, x * (1 - y)),
        (forces + 1, x * y),
    ]
    return i * forces + j, shares


def _looked_up(wheels: Wheels, distance: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Energy of the network before its share of the terms is taken away, (batch, NETWORK).

    Steps are spread over the four nodes around them by weights, so a trip is one row of weights.
    """
    batch, way = len(distance), np.abs(distance)
    node, shares = _nodes(wheels)
    most = (int(node.max()) // len(GRID_FORCE) + 2) * len(GRID_FORCE)
    cell = np.arange(batch, dtype=np.int32)[:, None] * most + node
    weights = np.zeros(batch * most)
    for shift, share in shares:
        weights += np.bincount((cell + shift).ravel(), (share * way).ravel(), len(weights))
    return np.asarray(weights.reshape(batch, -1) @ table.reshape(-1, table.shape[2])[:most])
