"""Energy of uneven speed between two points of a plan, beyond that of even speed.

A plan whose points lie a minute or a kilometre apart has mean speeds. Between them a driver speeds
up, brakes, turns and waits. Beyond even speed (`estimation.even`), this costs more braking and
more air: two tables per metre, by mean speed and duration of a run of legs, from four cars in
traffic. The car's own drives are cut into legs of many lengths, and for each duration factors of
the tables are learned: in town, on country roads, on motorways. That needs no battery, only speed.
Old driving counts less, because roads and habits change.

A run shorter than `SHORTEST` has no such energy: its points show everything.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.even import Even, Path, even_course, runs_of
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.estimation.terms import Equation, Warmth

MIDDLES = np.array([2.0, 4.5, 7.5, 10.5, 14.0, 18.0, 22.5, 28.0, 33.0])  # m/s, of nodes
DURATIONS = np.array([10.0, 30.0, 60.0, 200.0, 600.0, 2000.0])  # s, of nodes
ROADS = np.array([4.0, 12.0, 24.0])  # m/s, of the nodes of factors: town, country, motorway
# Means over some 2400 km of an i3 in Munich, an e-208 and a Leaf on country roads, and a sedan in
# Changchun, smoothed; above 20 m/s less by as much as their sum was too high.
BRAKED = np.array(
    [
        [0.200, 0.220, 0.235, 0.245, 0.245, 0.245],
        [0.200, 0.220, 0.225, 0.225, 0.220, 0.215],
        [0.160, 0.195, 0.205, 0.195, 0.195, 0.195],
        [0.120, 0.150, 0.160, 0.165, 0.165, 0.170],
        [0.085, 0.110, 0.130, 0.130, 0.125, 0.125],
        [0.075, 0.100, 0.112, 0.115, 0.105, 0.115],
        [0.052, 0.058, 0.062, 0.070, 0.074, 0.076],
        [0.030, 0.031, 0.032, 0.036, 0.042, 0.045],
        [0.018, 0.019, 0.020, 0.023, 0.026, 0.036],
    ]
)  # J/kg of additional braking per metre, without energy that a run carries on to the next
AIR = np.array(
    [
        [9.0, 27.0, 50.0, 66.0, 100.0, 130.0],
        [14.0, 34.0, 58.0, 86.0, 115.0, 130.0],
        [11.0, 27.0, 50.0, 80.0, 108.0, 146.0],
        [8.0, 18.0, 34.0, 75.0, 130.0, 162.0],
        [5.0, 14.0, 32.0, 80.0, 148.0, 190.0],
        [5.0, 13.0, 34.0, 72.0, 118.0, 220.0],
        [3.0, 8.0, 24.0, 64.0, 144.0, 192.0],
        [2.0, 4.0, 12.0, 33.0, 78.0, 120.0],
        [1.0, 2.0, 6.0, 12.0, 36.0, 90.0],
    ]
)  # m^2/s^2, additional integral of v^3 per metre
SHORTEST = 2.0  # s; from there to the first of `DURATIONS` the energy grows from 0
USUAL_LEG = 60.0  # s, assumed for legs that belong to no trip
LEG_SECONDS = (10.0, 30.0, 60.0, 200.0, 600.0, 1200.0)  # by which drives are cut to learn
LEG_METRES = (100.0, 200.0, 500.0, 2000.0, 5000.0)
JUDGED_METRES = 500.0  # legs by which the scatter from drive to drive is judged
PRIOR_METRES = 10e3  # driving that the tables count as at each factor
MEMORY_METRES = 150e3  # m of driving over which earlier driving is forgotten to 1/e
PRIOR_SHARE, PRIOR_DRIVES = 0.25, 4.0  # scatter before any drive; drives that it counts as
OF_LEGS = 2.8  # variance of single legs over (their energy times the energy of a stop)
MOST_RATIO = 9.0  # of squared error to squared expectation of a drive; more counts as this
MOST_SHARE = 100.0  # of scatter in a file
SPREAD_KEPT = 0.97  # share of the scatter's sums kept from drive to drive
MOST_DRIVES = 1.0 / (1.0 - SPREAD_KEPT) + 1.0  # that these sums can hold
MOST_SQUARES = MOST_DRIVES * MOST_RATIO
JUDGED_DRIVE_METRES = 1000.0  # m of a drive that scatter is judged by
MOST_FACTOR = 20.0  # of the tables
FACTORS = (ROADS.size, DURATIONS.size)  # shape of a car's factors
# States of which uneven speed has energy.
UNEVEN_STATES = [State.DRAG_AREA_OVER_ETA, State.MASS_OVER_ETA, State.REGEN_DELTA]


class Runs(NamedTuple):
    """Runs of legs of one speed: arrays of shape (n,).

    Attributes:
        duration: s.
        distance: m.
        density: of the air, kg/m^3.
    """

    duration: np.ndarray
    distance: np.ndarray
    density: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Unevenness:
    """Uneven speed as learned from a car's drives; a value.

    Attributes:
        metres: driven in legs of a minute about each speed of `MIDDLES`, shape (9,).
        by_tables: energy of legs by the tables, about each of `ROADS` and `DURATIONS`, over the
            tables' mean energy per metre, so that cars of any size compare: m, shape (3, 6).
        by_drives: the same energy as driven.
        squares: sum over drives of squared deviations from the expected energy, each over the
            squared size of the expectation (`size_of`).
        drives: number of drives in `squares`.
        cold: coldness of tyres and cabin summed over `metres`, m, shape (2,).
    """

    metres: Annotated[np.ndarray, Range(0.0, 1e12, shape=MIDDLES.shape)]
    by_tables: Annotated[np.ndarray, Range(0.0, 1e12, shape=FACTORS)] = field(
        default_factory=partial(np.zeros, FACTORS)
    )
    by_drives: Annotated[np.ndarray, Range(-1e12, 1e12, shape=FACTORS)] = field(
        default_factory=partial(np.zeros, FACTORS)
    )
    squares: Annotated[float, Range(0.0, MOST_SQUARES)] = PRIOR_SHARE**2 * PRIOR_DRIVES
    drives: Annotated[float, Range(1.0, MOST_DRIVES)] = PRIOR_DRIVES
    cold: Annotated[np.ndarray, Range(0.0, 1e12, shape=(2,))] = field(
        default_factory=partial(np.zeros, 2)
    )

    @classmethod
    def none(cls) -> Unevenness:
        """Unevenness of a car before its first drive."""
        return cls(np.zeros(MIDDLES.shape))

    @property
    def share(self) -> float:
        """1-sigma of a trip's unevenness, as a share of the size of its expectation."""
        return float(np.sqrt(self.squares / self.drives))

    @property
    def warmth(self) -> Warmth:
        """Mean coldness of tyres and cabin over the metres driven."""
        return Warmth(*np.minimum(self.cold / max(float(self.metres.sum()), 1.0), 1.0))

    def possible(self) -> Unevenness:
        """The value itself; ValueError if its scatter is out of range."""
        if self.share > MOST_SHARE:
            raise ValueError("the scatter of the unevenness is out of range")
        return self

    def factors(self, equation: Equation) -> np.ndarray:
        """Factors of the tables by road and duration, shape (3, 6).

        Before its first drive a car drives as traffic does; a vehicle outside traffic, evenly.
        """
        prior = PRIOR_METRES * equation.vehicle.in_traffic
        factors = (prior + self.by_drives) / (PRIOR_METRES + self.by_tables)
        return np.asarray(np.clip(factors, 0.0, MOST_FACTOR))

    def rows(self, equation: Equation, runs: Runs) -> np.ndarray:
        """Expected energy of runs beyond even speed, J per unit of `UNEVEN_STATES`, (n, 3)."""
        return _rows(equation, runs, self.factors(equation))

    def after(self, equation: Equation, mean: np.ndarray, drive: Path) -> Unevenness:
        """The value after one more drive; mean: of the car's states, shape (SIZE,)."""
        if not drive.duration.size or not np.abs(drive.distance).sum():
            return self
        energy = _moving(equation, drive) @ mean
        judged = self._judged(equation, mean, drive, float(energy.sum()))
        kept = math.exp(-float(np.abs(drive.distance).sum()) / MEMORY_METRES)
        metres, by_tables, by_drives, cold = (
            kept * column for column in (self.metres, self.by_tables, self.by_drives, self.cold)
        )
        unit = (_per_metre(equation, equation.vehicle.air_density) @ mean[UNEVEN_STATES]).mean(0)
        owners = [_cut(drive.duration, seconds) for seconds in LEG_SECONDS]
        owners += [_cut(np.abs(drive.distance), length) for length in LEG_METRES]
        for owner in (*owners, np.zeros(drive.duration.size, np.int64)):
            runs, more = _beyond(equation, mean, drive, owner, energy)
            usual = _rows(equation, runs, np.ones(FACTORS)) @ mean[UNEVEN_STATES]
            for node, share in _between(np.log(runs.duration), np.log(DURATIONS)):
                for road, other in _between(runs.distance / runs.duration, ROADS):
                    np.add.at(by_tables, (road, node), share * other * usual / unit[node])
                    np.add.at(by_drives, (road, node), share * other * more / unit[node])
        minutes = drive.legs(_cut(drive.duration, USUAL_LEG))
        for node, share in _between(np.abs(minutes.distance) / minutes.duration, MIDDLES):
            np.add.at(metres, node, share * np.abs(minutes.distance))
        cold += np.stack(Warmth.after(0.0).during(drive.duration)) @ np.abs(drive.distance)
        return replace(judged, metres=metres, by_tables=by_tables, by_drives=by_drives, cold=cold)

    def _judged(
        self, equation: Equation, mean: np.ndarray, drive: Path, energy: float
    ) -> Unevenness:
        """Unevenness with the deviation of a drive of this energy, J, from its expectation."""
        if np.abs(drive.distance).sum() < JUDGED_DRIVE_METRES:
            return self
        even = even_course(drive.legs(_cut(np.abs(drive.distance), JUDGED_METRES)))
        runs = runs_along(even)
        expected = self.rows(equation, runs) @ mean[UNEVEN_STATES]
        extra = energy - float((_moving(equation, even.steps) @ mean).sum())
        size = float(size_of(*map(np.sum, sizes_of(runs, expected, mean))))
        if size == 0.0:
            return self
        ratio = min(((extra - float(expected.sum())) / size) ** 2, MOST_RATIO)
        return replace(
            self,
            squares=SPREAD_KEPT * self.squares + ratio,
            drives=SPREAD_KEPT * self.drives + 1.0,
        )


def runs_along(even: Even) -> Runs:
    """The runs of even steps."""
    duration, distance, weighed = (
        np.bincount(even.run, column)
        for column in (
            even.steps.duration,
            even.steps.distance,
            even.steps.density * even.steps.duration,
        )
    )
    return Runs(duration, distance, weighed / duration)


def sizes_of(runs: Runs, energy: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Size of the expected energy of each run, J, and that times the energy of a stop, J^2."""
    stops = 0.5 * mean[State.MASS_OVER_ETA] * (runs.distance / runs.duration) ** 2
    return np.abs(energy), np.abs(energy) * stops


def size_of(energy: Any, by_stops: Any) -> Any:
    """Size of unevenness that its 1-sigma is a share of, J, from two sums of `sizes_of`.

    A driver's habit errs in the same sense on all legs. Beyond that, the number of times that a
    leg makes one speed up is random: the variance of a sum of random events of one size is the sum
    times that size.
    """
    return np.sqrt(energy**2 + OF_LEGS * by_stops)


def _rows(equation: Equation, runs: Runs, factors: np.ndarray) -> np.ndarray:
    """Energy of runs by the tables times factors, (3, 6), J per unit, shape (n, 3)."""
    grown = np.clip((runs.duration - SHORTEST) / (DURATIONS[0] - SHORTEST), 0.0, 1.0)
    speeds = _between(runs.distance / runs.duration, MIDDLES)
    between = sum(share[:, None] * factors[road] for road, share in _between(MIDDLES, ROADS))
    table = _per_metre(equation, 1.0) * np.asarray(between)[..., None]
    rows = np.zeros((len(grown), len(UNEVEN_STATES)))
    for duration, share in _between(np.log(runs.duration), np.log(DURATIONS)):
        for speed, other in speeds:
            rows += table[speed, duration] * (share * other * grown * runs.distance)[:, None]
    rows[:, 0] *= runs.density
    return rows


def _per_metre(equation: Equation, density: float) -> np.ndarray:
    """Energy per metre of the tables, J per unit, shape (speeds, durations, 3)."""
    braked = equation.vehicle.rotating_mass_factor * BRAKED
    mass = float(equation.mean[State.MASS_OVER_ETA])
    return np.stack((0.5 * density * AIR, (1.0 - equation.back) * braked, -mass * braked), -1)


def _beyond(
    equation: Equation, mean: np.ndarray, drive: Path, owner: np.ndarray, energy: np.ndarray
) -> tuple[Runs, np.ndarray]:
    """Runs of the legs of a drive, and the energy of each beyond even speed, J.

    Kinetic energy that a run passes on beyond that of even speed cancels over a trip: it counts
    as the mean of its cost and of what braking returns. The rest of speeding up and braking is
    loss.

    Args:
        equation: of the car.
        mean: of its states, shape (SIZE,).
        drive: its steps.
        owner: number of each step's leg.
        energy: of each step, J.
    """
    legs = drive.legs(owner)
    even = even_course(legs)
    runs = runs_along(even)
    run = runs_of(legs.duration, legs.distance)
    lasting = np.bincount(owner, drive.duration) > 0.0
    driven = np.bincount(run, np.bincount(owner, energy)[lasting])
    kinetic = np.bincount(run, legs.kinetic) - np.bincount(even.run, even.steps.kinetic)
    half = (
        mean[State.MASS_OVER_ETA] * (1.0 + equation.back)
        + mean[State.REGEN_DELTA] * equation.mean[State.MASS_OVER_ETA]
    )
    carried = equation.vehicle.rotating_mass_factor * kinetic * half / 2.0
    return runs, driven - np.bincount(even.run, _moving(equation, even.steps) @ mean) - carried


def _moving(equation: Equation, path: Path) -> np.ndarray:
    """Rows of moving the car with warm tyres, shape (n, SIZE)."""
    wheels = equation.wheels(*path[:5], path.density)
    return np.asarray(equation.moving_rows(wheels, path.duration, 0.0, 0.0))


def _cut(along: np.ndarray, size: float) -> np.ndarray:
    """Number of each step's leg, if legs have this size, s or m."""
    return np.maximum((np.cumsum(along) - 1e-9) // size, 0.0).astype(np.int64)


def _between(values: np.ndarray, nodes: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Numbers of the nodes below and above, with linear shares; the end nodes hold beyond."""
    below = np.clip(np.searchsorted(nodes, values) - 1, 0, len(nodes) - 2)
    share = np.clip((values - nodes[below]) / np.diff(nodes)[below], 0.0, 1.0)
    return [(below, 1.0 - share), (below + 1, share)]
