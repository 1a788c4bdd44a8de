"""Distance to empty with the energy in the battery.

The consumption of the next metres is mostly that of the learned car on its usual legs of a minute,
at the present temperature and loads (`usual_cost`): a cold morning or a roof box counts before its
kilometres are driven. Tyres and cabin are as cold as in the mean of its drives, because the car
will stop and start again on the way. Over `MEMORY`, consumption returns to the mean of the last
100 km. So the energy of the next d metres is

    E(d) = c_long d + (c_near - c_long) L (1 - exp(-d / L)),    L = MEMORY

and at the distance to empty it equals the energy left. The error of consumption is a process over
distance with the same memory, whose 1-sigma is the spread of 5 km pieces of road
(`energy.uncertainty`, metres for seconds). The band ends where E plus or minus 1.645 sigma, of E
and of the energy left, equals the energy left.

While the car follows a forecast route, the road ahead is the rest of that route, and E begins at
its end. Before 10 km are driven, the road beyond costs as much as the usual legs, or, while these
are unknown, as the mean of a route of 10 km or more. A plan shorter than `SHORTEST`, such as the
horizon of a controller, is not a route.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
import math
import sys
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import EnergyCurve
from evpinn_ros.core.energy.plausible import Joules, Metres
from evpinn_ros.core.energy.power_model import PowerModel, Weather, even_steps
from evpinn_ros.core.energy.trip import Stretch
from evpinn_ros.core.energy.uncertainty import relaxed, walked
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.unevenness import MIDDLES, USUAL_LEG
from evpinn_ros.core.signals.readings import NANOSECONDS

MEMORY = 10e3  # m
# Weight of the usual legs against the long run, chosen on the e-208, the Leaf and the Changchun
# sedan; weight of the last 10 km while usual legs are unknown.
USUAL, RECENT = 0.75, 0.5
LEAST_METRES = 3000.0  # in legs of a minute, from which on usual legs are known
FIRST_SPREAD, FIRST_SPREAD_PIECES = 0.25, 5  # prior relative 1-sigma of pieces; its weight
FARTHEST = 2.0**21  # m; a longer distance to empty counts as unknown
HALVINGS = 21  # of `FARTHEST` down to a metre
QUANTILE = 1.6449  # of 90 %
SHORTEST = 2e3  # m; a shorter plan is not a route
GIVEN_UP = 2.0  # times its planned duration, after which an unfinished route is given up
MOST_POINTS = 1000  # of a route, which is saved each minute: of 300 km one each 300 m
Stamp: TypeAlias = Annotated[int, Range(0, sys.maxsize)]  # ns


class Remaining(NamedTuple):
    """Distance to empty, m: the value, its 1-sigma, and the 90 % band."""

    distance: float
    sigma: float
    lower: float
    upper: float


class Cost(NamedTuple):
    """Energy per distance, J/m: of the next metres, in the long run, and its relative 1-sigma."""

    near: float
    long: float
    spread: float

    @property
    def known(self) -> bool:
        """True if both costs are positive numbers."""
        return all(map(math.isfinite, self)) and min(self.near, self.long) > 0

    @classmethod
    def ahead(cls, recent: float, long: float, usual: float, spread: float) -> Cost:
        """Cost of the road ahead.

        Args:
            recent: of the last 10 km, J/m.
            long: of the last 100 km, J/m.
            usual: of the car's usual legs now, J/m; NaN while none are known.
            spread: relative 1-sigma of pieces of road.
        """
        share, other = (RECENT, recent) if math.isnan(usual) else (USUAL, usual)
        return cls(long + share * (other - long), long, spread)

    def energy(self, distance: float) -> float:
        """Energy of the metres ahead, J."""
        return self.long * distance + (self.near - self.long) * float(relaxed(distance, MEMORY))

    def sigma(self, distance: float) -> float:
        """1-sigma of `energy`, J."""
        level = self.spread * max(self.near, self.long)
        return level * math.sqrt(max(walked(distance, MEMORY), 0.0))


@lru_cache(maxsize=4)  # called at every prediction, changes every ten seconds
def usual_cost(car: CarModel) -> float:
    """Energy per distance of a car's usual mix of legs, J/m; NaN while no mix is known."""
    metres = car.unevenness.metres
    if metres.sum() < LEAST_METRES:
        return math.nan
    legs = even_steps(np.full_like(MIDDLES, USUAL_LEG), MIDDLES * USUAL_LEG, 0.0 * MIDDLES)
    model = PowerModel(car)
    rows, _ = model.edge_rows(legs, Weather(model.density()), car.unevenness.warmth)
    cost = float(metres @ (rows @ model.car.mean / legs.distance) / metres.sum())
    return cost if math.isfinite(cost) and cost > 0.0 else math.nan


@dataclass(slots=True, eq=False)
class Route:
    """A route that the car follows, with the forecast of its plan; it survives a restart.

    Attributes:
        distance: of n points of its curve from the first, m, never falling.
        energy: from the first point to each, J.
        sigma: 1-sigma of `energy`, J.
        begin: odometer at the first point, m.
        begin_ns: stamp at the first point; 0 while no stamp is known.
        longest_ns: time after `begin_ns` at which the route is given up.

    Raises:
        ValueError: the points are not along a route.
    """

    distance: tuple[Metres, ...]
    energy: tuple[Joules, ...]
    sigma: tuple[Joules, ...]
    begin: Metres
    begin_ns: Stamp
    longest_ns: Stamp

    def __post_init__(self) -> None:
        if not 2 <= len(self.distance) == len(self.energy) == len(self.sigma):
            raise ValueError("a route needs two points or more, of three numbers each")
        if self.distance[0] != 0.0 or min(np.diff(self.distance)) < 0.0 or min(self.sigma) < 0.0:
            raise ValueError("a route's distance falls or starts above 0, or a sigma is negative")

    @classmethod
    def from_here(cls, curve: EnergyCurve, odometer: float, stamp_ns: int) -> Route:
        """The route of a plan that begins here and now; stamp_ns: 0 while unknown."""
        time, along, energy, sigma = curve
        if len(along) > MOST_POINTS:
            kept = np.linspace(0.0, along[-1], MOST_POINTS)
            energy, sigma = (np.interp(kept, along, series) for series in (energy, sigma))
            along = kept
        distance, energies, sigmas = (tuple(series.tolist()) for series in (along, energy, sigma))
        longest = int(GIVEN_UP * time[-1] * NANOSECONDS)
        return cls(distance, energies, sigmas, odometer, stamp_ns, longest)

    @property
    def cost(self) -> float:
        """Mean energy per distance, J/m."""
        return self.energy[-1] / self.distance[-1]

    def see(self, stamp_ns: int) -> None:
        """Take the first known stamp as `begin_ns`."""
        self.begin_ns = self.begin_ns or stamp_ns

    def left(self, odometer: float, stamp_ns: int) -> float:
        """Rest of the route, m; 0 or less once it is over; stamp_ns: 0 while unknown."""
        is_timed = self.begin_ns and stamp_ns
        if is_timed and not 0 <= stamp_ns - self.begin_ns <= self.longest_ns:
            return 0.0
        return self.begin + self.distance[-1] - odometer

    def ahead(self, odometer: float, beyond: Cost) -> RouteAhead:
        """The rest of the route, and the road beyond its end."""
        along, energy, sigma = map(np.asarray, (self.distance, self.energy, self.sigma))
        driven = odometer - self.begin
        rest = along > driven
        distance = np.concatenate(([0.0], along[rest] - driven))
        here = float(np.interp(driven, along, energy))
        energies = np.concatenate(([0.0], energy[rest] - here))
        # The metres to come are as uncertain as the same number from the start.
        return RouteAhead(distance, energies, np.interp(distance, along, sigma), beyond)


class RouteAhead(NamedTuple):
    """The rest of a route, and the cost of the road beyond its end.

    Attributes:
        distance: of its points from here, m, the first 0, shape (n,).
        energies: from here to each point, J, shape (n,).
        sigmas: 1-sigma of `energies`, J, shape (n,).
        beyond: cost of the road that follows.
    """

    distance: np.ndarray
    energies: np.ndarray
    sigmas: np.ndarray
    beyond: Cost

    @property
    def known(self) -> bool:
        """True if the cost beyond is known; a forecast always is."""
        return self.beyond.known

    def energy(self, distance: float) -> float:
        """Energy that the battery must give within these metres, J: the maximum, as on a pass."""
        most = np.maximum.accumulate(self.energies)
        after = distance - float(self.distance[-1])
        if after <= 0.0:
            return float(np.interp(distance, self.distance, most))
        return max(float(most[-1]), float(self.energies[-1]) + self.beyond.energy(after))

    def sigma(self, distance: float) -> float:
        """1-sigma of `energy`, J."""
        after = max(distance - float(self.distance[-1]), 0.0)
        on_route = float(np.interp(distance, self.distance, self.sigmas))
        return math.hypot(on_route, self.beyond.sigma(after))


def cost_spread(pieces: Sequence[Stretch]) -> float:
    """Relative 1-sigma of the cost of pieces of road around their mean.

    The observed spread is averaged with a prior of 25 % that weighs as five pieces.
    """
    variance = FIRST_SPREAD_PIECES * FIRST_SPREAD**2
    mean = sum(piece.energy for piece in pieces) / max(sum(p.distance for p in pieces), 1.0)
    if mean > 0:
        variance += sum((piece.energy / piece.distance / mean - 1) ** 2 for piece in pieces)
    return math.sqrt(variance / (FIRST_SPREAD_PIECES + len(pieces)))


def remaining(usable: Uncertain, ahead: Cost | RouteAhead) -> Remaining | None:
    """Distance to empty; None while energy or cost is unknown, or beyond `FARTHEST`.

    Args:
        usable: energy left, J.
        ahead: the road.
    """
    if not (all(map(math.isfinite, usable)) and ahead.known):
        return None

    def over(quantile: float) -> Callable[[float], float]:
        def energy(distance: float) -> float:
            uncertain = math.hypot(ahead.sigma(distance), usable.sigma)
            return ahead.energy(distance) + quantile * uncertain - usable.value

        return energy

    # The battery is empty where each of these three functions first rises above zero.
    distances = [_first_zero(over(quantile)) for quantile in (QUANTILE, 0.0, -QUANTILE)]
    lower, distance, upper = distances
    if lower is None or distance is None or upper is None:
        return None
    return Remaining(distance, (upper - lower) / (2 * QUANTILE), lower, upper)


def _first_zero(function: Callable[[float], float]) -> float | None:
    """First zero of a function that rises in the end; 0 if it is above from the start."""
    if function(0.0) >= 0:
        return 0.0
    if function(FARTHEST) <= 0:
        return None
    low, high = 0.0, FARTHEST
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if function(middle) < 0 else (low, middle)
    return (low + high) / 2
