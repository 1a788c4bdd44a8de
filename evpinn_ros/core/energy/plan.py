"""Plans: points along one trip or many, or legs of a trip, with their conditions.

Between two points, distance is the cubic in time with the given speeds at its ends, so that it
agrees with length and speeds at once. A leg has length, duration and perhaps climb, no speeds.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
import math
from typing import NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.charge import FIRST_STEP, Uncertain
from evpinn_ros.core.signals.readings import MAX_WIND

MAX_SPEED = 100.0  # m/s; a faster plan is refused
MAX_POINTS = 50_000  # of one trip: more than an hour at 10 Hz, or 1000 km in steps of 20 m
LONGEST = 14 * 86_400.0  # s from the first point to the last; more is not one trip
UNITS_APART = 3.0  # speeds in km/h make 3.6 times the distance, one in km a thousandth of it
LEAST_LENGTH = 50.0  # m; shorter profiles are checked as if this long
SLOWEST_TRIP = 0.1  # m/s while moving; slower plans have their lengths in km
CLIMB_TOLERANCE = 1e-6  # m by which a climb may exceed its length, from rounding
CONDITION_RANGES = {
    "temperature": (-60.0, 60.0),  # degrees Celsius
    "heating": (0.0, 20e3),  # W, more than the heaters of any car
    "head_wind": (-MAX_WIND, MAX_WIND),  # m/s
    "payload": (0.0, 5000.0),  # kg
    "charge": (0.0, 1.0),
    "stood": (0.0, 1e8),  # s, some years
    "prewarmed": (0.0, 1.0),
    "steady": (0.0, 1.0),
}
COLUMNS = ("time", "distance", "speed", "elevation")
ROUNDS = 40  # of finding corners; then all points that are left are kept, to bound the time
Measure: TypeAlias = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Distance of points from the line between two others, in tolerances, by the indices of all."""


class PlanError(InputError):
    """A plan cannot be driven; the text gives the reason in one line."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Points of a trip, or of a batch of trips of equal length; checked when made.

    Attributes:
        time: shape (n,) or (batch, n), s, strictly rising.
        distance: same shape, m along the road, never falling.
        speed: same shape, m/s, 0 to `MAX_SPEED`.
        elevation: same shape, m.
        commanded: True if a controller follows the plan, so that speed is a straight line between
            any two points; otherwise uneven speed between them is expected.
        level: True if a constant elevation means a level road, False if it means unknown heights.

    Raises:
        PlanError: the arrays are not a trip.
    """

    time: np.ndarray
    distance: np.ndarray
    speed: np.ndarray
    elevation: np.ndarray
    commanded: bool = False
    level: bool = False

    def __post_init__(self) -> None:
        check_arrays({name: getattr(self, name) for name in COLUMNS})
        length, climb = np.diff(self.distance), np.diff(self.elevation)
        duration = np.diff(self.time)
        refuse(duration <= 0, "time does not rise", after=1)
        refuse(self.time - self.time[..., :1] > LONGEST, f"later than {LONGEST / 86_400:g} days")
        refuse(self.speed < 0, "speed is negative")
        refuse(self.speed > MAX_SPEED, f"speed is above {MAX_SPEED:g} m/s")
        refuse(length < 0, "distance goes back", after=1)
        refuse(length > MAX_SPEED * duration, f"faster than {MAX_SPEED:g} m/s", after=1)
        climbs = np.abs(climb) > length + CLIMB_TOLERANCE
        refuse(climbs, "climbs more than it travels", after=1)

    def quicker(self, factor: float) -> Plan:
        """The plan with all speeds times a factor; stops last as long.

        Raises:
            PlanError: that is too fast.
        """
        duration, moves = np.diff(self.time), np.diff(self.distance) > 0.0
        duration = np.where(moves, duration / factor, duration)
        time = self.time[..., :1] + np.cumsum(duration, axis=-1)
        time = np.concatenate((self.time[..., :1], time), axis=-1)
        return replace(self, time=time, speed=self.speed * factor)


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Legs of road that a car drives, checked when made; `legs_of_trip` makes those of a trip.

    Attributes:
        length: m along the road, shape (n,) as all; a leg without length is a stop.
        duration: s, above 0.
        climb: m from its start to its end; 0 where unknown.
        height_known: True where `climb` is known.
        commanded: as in `Plan`.
        onward: True if the road goes on, so that the car does not stop at its end.

    Raises:
        PlanError: the arrays are not legs.
    """

    length: np.ndarray
    duration: np.ndarray
    climb: np.ndarray
    height_known: np.ndarray
    commanded: bool = False
    onward: bool = False

    def __post_init__(self) -> None:
        columns = self.length, self.duration, self.climb, self.height_known
        shapes = {column.shape for column in columns}
        if len(shapes) != 1 or len(self.length.shape) != 1 or not self.length.size:
            raise PlanError(f"legs need arrays of one length, shapes are {sorted(shapes)}")
        for name in ("length", "duration", "climb"):
            refuse(~np.isfinite(getattr(self, name)), f"{name} is not finite", "leg")
        refuse(self.length < 0, "length is negative", "leg")
        refuse(self.duration <= 0, "duration is not above 0", "leg")
        fast = self.length > MAX_SPEED * self.duration
        refuse(fast, f"faster than {MAX_SPEED:g} m/s (lengths in m, durations in s?)", "leg")
        refuse(np.abs(self.climb) > self.length + CLIMB_TOLERANCE, "climbs more than it is long",
                "leg")  # fmt: skip

    def quicker(self, factor: float) -> Legs:
        """The legs with all speeds times a factor; stops last as long.

        Raises:
            PlanError: that is too fast.
        """
        duration = np.where(self.length > 0.0, self.duration / factor, self.duration)
        return replace(self, duration=duration)


@dataclass(frozen=True, slots=True)
class PlanConditions:
    """Conditions of a planned trip as its planner expects them; None where not given.

    Attributes:
        temperature: of the air outside, degrees Celsius.
        heating: electric power of heating and air conditioning, W.
        head_wind: against the car all the way, m/s over ground; negative from behind.
        payload: people and luggage, kg.
        charge: state of charge at the start, 0..1.
        stood: time that the car stands before the trip, s, in which tyres and cabin cool.
        prewarmed: share of the cabin's warmth that the charger gave before the start.
        steady: 1 if speeds are commanded, 0 if expected (`Plan.commanded`); None: as the plan has
            it.

    Raises:
        PlanError: a number is impossible.
    """

    temperature: float | None = None
    heating: float | None = None
    head_wind: float | None = None
    payload: float | None = None
    charge: float | None = None
    stood: float | None = None
    prewarmed: float | None = None
    steady: float | None = None

    def __post_init__(self) -> None:
        for name, (least, most) in CONDITION_RANGES.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                if most == 1.0:
                    raise PlanError(f"{name}: {value:g} is not a share, which is 0 to 1")
                raise PlanError(f"{name} is {value:g}, not {least:g} to {most:g}")

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the conditions that are not None."""
        return tuple(name for name in CONDITION_RANGES if getattr(self, name) is not None)

    def or_else(self, others: PlanConditions) -> PlanConditions:
        """These conditions, completed by others."""
        return replace(others, **{name: getattr(self, name) for name in self.given})

    def charge_from(self, measured: Uncertain) -> Uncertain:
        """State of charge at the start, 0..1: the given one, else `measured`."""
        if self.charge is None:
            return measured
        return Uncertain(self.charge, FIRST_STEP / math.sqrt(12.0))  # rounded as on a display


UNSAID = PlanConditions()


class Question(NamedTuple):
    """A planner's question about one plan.

    Attributes:
        name: of the plan.
        together: key of the plans that are asked together, or None.
        conditions: of this plan, completed by those of all plans.
        along: whether to compute sigma at each point, not only at the last.
    """

    name: str
    together: Hashable = None
    conditions: PlanConditions = UNSAID
    along: bool = True


UNNAMED = Question("")


def plan_from_speed_profile(
    time: np.ndarray,
    distance: np.ndarray | None,
    speed: np.ndarray,
    elevation: np.ndarray | None = None,
) -> Plan:
    """A plan from a speed profile: time, s, distance, m, and speed, m/s, each of shape (n,).

    Distance defaults to the integral of speed; without elevation, m, heights are unknown. Time and
    distance count from the first point.

    Raises:
        PlanError: the profile is invalid, or the integral of its speeds is more than `UNITS_APART`
            times its distance.
    """
    check_size(len(time))
    time, speed = as_floats(time), as_floats(speed)
    check_arrays({"time": time, "speed": speed})
    driven = travelled(time, speed)
    distance = driven if distance is None else as_floats(distance)
    height = np.zeros_like(time) if elevation is None else as_floats(elevation)
    if distance.shape == time.shape and (np.diff(time) > 0).all():
        length = float(distance[-1] - distance[0])
        if driven[-1] > UNITS_APART * max(length, LEAST_LENGTH):
            raise PlanError(
                f"its speeds make {driven[-1]:.0f} m, its distance is {length:.0f} m; both in SI "
                "units?"
            )
    level = elevation is not None
    return Plan(time - time[:1], distance - distance[:1], speed, height, level=level)


def travelled(time: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Distance since the first of n times, s, by speeds, m/s, linear between: m, shape (n,)."""
    return sums(np.diff(time) * (speed[1:] + speed[:-1]) / 2)


def sums(steps: np.ndarray) -> np.ndarray:
    """Cumulative sums of n steps from 0, shape (n + 1,)."""
    return np.concatenate(([0.0], np.cumsum(steps)))


def telling(count: int, *measures: Measure) -> np.ndarray:
    """True for the corners of a curve of `count` points: those off the lines between the others.

    While a line misses points, the farthest of them becomes a corner, by one measure after
    another: where all measures before it fit, each is largest at a corner.
    """
    number = np.arange(count)
    corner = np.ones(count, bool)
    here, start, end = number[1:-1], number[:-2], number[2:]
    corner[1:-1] = np.any([away(here, start, end) > 1.0 for away in measures], axis=0)
    for away in measures:
        for attempt in range(ROUNDS):  # a line over many points may miss some of them
            kept, others = np.flatnonzero(corner), np.flatnonzero(~corner)
            line = np.searchsorted(kept, others)
            far = away(others, kept[line - 1], kept[line])
            missed = np.flatnonzero(far > 1.0)
            if not missed.size:
                break
            if attempt < ROUNDS - 1:
                missed = missed[np.lexsort((-far[missed], line[missed]))]
                missed = missed[np.unique(line[missed], return_index=True)[1]]
            corner[others[missed]] = True
    return corner


def beside_line(along: np.ndarray, column: np.ndarray, tolerance: np.ndarray | float) -> Measure:
    """The `Measure` of a column over `along`: distance from a line over its tolerance."""
    allowed = np.broadcast_to(tolerance, along.shape)

    def away(here: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        whole = along[end] - along[start]
        share = np.divide(along[here] - along[start], whole, out=0.0 * whole, where=whole > 0.0)
        line = column[start] + share * (column[end] - column[start])
        return np.asarray(np.abs(column[here] - line) / allowed[here])

    return away


def legs_of(length: np.ndarray, duration: np.ndarray, climb: np.ndarray | None = None) -> Legs:
    """Legs that need not be consecutive: lengths, m, durations, s, and climbs, m, shape (n,).

    A climb of NaN is unknown.

    Raises:
        PlanError: the arrays are not legs.
    """
    length, duration = as_floats(length), as_floats(duration)
    climb = np.full(length.shape, np.nan) if climb is None else as_floats(climb)
    known = ~np.isnan(climb)
    return Legs(length, duration, np.where(known, climb, 0.0), known)


def legs_of_trip(
    length: np.ndarray, duration: np.ndarray, climb: np.ndarray | None = None
) -> Legs:
    """The legs of one trip, in order; arguments as in `legs_of`.

    Raises:
        PlanError: the legs are not a trip, or so slow that their lengths are in km.
    """
    check_size(np.size(length))
    legs = legs_of(length, duration, climb)
    length, duration = legs.length, legs.duration
    total, driven = float(duration.sum()), float(duration[length > 0].sum())
    if total > LONGEST:
        raise PlanError(f"it takes {total / 86_400:.3g} days; the most are {LONGEST / 86_400:g}")
    if float(length.sum()) < SLOWEST_TRIP * driven:
        speed = float(length.sum()) / driven
        raise PlanError(f"it drives {speed:.2g} m/s on the whole (lengths in m, durations in s?)")
    return legs


def points_of(plan: Plan | Legs) -> Plan:
    """Points of a plan; those of legs are their ends, at the mean speed of both neighbours."""
    if isinstance(plan, Plan):
        return plan
    mean = np.concatenate(([0.0], plan.length / plan.duration, [0.0]))
    speed = (mean[1:] + mean[:-1]) / 2.0
    level = not plan.length[~plan.height_known].any()
    return Plan(sums(plan.duration), sums(plan.length), speed, sums(plan.climb), level=level)


def check_size(points: int) -> None:
    """Refuse more points than one trip may have."""
    if points > MAX_POINTS:
        raise PlanError(f"{points} points are more than {MAX_POINTS}")


def as_floats(values: np.ndarray) -> np.ndarray:
    """The values as an array of floats."""
    return np.asarray(values, dtype=float)


def check_arrays(named: dict[str, np.ndarray]) -> None:
    """Refuse columns of different shapes, of fewer than two points, or that are not finite."""
    first = next(iter(named.values()))
    if any(array.shape != first.shape for array in named.values()):
        shapes = ", ".join(f"{name} {array.shape}" for name, array in named.items())
        raise PlanError(f"arrays differ in shape: {shapes}")
    if first.ndim not in (1, 2) or first.size == 0 or first.shape[-1] < 2:
        raise PlanError(f"needs at least two points, shape is {first.shape}")
    for name, array in named.items():
        refuse(~np.isfinite(array), f"{name} is not finite")


def refuse(wrong: np.ndarray, reason: str, what: str = "point", *, after: int = 0) -> None:
    """Raise a PlanError if any element is wrong; it names the first place, counted from 1.

    `after`: 1 if the elements are between points; the error then names the second of both.
    """
    if wrong.any():
        *trip, place = (1 + np.argwhere(wrong)[0]).tolist()
        where = f"{what} {place + after}"
        raise PlanError(f"{reason} at {where}{''.join(f' of trip {number}' for number in trip)}")
