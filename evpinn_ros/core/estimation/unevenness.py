"""Between two points of a plan: the energy that uneven speed takes beyond even speed.

A plan whose points lie a minute or a kilometre apart knows mean speeds. A driver between them
speeds up and brakes again, turns, waits. The energy of that is again terms times states: the rows
of the driving (`Equation.moving_rows`) less those of legs at even speed. This difference needs no
battery, only speed. A car's own drives are cut into legs of many lengths, and the difference per
metre is learned by mean speed and duration of a leg, at nodes between which it is linear. Before
the car has driven, simulated drives stand in; what it drove long ago counts less, for roads and
habits change. It vanishes with the duration of a leg.

Even speed means: from the middle of a leg to the middle of the next, speed goes from the one mean
to the other; a trip begins and ends standing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.package_data import bundled_lines
from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.estimation.states import NAMES, SIZE, State
from evpinn_ros.core.estimation.terms import Equation
from evpinn_ros.core.signals.interval import Steps

REFERENCE = "config/reference/uneven.csv"
MIDDLES = np.array([2.0, 4.5, 7.5, 10.5, 14.0, 18.0, 22.5, 28.0, 33.0])  # m/s, of nodes
DURATIONS = np.array([10.0, 30.0, 60.0, 200.0, 600.0, 2000.0])  # s, of nodes
SHORTEST = 8.0  # s; a leg that is shorter teaches nothing
LEG_SECONDS = (10.0, 30.0, 60.0, 200.0, 600.0, 1200.0)  # by which drives are cut to learn
LEG_METRES = (100.0, 200.0, 500.0, 2000.0, 5000.0)
JUDGED_METRES = 500.0  # legs by which the scatter from drive to drive is judged
PRIOR_METRES = 2000.0  # that the simulated drives count for at each node
NODE_METRES = 200.0  # of them at a node, else its neighbour stands in
MEMORY_METRES = 150e3  # m of driving within which what was before is forgotten to a third
PRIOR_SHARE, PRIOR_DRIVES = 0.25, 4.0  # scatter before any drive, and how many it counts for
OF_LEGS = 2.8  # variance that legs have of their own, of their energy times that of a stop
MOST_RATIO = 9.0  # of a drive's variance over the size of what was expected: an odd one
MOST_SHARE = 100.0  # of that scatter, whatever a file claims
SPREAD_KEPT = 0.97  # of the scatter's sums, from drive to drive
MOST_DRIVES = 1.0 / (1.0 - SPREAD_KEPT) + 1.0  # that these sums can hold
MOST_SQUARES = MOST_DRIVES * MOST_RATIO
JUDGED_DRIVE_METRES = 1000.0  # m of a drive that scatter is judged by
SHAPE = (len(MIDDLES), len(DURATIONS))


class Path(NamedTuple):
    """Steps of driving in order, or legs of a plan: arrays of shape (n,).

    Attributes:
        duration: s.
        distance: m.
        air: integral of v^3, m^3/s^2; not used of a leg.
        kinetic: difference of v^2 / 2, J/kg; not used of a leg of a plan.
        climb: difference of height, m.
        density: of the air, kg/m^3.
        wind: against the car, m/s.
    """

    duration: np.ndarray
    distance: np.ndarray
    air: np.ndarray
    kinetic: np.ndarray
    climb: np.ndarray
    density: np.ndarray
    wind: np.ndarray

    def legs(self, owner: np.ndarray) -> Path:
        """Sums of the steps of each leg; owner: number of each step's leg, from 0 on."""
        count = int(owner[-1]) + 1
        sums = [np.bincount(owner, column, count) for column in self]
        steps = np.maximum(np.bincount(owner, minlength=count), 1)
        kept = sums[0] > 0.0
        means = (sums[5] / steps, sums[6] / steps)
        return Path(*(column[kept] for column in (*sums[:5], *means)))


@dataclass(frozen=True, slots=True, eq=False)
class Unevenness:
    """Lessons of a car's driving; a value.

    Attributes:
        metres: driven in legs about each node of speed and duration, shape `SHAPE`.
        rows: sum of the differences by state, J per unit, shape (*SHAPE, SIZE).
        squares: sum over drives of squared energy by which they strayed from what was expected,
            over the squared size of that (`size_of`).
        drives: how many these are.
        names: of the states.
    """

    metres: Annotated[np.ndarray, Range(0.0, 1e12, shape=SHAPE)]
    rows: Annotated[np.ndarray, Range(-1e18, 1e18, shape=(*SHAPE, SIZE), by_state=True)]
    squares: Annotated[float, Range(0.0, MOST_SQUARES)] = PRIOR_SHARE**2 * PRIOR_DRIVES
    drives: Annotated[float, Range(1.0, MOST_DRIVES)] = PRIOR_DRIVES
    names: tuple[str, ...] = NAMES

    @classmethod
    def none(cls) -> Unevenness:
        """Before any drive."""
        return cls(np.zeros(SHAPE), np.zeros((*SHAPE, SIZE)))

    @property
    def share(self) -> float:
        """1-sigma of a trip's unevenness over the size of what is expected of it."""
        return float(np.sqrt(self.squares / self.drives))

    def of_legs(self, equation: Equation, mean: np.ndarray, legs: Path | Steps) -> np.ndarray:
        """Expected rows of n legs beyond those at even speed, J per unit, shape (n, SIZE)."""
        table = self._per_metre(equation, mean)
        way = np.abs(legs.distance) * np.minimum(legs.duration / DURATIONS[0], 1.0)
        rows = np.zeros((len(way), SIZE))
        for speed, duration, share in _nodes(legs):
            rows += table[speed, duration] * (share * way)[:, None]
        return rows

    def _per_metre(self, equation: Equation, mean: np.ndarray) -> np.ndarray:
        """Expected rows per metre at each node of speed and duration, shape (*SHAPE, SIZE).

        A longer leg of one mean speed has more room for unevenness: where its energy would fall,
        for few metres taught it, the nodes have their mean in common.

        Args:
            equation: of the car.
            mean: of its states, shape (SIZE,).
        """
        weight = self.metres + PRIOR_METRES
        table = (self.rows + PRIOR_METRES * prior_rows(equation)) / weight[..., None]
        energy = table @ mean
        for rows, weights, energies in zip(table, weight, energy.tolist(), strict=True):
            for begin, end in _rising(energies, weights.tolist()):
                common = weights[begin:end] @ rows[begin:end] / weights[begin:end].sum()
                rows[begin:end] = common * (common @ mean > 0.0)
        return np.asarray(table)

    def after(self, equation: Equation, mean: np.ndarray, drive: Path) -> Unevenness:
        """With the steps of one more drive; its scatter is judged by the car's mean, (SIZE,)."""
        if not drive.duration.size or not np.abs(drive.distance).sum():
            return self
        driven = _moving(equation, drive)
        judged = self._judged(equation, mean, drive, driven)
        kept = math.exp(-float(np.abs(drive.distance).sum()) / MEMORY_METRES)
        metres, rows = kept * self.metres, kept * self.rows
        _add_drive(metres, rows, equation, drive, driven)
        return replace(judged, metres=metres, rows=rows)

    def _judged(
        self, equation: Equation, mean: np.ndarray, drive: Path, driven: np.ndarray
    ) -> Unevenness:
        """With the scatter of one more drive about what was expected of it."""
        if np.abs(drive.distance).sum() < JUDGED_DRIVE_METRES:
            return self
        legs = drive.legs(_cut(np.abs(drive.distance), JUDGED_METRES))
        of_each = self.of_legs(equation, mean, legs) @ mean
        extra = float((driven.sum(0) - even_rows(equation, legs).sum(0)) @ mean)
        size = float(size_of(np.abs(of_each), stops_of(legs, mean))[-1])
        if size == 0.0:
            return self
        ratio = min(((extra - float(of_each.sum())) / size) ** 2, MOST_RATIO)
        return replace(
            self,
            squares=SPREAD_KEPT * self.squares + ratio,
            drives=SPREAD_KEPT * self.drives + 1.0,
        )


def _rising(values: Sequence[float], weights: Sequence[float]) -> list[tuple[int, int]]:
    """Runs of values, begin and end, whose weighted means rise (pool adjacent violators)."""
    runs: list[tuple[int, int, float, float]] = []
    for place, (mean, weight) in enumerate(zip(values, weights, strict=True)):
        begin = place
        while runs and runs[-1][2] > mean:
            begin, _, before, heavy = runs.pop()
            mean, weight = (before * heavy + mean * weight) / (heavy + weight), heavy + weight
        runs.append((begin, place + 1, mean, weight))
    return [(begin, end) for begin, end, *_ in runs]


def stops_of(legs: Path, mean: np.ndarray) -> np.ndarray:
    """Energy of speeding up once to the mean speed of each leg, J, shape (n,)."""
    return np.asarray(0.5 * mean[State.MASS] * (legs.distance / legs.duration) ** 2)


def size_of(energy: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Size of unevenness that scatter goes by, J, up to the end of each leg, shape (n,).

    A driver's habit is off in the same sense on all legs. Beyond that, how often a leg makes one
    speed up is a matter of chance: where so many events of one size come by chance, the variance
    of their sum is the sum times the size of one.

    Args:
        energy: size of what is expected of each leg, J, shape (n,): energies of legs may cancel,
            their scatter does not.
        stops: energy of one event, J, shape (n,).
    """
    return np.sqrt(np.cumsum(energy) ** 2 + OF_LEGS * np.cumsum(energy * stops))


def _add_drive(
    metres: np.ndarray, rows: np.ndarray, equation: Equation, drive: Path, driven: np.ndarray
) -> None:
    """Add a drive, cut into legs in many ways and whole, to the sums of the nodes about these."""
    owners = [_cut(drive.duration, seconds) for seconds in LEG_SECONDS]
    owners += [_cut(np.abs(drive.distance), metres) for metres in LEG_METRES]
    for owner in (*owners, np.zeros(drive.duration.size, np.int64)):
        legs = drive.legs(owner)
        more = _summed(driven, owner, drive.duration) - even_rows(equation, legs)
        more -= _carried(equation, legs)
        known = legs.duration >= SHORTEST
        way = np.abs(legs.distance)
        for speed, duration, share in _nodes(legs):
            share, nodes = share[known], (speed[known], duration[known])
            np.add.at(metres, nodes, share * way[known])
            np.add.at(rows, nodes, share[:, None] * more[known])


def _carried(equation: Equation, legs: Path) -> np.ndarray:
    """Rows of the kinetic energy that a leg carries on beyond that of even speed, (n, SIZE).

    It is of no leg but of the trip, over which it adds up to nothing: halfway between what it
    costs to gain and what braking gives back. What is left of speeding up and braking is loss.
    """
    speed = np.concatenate(([0.0], np.abs(legs.distance) / legs.duration, [0.0]))
    half = legs.duration / 2.0
    joined = _beside(half)
    gained = np.diff(speed**2) / 2.0
    even = gained[:-1] * half / joined[:-1] + gained[1:] * half / joined[1:]
    beyond = equation.vehicle.rotating_mass_factor * (legs.kinetic - even)
    rows = np.zeros((len(beyond), SIZE))
    rows[:, State.MASS] = beyond * (1.0 + equation.back) / 2.0
    rows[:, State.BACK] = beyond * float(equation.mean[State.MASS]) / 2.0
    return rows


def legs_of_speed(
    duration: np.ndarray,
    distance: np.ndarray,
    climb: Any = 0.0,
    *,
    density: float,
    wind: Any = 0.0,
) -> Path:
    """Legs by duration, s, and distance, m, shape (n,); the rest is of all or of each."""
    zero = np.zeros_like(duration)
    return Path(duration, distance, zero, zero, climb + zero, density + zero, wind + zero)


def even_rows(equation: Equation, legs: Path, *, alone: bool = False) -> np.ndarray:
    """Rows of legs at even speed without loads, J per unit, shape (n, SIZE).

    Args:
        equation: of the car.
        legs: of one trip.
        alone: True for legs of no trip: before and after each, speed and slope go on.
    """
    if alone:
        legs = legs._replace(air=_air(legs), kinetic=np.zeros_like(legs.duration))
        return _moving(equation, legs)
    joined = even_path(legs)
    rows, half = _moving(equation, joined), 0.5 * legs.duration
    before, after = half / joined.duration[:-1], half / joined.duration[1:]
    return np.asarray(rows[:-1] * before[:, None] + rows[1:] * after[:, None])


def even_path(legs: Path) -> Path:
    """Steps from the middle of each leg to that of the next, the first and last from standing."""
    half = Path._make((*(0.5 * column for column in legs[:5]), legs.density, legs.wind))
    ends = np.concatenate(([0.0], np.abs(legs.distance) / legs.duration, [0.0]))
    return Path(
        _beside(half.duration),
        _beside(half.distance),
        _beside(_air(half)),
        np.diff(ends**2) / 2.0,
        _beside(half.climb),
        np.append(half.density, half.density[-1]),
        np.zeros(len(ends) - 1),
    )


def _air(legs: Path) -> np.ndarray:
    """Integral of v^3 of legs at even speed, m^3/s^2, with the wind."""
    flow = np.abs(legs.distance) / legs.duration + legs.wind
    return np.asarray(flow * np.abs(flow) * np.abs(legs.distance))


def _beside(half: np.ndarray) -> np.ndarray:
    """Sums of the halves on both sides of each border between legs."""
    return np.append(half, 0.0) + np.concatenate(([0.0], half))


def _moving(equation: Equation, path: Path) -> np.ndarray:
    """Rows of what moves the car, tyres warm, shape (n, SIZE)."""
    wheels = equation.wheels(*path[:5], path.density)
    return np.asarray(equation.moving_rows(wheels, path.duration, 0.0, 0.0))


def _cut(along: np.ndarray, size: float) -> np.ndarray:
    """Numbers of the legs of this size, s or m, that steps belong to."""
    return np.maximum((np.cumsum(along) - 1e-9) // size, 0.0).astype(np.int64)


def _summed(rows: np.ndarray, owner: np.ndarray, duration: np.ndarray) -> np.ndarray:
    """Sums of rows by their owners, of those that last, shape (legs, k)."""
    count = int(owner[-1]) + 1
    begins = np.searchsorted(owner, np.arange(count))
    kept = np.bincount(owner, duration, count) > 0.0
    return np.asarray(np.add.reduceat(rows, begins[kept], axis=0))


def _nodes(legs: Path | Steps) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The four nodes about each leg: numbers of speed and duration, and its share in each."""
    speeds = _between(np.abs(legs.distance) / legs.duration, MIDDLES)
    durations = _between(np.log(legs.duration), np.log(DURATIONS))
    return [(i, j, share * other) for i, share in speeds for j, other in durations]


def _between(values: np.ndarray, nodes: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Numbers of the nodes below and above, and shares linear between them; ends reach on."""
    below = np.clip(np.searchsorted(nodes, values) - 1, 0, len(nodes) - 2)
    share = np.clip((values - nodes[below]) / np.diff(nodes)[below], 0.0, 1.0)
    return [(below, 1.0 - share), (below + 1, share)]


@lru_cache(maxsize=8)
def prior_rows(equation: Equation) -> np.ndarray:
    """Rows per metre of simulated drives, shape (*SHAPE, SIZE).

    They are of cars in traffic: what is slower drives evenly until it has shown otherwise.
    """
    metres, rows = np.zeros(SHAPE), np.zeros((*SHAPE, SIZE))
    if not equation.vehicle.in_traffic:
        return rows
    for line in bundled_lines(REFERENCE):
        drive = _drive_of(np.array(line.split(","), float), equation.vehicle.air_density)
        _add_drive(metres, rows, equation, drive, _moving(equation, drive))
    places = np.indices(SHAPE).reshape(2, -1).T
    there = places[metres.ravel() >= NODE_METRES]
    away = np.abs(places[:, None] - there) @ (1, len(MIDDLES))  # rather of another speed
    nearest = tuple(there[away.argmin(1)].T)
    return np.asarray((rows[nearest] / metres[nearest][:, None]).reshape(rows.shape))


def _drive_of(speed: np.ndarray, density: float) -> Path:
    """A drive on a flat road from its speed once a second, m/s."""
    start, end = speed[:-1], speed[1:]
    ones = np.ones_like(start)
    return Path(
        duration=ones,
        distance=(start + end) / 2.0,
        air=(start + end) * (start**2 + end**2) / 4.0,
        kinetic=(end**2 - start**2) / 2.0,
        climb=0.0 * ones,
        density=density * ones,
        wind=0.0 * ones,
    )
