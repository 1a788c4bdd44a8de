"""Energy of the edges of a road network, for a router: many legs at once.

An edge is a leg at even speed plus what uneven speed takes on such legs; between edges the speed
is taken to go on. Downhill an edge may give energy back: a router needs potentials or
Bellman-Ford's algorithm. What is not known of the car is the same on every edge, so the energies
of routes are added up by `Edges.route`, and compared by the sigma of their difference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

import numpy as np

from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.plan import Legs
from evpinn_ros.core.energy.power_model import PowerModel, Weather, even_steps
from evpinn_ros.core.estimation.journey import standing
from evpinn_ros.core.estimation.states import SIZE, State
from evpinn_ros.core.estimation.unevenness import OF_LEGS, per_leg

JUDGED = 2000  # edges by which directions are chosen
LEAST_SHARE = 1e-4  # of the variance of these; a direction with less is left out
CHUNK = 4096  # edges computed together, so that what they need stays in the cache


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Energies of n edges.

    Attributes:
        energy: J, shape (n,).
        directions: what is not known of the car, one sigma each, J, shape (n, k): the same
            direction is off in the same sense on every edge.
        own: variance that is of an edge alone, J^2, shape (n,).
        uneven: 1-sigma of what a driver's habit makes of uneven speed, J, shape (n,): off in the
            same sense too.
    """

    energy: np.ndarray
    directions: np.ndarray
    own: np.ndarray
    uneven: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """1-sigma of each edge, J, shape (n,)."""
        return np.asarray(np.sqrt((self.directions**2).sum(1) + self.own + self.uneven**2))

    def route(self, edges: Sequence[int] | np.ndarray) -> Uncertain:
        """Energy of a route, J, and its 1-sigma; edges: their numbers, once for each time."""
        return self._sum(np.bincount(np.asarray(edges), minlength=len(self.energy)))

    def difference(
        self, one: Sequence[int] | np.ndarray, other: Sequence[int] | np.ndarray
    ) -> Uncertain:
        """Energy that one route takes more than another, J, with the 1-sigma of that.

        What both share cancels: edges that both drive, and the car.
        """
        count = len(self.energy)
        times = [np.bincount(np.asarray(each), minlength=count) for each in (one, other)]
        return self._sum(times[0] - times[1])

    def _sum(self, times: np.ndarray) -> Uncertain:
        variance = ((times @ self.directions) ** 2).sum() + np.abs(times) @ self.own
        variance += (times @ self.uneven) ** 2
        return Uncertain(float(times @ self.energy), math.sqrt(variance))


def edge_energies(
    legs: Legs, model: PowerModel, weather: Weather, head_wind: float = 0.0
) -> Edges:
    """Energies of legs that need not follow one another.

    Args:
        legs: of the network.
        model: of the car; its tyres and cabin are taken as warm.
        weather: on the way.
        head_wind: against the car on every edge, m/s.
    """
    car, count = model.car, len(legs.length)
    some = np.arange(count)[:: max(1, count // JUDGED)]
    rows = _projected(model, weather, head_wind, np.eye(SIZE))(legs, some)[:, :-1]
    unknown = math.sqrt(car.trust) * _directions(rows, model.covariance)
    onto = np.column_stack((car.mean, unknown))
    projected = _projected(model, weather, head_wind, onto)
    energy, uneven = np.empty(count), np.empty(count)
    directions = np.empty((count, unknown.shape[1]), np.float32)  # memory is what takes time
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        sums = projected(legs, part)
        energy[part], directions[part], uneven[part] = sums[:, 0], sums[:, 1:-1], sums[:, -1]
    stood = standing(legs.duration, legs.length)
    own = model.noise(legs.duration, stood, legs.length**2 / legs.duration)
    own += car.load_variance * legs.duration**2
    own += car.growth * car.weight_over_eta**2 * legs.length * ~legs.height_known
    uneven, share = np.abs(uneven), car.unevenness.share
    by_chance = 0.5 * car.mean[State.MASS] * (legs.length / legs.duration) ** 2 * uneven
    return Edges(
        energy=energy,
        directions=directions,
        own=car.trust * own + share**2 * OF_LEGS * by_chance,
        uneven=share * uneven,
    )


def _directions(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Unknown directions of the car that these rows feel, one sigma each, shape (SIZE, k)."""
    variance, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(variance, 0.0))
    felt = rows @ root
    size, turned = np.linalg.eigh(felt.T @ felt)
    return np.asarray(root @ turned[:, size > LEAST_SHARE * size.sum()])


def _projected(
    model: PowerModel, weather: Weather, head_wind: float, onto: np.ndarray
) -> Callable[[Legs, slice | np.ndarray], np.ndarray]:
    """Function of some edges that gives their rows times `onto`, shape (n, k + 1).

    The last column is the energy of uneven speed in them, J.
    """
    car = model.car
    even = model.projected(weather, onto)
    uneven = car.unevenness.per_metre(car.equation, car.mean) @ np.column_stack((onto, car.mean))

    def of_edges(legs: Legs, part: slice | np.ndarray) -> np.ndarray:
        columns = legs.duration[part], legs.length[part], legs.climb[part]
        steps = even_steps(*columns, head_wind)
        sums = per_leg(steps, uneven)
        sums[:, :-1] += even(steps)
        return sums

    return of_edges
