"""The model of a car for plans: the one equation (`estimation.terms`) over steps of a plan.

The energy of a plan's steps is the terms of this equation times the states that are learned from
intervals of driving. So the forecast of a driven speed equals its replay without the battery.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import like, namespace, within, zeros
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.network_table import (
    looked_up,
    table_of,
    units_of,
)
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.journey import LOAD_TIME, unexplained, wandered
from evpinn_ros.core.estimation.size import model_of_file
from evpinn_ros.core.estimation.states import PHYSICS, SIZE, WEIGHTS, State
from evpinn_ros.core.estimation.terms import (
    CREEPING,
    EXPLAINED,
    HEATING,
    WARM,
    Warmth,
    Wheels,
    coldness,
    standing_powers,
)
from evpinn_ros.core.estimation.unevenness import UNEVEN_STATES, USUAL_LEG, Runs
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.signals.road import Conditions, density_of_air
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.identifiable import Identifiable

SAME_LENGTH = 1.0  # m by which plans along one road may differ in length
CLIMATE_SHARE = 0.4  # relative 1-sigma of the expected heating or cooling of a drive (e-208)
CLIMATE_SHOWN = 300.0  # s of a drive after which 1/e of that is left
LEAST_TRUST = 1e-3  # least factor that can be learned


class Weather(NamedTuple):
    """Surroundings of a plan.

    Attributes:
        air_density: kg/m^3.
        celsius: temperature outside, degrees Celsius; None: the last one known to the car.
        heating: power of heating and air conditioning, W; None: expected from the temperature and
            this drive so far.
        start: coldness of tyres and cabin when the plan begins; None: as the car is now.
    """

    air_density: float
    celsius: float | None = None
    heating: float | None = None
    start: Warmth | None = None


class PlanEnd(NamedTuple):
    """Sums over a whole plan, to compare it with others.

    Attributes:
        row: energy by each state, J per unit, shape (SIZE,).
        elapsed: s.
        distance: m.
        noise: variance of energy that no state explains, J^2.
        unseen: m of road whose height is not known.
        uneven: size of the expected energy of uneven speed (`unevenness.size_of`), J.
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
        car: its equation and states.
    """

    car: CarModel

    def rows(self, steps: Steps, weather: Weather) -> np.ndarray:
        """Energy of each step of a trip by each state, J per unit, shape (n, SIZE)."""
        return self.car.equation.rows(steps, *self._surroundings(steps, weather))

    def parts(self, steps: Steps, weather: Weather) -> np.ndarray:
        """Energy of all steps of a trip by part and state, J per unit, (COUNT, SIZE)."""
        equation, (conditions, warmth) = self.car.equation, self._surroundings(steps, weather)
        wheels, cold = equation.of_steps(steps, conditions), coldness(conditions.celsius)
        return equation.split(self.rows(steps, weather), wheels, cold, warmth.tyres)

    def edge_rows(
        self, edges: Steps, weather: Weather, warmth: Warmth = WARM, *, steady: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Energy of edges that belong to no trip, by state, J per unit, (n, SIZE) each.

        It is proportional to their length, so edges of one speed and slope add up.

        Args:
            edges: n of them, as `even_steps` makes them.
            weather: on the way.
            warmth: of tyres and cabin on each.
            steady: True if they are driven evenly.

        Returns:
            The whole, and the part of it that is due to uneven speed.
        """
        duration, length = edges.duration, edges.distance
        # Rows are computed for a metre, or a second: shorter steps do not resolve the force.
        size = np.where(length > CREEPING * duration, length, duration)
        metre = Steps._make((*(column / size for column in edges[:5]), *edges[5:]))
        rows = self.car.equation.rows(metre, self._conditions(weather), warmth) * size[:, None]
        beyond = np.zeros_like(rows)
        if not steady:
            minutes = duration / USUAL_LEG
            density = np.full_like(minutes, weather.air_density)
            runs = Runs(duration / minutes, length / minutes, density)
            uneven = self.car.unevenness.rows(self.car.equation, runs)
            beyond[:, UNEVEN_STATES] = uneven * minutes[:, None]
        return rows + beyond, beyond

    def rows_along(self, steps: Steps, weather: Weather) -> np.ndarray:
        """Rows summed up to the end of each step, shape (..., n, SIZE).

        Memory is ordered by state, which makes sums and products several times faster.
        """
        equation, network = self.car.equation, self.car.equation.network
        wheels, columns = self._columns(steps, weather)
        rows = np.zeros((SIZE, *wheels.energy.shape))
        for state, column in columns.items():
            rows[state] = column
        weights, way = rows[WEIGHTS].reshape(-1, wheels.energy.size), np.abs(steps.distance)
        for part, units in units_of(network, wheels):
            np.matmul(network.outer.T, units, out=weights[:, part])
        rows[WEIGHTS] *= way
        np.cumsum(rows, axis=-1, out=rows)
        rows[EXPLAINED] -= np.tensordot(equation.explained.T, rows[PHYSICS], 1)
        return np.moveaxis(rows, 0, -1)

    def whole_row(self, steps: Steps, weather: Weather) -> tuple[np.ndarray, np.ndarray]:
        """Row of all n steps of one trip, shape (SIZE,), and the energy of each, J, shape (n,).

        These energies leave out the wandering load, which fades along the way.
        """
        equation, network = self.car.equation, self.car.equation.network
        wheels, columns = self._columns(steps, weather)
        mean = self.car.mean.copy()
        mean[State.LOAD] = 0.0
        mean[PHYSICS] -= equation.explained @ mean[EXPLAINED]
        row, energy = np.zeros(SIZE), np.zeros(wheels.energy.size)
        for state, column in columns.items():
            row[state] = column.sum()
            energy += mean[state] * column
        way, force = np.abs(steps.distance), network.outer @ mean[WEIGHTS]
        for part, units in units_of(network, wheels):
            row[WEIGHTS] += network.outer.T @ (units @ way[part])
            energy[part] += (force @ units) * way[part]
        row[EXPLAINED] -= row[PHYSICS] @ equation.explained
        return row, energy

    def summed_rows(self, steps: Steps, weather: Weather) -> Any:
        """Rows of many whole trips, shape (batch, SIZE); the network is looked up in a table."""
        wheels, columns = self._columns(steps, weather)
        rows = zeros((len(steps.distance), SIZE), steps.distance)
        for state, column in columns.items():
            rows[:, state] = column.sum(-1)
        rows[:, WEIGHTS] = looked_up(wheels, steps.distance, self._table)
        rows[:, EXPLAINED] -= rows[:, PHYSICS] @ like(self.car.equation.explained, rows)
        return rows

    def predicted(
        self, rows: Any, elapsed: Any, noise: Any, unseen: Any, uneven: Any = 0.0
    ) -> tuple[Any, Any]:
        """Energy, J, and its 1-sigma, J, of journeys of any shape (...).

        Args:
            rows: summed, shape (..., SIZE); modified in place.
            elapsed: s since the start.
            noise: variance of energy that no state explains, J^2.
            unseen: m of road whose height is not known.
            uneven: size of the expected energy of uneven speed, J.
        """
        car, xp = self.car, namespace(rows)
        _, rows[..., State.LOAD], rest = wandered(elapsed)
        mean, covariance = like(car.mean, rows), like(self.covariance, rows)
        states = xp.moveaxis(rows, -1, 0)
        variance = xp.einsum("i...,i...->...", xp.tensordot(covariance, states, 1), states)
        variance = variance + car.load_variance * rest + noise
        variance = car.trust * (variance + car.growth * car.weight_over_eta**2 * unseen)
        variance = variance + (car.unevenness.share * uneven) ** 2  # not scaled by `trust`
        return rows @ mean, xp.sqrt(within(variance, 0.0, math.inf))

    def noise(self, elapsed: Any, stood: Any, square: Any) -> Any:
        """Variance of energy that no state explains, J^2; arguments as in `unexplained`."""
        still, moving = unexplained(elapsed, stood, square)
        return self.car.noise[0] * still + self.car.noise[1] * moving

    def difference(self, end: PlanEnd, other: PlanEnd) -> Uncertain:
        """Energy of one plan less that of another, J, and its 1-sigma, J.

        Both begin at the same moment with the same car, so common errors cancel. Plans of equal
        length are assumed to follow the same road.
        """
        car, row = self.car, end.row - other.row
        _, integral, _ = wandered(np.array([end.elapsed, other.elapsed]))
        row[State.LOAD] = integral[0] - integral[1]
        _, alone, rest = wandered(abs(end.elapsed - other.elapsed))
        shorter = min(end.elapsed, other.elapsed)
        begun = -math.expm1(-2.0 * shorter / LOAD_TIME) * alone**2
        variance = float(row @ self.covariance @ row) + car.load_variance * (begun + rest)
        variance += end.noise + other.noise
        if abs(end.distance - other.distance) > SAME_LENGTH:
            variance += car.growth * car.weight_over_eta**2 * (end.unseen + other.unseen)
        variance = car.trust * max(variance, 0.0)
        variance += (car.unevenness.share * (end.uneven - other.uneven)) ** 2
        return Uncertain(float(row @ car.mean), math.sqrt(variance))

    def density(self, celsius: float | None = None, pascal: float | None = None) -> float:
        """Density of the air, kg/m^3, at a temperature, degrees Celsius, and a pressure, Pa.

        None: the last temperature known to the car, and the pressure of the vehicle file.
        """
        celsius = self.car.celsius if celsius is None else celsius
        outside = (math.nan if value is None else value for value in (celsius, pascal))
        return float(density_of_air(self.car.equation.vehicle.air_density, *outside))

    def start(self, stood: float | None, prewarmed: float) -> Warmth:
        """Coldness at the start of a trip.

        Args:
            stood: s that the car stands before it; None: as now, which is cold before a drive. If
                the length of the last drive is unknown, the car was warm after it.
            prewarmed: share of the cabin's warmth that the charger gave.
        """
        warmth = Warmth.after(self.car.seconds)
        if stood is not None:
            warmth = Warmth.after(self.car.seconds or self.car.last_drive or math.inf).stood(stood)
        return warmth._replace(cabin=warmth.cabin * (1.0 - prewarmed))

    def with_payload(self, payload: float) -> PowerModel:
        """The car with an additional payload, kg, which its tyres carry too."""
        return _loaded(self, payload) if payload else self

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the states, shape (SIZE, SIZE), with the scatter of heating by drives.

        How much of the expected heating is on is unknown before a drive; the loads of its first
        minutes show it.
        """
        car, sigma = self.car, np.zeros(SIZE)
        share = CLIMATE_SHARE * math.exp(-car.seconds / CLIMATE_SHOWN)
        sigma[HEATING] = share * car.mean[HEATING]
        return np.asarray(car.covariance + np.outer(sigma, sigma) / max(car.trust, LEAST_TRUST))

    @cached_property
    def _table(self) -> np.ndarray:
        """Force of the network on the grid, N per weight, shape (speeds, forces, NETWORK)."""
        return table_of(self.car.equation.network)

    def _columns(self, steps: Steps, weather: Weather) -> tuple[Wheels, dict[State, Any]]:
        """Wheels of steps, and their energy by state without the network, J per unit.

        The share of the other columns that the terms of eq. 21 explain is not subtracted.
        """
        equation, duration = self.car.equation, steps.duration
        conditions, warmth = self._surroundings(steps, weather)
        wheels, cold = equation.of_steps(steps, conditions), coldness(conditions.celsius)
        moving = equation.moving_columns(wheels, duration, cold, warmth.tyres)
        loads = standing_powers(conditions, warmth)
        return wheels, moving | {state: power * duration for state, power in loads.items()}

    def _conditions(self, weather: Weather) -> Conditions:
        """Conditions for the equation: given heating counts like a reported load."""
        celsius = self.car.celsius if weather.celsius is None else weather.celsius
        given = weather.heating is not None
        return Conditions(weather.air_density, 0.0, celsius, weather.heating or 0.0, given)

    def _surroundings(self, steps: Steps, weather: Weather) -> tuple[Conditions, Warmth]:
        """Conditions, and mean coldness of tyres and cabin in each step."""
        start = Warmth.after(self.car.seconds) if weather.start is None else weather.start
        return self._conditions(weather), start.during(steps.duration)


def even_steps(duration: Any, distance: Any, climb: Any, wind: float = 0.0) -> Steps:
    """Steps at even speed, of any shape: durations, s, distances and climbs, m; head wind, m/s."""
    flow = distance / duration + wind
    return Steps(duration, distance, flow * abs(flow) * distance, 0.0 * duration, climb)


@lru_cache(maxsize=4)  # one object while neither changes, because plans are compared by identity
def _loaded(model: PowerModel, payload: float) -> PowerModel:
    car = model.car
    mean, eta = car.mean.copy(), car.equation.eta + car.mean[State.ETA]
    mass = mean[State.MASS_OVER_ETA]
    c_rr = mean[State.ROLLING] / mass if mass else 0.0  # energy per km
    mean[State.MASS_OVER_ETA] = mass + payload / eta
    mean[State.ROLLING] += c_rr * payload / eta
    return PowerModel(replace(car, mean=mean))


def vehicle_model(vehicle: Vehicle) -> PowerModel:
    """The model of a vehicle file, before anything is learned."""
    return PowerModel(model_of_file(vehicle))


def combined_model(combined: Identifiable, sigmas: Identifiable, vehicle: Vehicle) -> PowerModel:
    """The model of identifiable combinations, with independent errors.

    Args:
        combined: floats.
        sigmas: their 1-sigma.
        vehicle: for all other states.
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
    # The uncertainty of the mass is also that of its rolling resistance.
    both = [State.ROLLING, State.MASS_OVER_ETA], [State.MASS_OVER_ETA, State.ROLLING]
    covariance[both] = c_rr * np.square(sigmas.mass_over_eta)
    return PowerModel(replace(car, mean=mean, covariance=covariance))
