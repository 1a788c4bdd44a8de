"""Energy of the edges of a road network, for a router: many legs at once.

An edge is a leg (`PowerModel.edge_rows`) that belongs to no trip: the car is warm, and its speed
and slope do not change at the ends; unevenness of speed counts per metre. So edges add up: cutting
one in two changes no sum. A downhill edge may give energy back, so a router needs potentials or
the Bellman-Ford algorithm. A route is a trip: its energy is the forecast of its edges as legs,
with start, end, and the changes of speed and slope in between. Errors about the car are the same
on every edge, so routes are compared by the sigma of their difference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import Legs, legs_of_trip
from evpinn_ros.core.energy.power_model import PowerModel, Weather, even_steps
from evpinn_ros.core.estimation.journey import standing
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.unevenness import OF_LEGS

JUDGED = 2000  # edges by which directions are chosen
LEAST_SHARE = 1e-4  # of their variance; directions with less are left out
CHUNK = 4096  # edges computed together, which fit into the cache


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Energies of n edges.

    Attributes:
        energy: J, shape (n,).
        directions: effect of k independent errors about the car, one sigma each, J, shape (n, k);
            an error has the same sense on every edge.
        own: variance of errors that edges do not share, J^2, shape (n,).
        uneven: 1-sigma of uneven speed by the driver's habit, J, shape (n,): also of the same
            sense on every edge.
        trip: forecasts a trip over the edges of these numbers, in order.
    """

    energy: np.ndarray
    directions: np.ndarray
    own: np.ndarray
    uneven: np.ndarray
    trip: Callable[[np.ndarray], Uncertain]

    @property
    def sigma(self) -> np.ndarray:
        """1-sigma of each edge, J, shape (n,)."""
        return np.asarray(np.sqrt((self.directions**2).sum(1) + self.own + self.uneven**2))

    def route(self, edges: Sequence[int] | np.ndarray) -> Uncertain:
        """Energy of a route, J, and its 1-sigma; edges: numbers in the order driven."""
        numbers = np.asarray(edges, dtype=int)
        return self.trip(numbers) if numbers.size else Uncertain(0.0, 0.0)

    def difference(
        self, one: Sequence[int] | np.ndarray, other: Sequence[int] | np.ndarray
    ) -> Uncertain:
        """Energy of one route less that of the other, J, and its 1-sigma.

        Errors that the routes share (common edges, the car) cancel.
        """
        count, routes = len(self.energy), [np.asarray(route, dtype=int) for route in (one, other)]
        more, less = (np.bincount(route, minlength=count) for route in routes)
        times = more - less
        variance = ((times @ self.directions) ** 2).sum() + np.abs(times) @ self.own
        variance += (times @ self.uneven) ** 2
        energy = self.route(one).value - self.route(other).value
        return Uncertain(energy, math.sqrt(variance))


def edge_energies(
    legs: Legs,
    model: PowerModel,
    weather: Weather,
    head_wind: float = 0.0,
    *,
    steady: bool = False,
) -> Edges:
    """Energies of legs that need not follow one another.

    Args:
        legs: of the network.
        model: of the car.
        weather: on the way; tyres and cabin are warm, except in routes.
        head_wind: against the car on every edge, m/s.
        steady: True if edges are driven evenly.
    """
    car, count = model.car, len(legs.length)

    def rows_of(part: Any) -> tuple[np.ndarray, np.ndarray]:
        duration, length, climb = (
            column[part] for column in (legs.duration, legs.length, legs.climb)
        )
        return model.edge_rows(
            even_steps(duration, length, climb, head_wind), weather, steady=steady
        )

    rows, _ = rows_of(np.arange(count)[:: max(1, count // JUDGED)])
    unknown = math.sqrt(car.trust) * _directions(rows, model.covariance)
    energy, uneven = np.empty(count), np.empty(count)
    directions = np.empty((count, unknown.shape[1]), np.float32)  # memory traffic takes the time
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        rows, beyond = rows_of(part)
        energy[part], directions[part] = rows @ car.mean, rows @ unknown
        uneven[part] = np.abs(beyond @ car.mean)
    stood = standing(legs.duration, legs.length)
    own = model.noise(legs.duration, stood, legs.length**2 / legs.duration)
    own += car.load_variance * legs.duration**2
    own += car.growth * car.weight_over_eta**2 * legs.length * ~legs.height_known
    share = car.unevenness.share
    by_chance = 0.5 * car.mean[State.MASS_OVER_ETA] * (legs.length / legs.duration) ** 2 * uneven

    def trip(edges: np.ndarray) -> Uncertain:
        climb = np.where(legs.height_known, legs.climb, math.nan)
        columns = (column[edges] for column in (legs.length, legs.duration, climb))
        driven = forecast_plan(
            legs_of_trip(*columns), model, weather, head_wind, steady=steady, along=False
        )
        return Uncertain(float(driven.energy[-1]), float(driven.sigma[-1]))

    return Edges(
        energy=energy,
        directions=directions,
        own=car.trust * own + share**2 * OF_LEGS * by_chance,
        uneven=share * uneven,
        trip=trip,
    )


def _directions(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Independent errors of the states that matter for these rows, 1-sigma, shape (SIZE, k)."""
    variance, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(variance, 0.0))
    effects = rows @ root
    size, turned = np.linalg.eigh(effects.T @ effects)
    return np.asarray(root @ turned[:, size > LEAST_SHARE * size.sum()])
