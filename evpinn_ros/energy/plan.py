"""Plan of a planner: points along one trip or many, or legs of a trip, and its conditions.

Between two points distance is the cubic that has the given speeds at its ends, so that legs agree
with their length, their climb and their speeds at once. Of a leg no more than its length and its
duration is known.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.signals.road import MAX_WIND

MAX_SPEED = 100.0  # m/s: faster is a teleport
MAX_POINTS = 50_000  # of one trip: more than an hour at 10 Hz, or 1000 km in steps of 20 m
LONGEST = 14 * 86_400.0  # s from the first point to the last: more is not one trip
MAX_LEG = 10e3  # m between two points without stamps: farther is a teleport
NOMINAL_SPEED = 50 / 3.6  # m/s, where a path has no usable stamps
COMFORT_ACCELERATION = 1.0  # m/s^2, gentle for a person standing in a bus as well
COMFORT_LATERAL = 2.0  # m/s^2, what drivers take in a bend without hurry
SLOWEST = 1.0  # m/s through the sharpest bend
BEND = 10.0  # m before and after a point, over which the bend of the path is taken
# Most m, and s, between points of a nominal profile, where the path has fewer.
NOMINAL_STEP, NOMINAL_SECONDS = 25.0, 2.0
UNITS_APART = 3.0  # speeds in km/h make 3.6 times the distance, one in km a thousandth of it
LEAST_LENGTH = 50.0  # m of a profile from which that can be seen
SLOWEST_TRIP = 0.1  # m/s while it moves: no jam is slower, but lengths in km are
TINY = 1e-6  # m^2/s^2
CLIMB_TOLERANCE = 1e-6  # m: rounding of climb against length
CONDITION_RANGES = {
    "temperature": (-60.0, 60.0),  # degrees Celsius
    "heating": (0.0, 20e3),  # W, more than the heaters of any car
    "head_wind": (-MAX_WIND, MAX_WIND),  # m/s
    "payload": (0.0, 5000.0),  # kg
    "charge": (0.0, 1.0),
    "stood": (0.0, 1e8),  # s, some years
    "prewarmed": (0.0, 1.0),
}


class PlanError(InputError):
    """A plan cannot be driven; the text is the reason in one line."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Points of a trip, or of a batch of trips of equal length; checked when made.

    Attributes:
        time: shape (n,) or (batch, n), s, strictly rising.
        distance: same shape, m along the road, never falling.
        speed: same shape, m/s, 0 to `MAX_SPEED`.
        elevation: same shape, m.

    Raises:
        PlanError: the arrays are no trip.
    """

    time: np.ndarray
    distance: np.ndarray
    speed: np.ndarray
    elevation: np.ndarray

    def __post_init__(self) -> None:
        _check_arrays({name: getattr(self, name) for name in self.__slots__})
        length, climb = np.diff(self.distance), np.diff(self.elevation)
        duration = np.diff(self.time)
        _refuse(duration <= 0, "time does not rise")
        _refuse(self.time - self.time[..., :1] > LONGEST, f"later than {LONGEST / 86_400:g} days")
        _refuse(self.speed < 0, "speed is negative")
        _refuse(self.speed > MAX_SPEED, f"speed is above {MAX_SPEED:g} m/s")
        _refuse(length < 0, "distance goes back")
        _refuse(length > MAX_SPEED * duration, f"faster than {MAX_SPEED:g} m/s")
        _refuse(np.abs(climb) > length + CLIMB_TOLERANCE, "climbs more than it travels")

    def quicker(self, factor: float) -> Plan:
        """Plan along this road with all speeds times a factor; it stands as long as before.

        Raises:
            PlanError: that is too fast.
        """
        duration, moves = np.diff(self.time), np.diff(self.distance) > 0.0
        duration = np.where(moves, duration / factor, duration)
        time = self.time[..., :1] + np.cumsum(duration, axis=-1)
        time = np.concatenate((self.time[..., :1], time), axis=-1)
        return Plan(time, self.distance, self.speed * factor, self.elevation)


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Legs of road that a car drives, checked when made; `legs_of_trip` makes those of a trip.

    Attributes:
        length: shape (n,), m along the road; a leg without length is a stop. So are the others:
        duration: s, above 0.
        climb: m from its start to its end; 0 where unknown.
        limit: speed limit, m/s; NaN where unknown.
        height_known: True where `climb` is known.
        start_speed: m/s; NaN where unknown.
        end_speed: m/s; NaN where unknown.

    Raises:
        PlanError: the arrays are no legs.
    """

    length: np.ndarray
    duration: np.ndarray
    climb: np.ndarray
    limit: np.ndarray
    height_known: np.ndarray
    start_speed: np.ndarray
    end_speed: np.ndarray

    def __post_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in self.__slots__}
        if len(shapes) != 1 or len(self.length.shape) != 1 or not self.length.size:
            raise PlanError(f"legs need arrays of one length, shapes are {sorted(shapes)}")
        for name in ("length", "duration", "climb"):
            _refuse(~np.isfinite(getattr(self, name)), f"{name} is not finite", "leg")
        _refuse(self.length < 0, "length is negative", "leg")
        _refuse(self.duration <= 0, "duration is not above 0", "leg")
        fast = self.length > MAX_SPEED * self.duration
        _refuse(fast, f"faster than {MAX_SPEED:g} m/s (lengths in m, durations in s?)", "leg")
        _refuse(np.abs(self.climb) > self.length + CLIMB_TOLERANCE, "climbs more than it is long",
                "leg")  # fmt: skip
        for name in ("limit", "start_speed", "end_speed"):
            speed = getattr(self, name)
            wrong = ~np.isnan(speed) & ~((speed >= 0) & (speed <= MAX_SPEED))
            _refuse(wrong, f"{name} is not between 0 and {MAX_SPEED:g} m/s", "leg")

    def quicker(self, factor: float) -> Legs:
        """Legs of this road with all speeds times a factor; stops last as long.

        Raises:
            PlanError: that is too fast.
        """
        return replace(
            self,
            duration=np.where(self.length > 0.0, self.duration / factor, self.duration),
            start_speed=self.start_speed * factor,
            end_speed=self.end_speed * factor,
        )


@dataclass(frozen=True, slots=True)
class PlanConditions:
    """Conditions of a planned trip as its planner expects them; None where not given.

    Attributes:
        temperature: of the air outside, degrees Celsius.
        heating: electric power of heating and air conditioning, W.
        head_wind: against the car at the start, m/s over ground; negative from behind.
        payload: people and luggage, kg.
        charge: state of charge at the start, 0..1.
        stood: for how long the car stands before it, s: tyres and cabin cool meanwhile.
        prewarmed: share of the cabin's warmth that the charger gave before the start.

    Raises:
        PlanError: a number that no trip has.
    """

    temperature: float | None = None
    heating: float | None = None
    head_wind: float | None = None
    payload: float | None = None
    charge: float | None = None
    stood: float | None = None
    prewarmed: float | None = None

    def __post_init__(self) -> None:
        for name, (least, most) in CONDITION_RANGES.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise PlanError(f"{name} is {value:g}, not {least:g} to {most:g}")

    @property
    def given(self) -> tuple[str, ...]:
        """Names of those that are given."""
        return tuple(name for name in CONDITION_RANGES if getattr(self, name) is not None)

    def or_else(self, others: PlanConditions) -> PlanConditions:
        """These, and those of others that are not given here."""
        return replace(others, **{name: getattr(self, name) for name in self.given})


UNSAID = PlanConditions()


class Question(NamedTuple):
    """A planner's question about one plan.

    Attributes:
        name: of the plan.
        together: what it has in common with those asked together with it, or None.
        conditions: of this plan; what they leave out is as all plans have it.
        along: whether sigma is wanted at each of its points, and not at the last alone.
    """

    name: str
    together: Hashable = None
    conditions: PlanConditions = UNSAID
    along: bool = True


UNNAMED = Question("")


def plan_from_path(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    stamps: np.ndarray | None = None,
    *,
    nominal_speed: float = NOMINAL_SPEED,
) -> Plan:
    """A plan from path points.

    With stamps, speed is the slope of a monotone cubic through distance over time: zero where
    the path waits. Stamps that are absent or all equal are unusable; the car then starts and
    ends at rest, accelerates and brakes with `COMFORT_ACCELERATION`, takes bends with
    `COMFORT_LATERAL` and else drives `nominal_speed`.

    Args:
        x: shape (n,), m, n >= 2; so are y and z.
        y: m.
        z: m, elevation.
        stamps: shape (n,), s, or None.
        nominal_speed: m/s.

    Raises:
        PlanError: the points are no trip.
    """
    _check_size(len(x))
    points = {"x": _array(x), "y": _array(y), "z": _array(z)}
    if stamps is not None:
        points["stamps"] = _array(stamps)
    _check_arrays(points)
    with np.errstate(over="ignore"):  # an infinite leg is too long as well
        legs = np.sqrt(sum(np.diff(points[axis]) ** 2 for axis in "xyz"))
    time = points.get("stamps")
    if time is not None and np.ptp(time) == 0:
        time = None
    farthest = MAX_LEG if time is None else MAX_SPEED * LONGEST
    _refuse(legs > farthest, f"jumps farther than {farthest / 1e3:g} km")
    distance = np.concatenate(([0.0], np.cumsum(legs)))
    if time is None:
        return _nominal_plan(distance, points, nominal_speed)
    duration = np.diff(time)
    _refuse(duration < 0, "time goes back")
    # A point given twice is one; so is one that is apart by less than rounding of the distance.
    kept = np.concatenate(([True], (duration > 0) | (np.diff(distance) > 0)))
    time, distance, elevation = time[kept] - time[0], distance[kept], points["z"][kept]
    _refuse(np.diff(distance) > MAX_SPEED * np.diff(time), f"faster than {MAX_SPEED:g} m/s")
    speed = monotone_slopes(time, distance)
    return Plan(time, distance, np.clip(speed, 0.0, MAX_SPEED), elevation)


def monotone_slopes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Slopes at the points, shape (n,), of the monotone cubic through y that never falls.

    Fritsch and Butland (1984): zero beside a stretch where y rests, else a harmonic mean. As
    `scipy.interpolate.PchipInterpolator`, which takes a third of all that the nodes load.
    """
    step = np.diff(x)
    slope = np.diff(y) / step
    if len(slope) == 1:
        return np.repeat(slope, 2)
    near = np.array([2.0 * step[1:] + step[:-1], step[1:] + 2.0 * step[:-1]])
    with np.errstate(divide="ignore", over="ignore"):
        inner = near.sum(axis=0) / (near[0] / slope[:-1] + near[1] / slope[1:])
    first, last = (
        max(0.0, ((2.0 * h[0] + h[1]) * m[0] - h[0] * m[1]) / (h[0] + h[1]))
        for h, m in ((step, slope), (step[::-1], slope[::-1]))
    )
    return np.concatenate(([first], inner, [last]))


def plan_from_speed_profile(
    time: np.ndarray,
    distance: np.ndarray | None,
    speed: np.ndarray,
    elevation: np.ndarray | None = None,
) -> Plan:
    """A plan from a speed profile: time, s, distance, m, and speed, m/s, each of shape (n,).

    Without distance it is as the speeds make it; without elevation, m, the road is flat. Time and
    distance are counted from the first point.

    Raises:
        PlanError: the profile is invalid, or its speeds make `UNITS_APART` times its distance.
    """
    _check_size(len(time))
    time, speed = _array(time), _array(speed)
    _check_arrays({"time": time, "speed": speed})
    made = np.concatenate(([0.0], np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)))
    distance = made if distance is None else _array(distance)
    height = np.zeros_like(time) if elevation is None else _array(elevation)
    if distance.shape == time.shape and (np.diff(time) > 0).all():
        _check_units(float(made[-1]), float(distance[-1] - distance[0]))
    return Plan(time - time[:1], distance - distance[:1], speed, height)


def legs_of(
    length: np.ndarray,
    duration: np.ndarray,
    climb: np.ndarray | None = None,
    *,
    limit: np.ndarray | None = None,
    start_speed: np.ndarray | None = None,
    end_speed: np.ndarray | None = None,
) -> Legs:
    """Legs that need not follow one another; arrays of shape (n,), in SI, as of `Legs`.

    NaN in `climb` stands for a height that is not known, NaN in the others for a speed.

    Raises:
        PlanError: the arrays are no legs.
    """
    length, duration = _array(length), _array(duration)
    climb, limit, start_speed, end_speed = (
        np.full(length.shape, np.nan) if each is None else _array(each)
        for each in (climb, limit, start_speed, end_speed)
    )
    known = ~np.isnan(climb)
    climb = np.where(known, climb, 0.0)
    return Legs(length, duration, climb, limit, known, start_speed, end_speed)


def legs_of_trip(
    length: np.ndarray,
    duration: np.ndarray,
    climb: np.ndarray | None = None,
    **speeds: np.ndarray | None,
) -> Legs:
    """The legs of one trip, in order; arguments as of `legs_of`.

    Raises:
        PlanError: the legs are no trip, or so slow that their lengths are in km.
    """
    _check_size(np.size(length))
    legs = legs_of(length, duration, climb, **speeds)
    length, duration = legs.length, legs.duration
    total, driven = float(duration.sum()), float(duration[length > 0].sum())
    if total > LONGEST:
        raise PlanError(f"it takes {total / 86_400:.3g} days; the most are {LONGEST / 86_400:g}")
    if float(length.sum()) < SLOWEST_TRIP * driven:
        speed = float(length.sum()) / driven
        raise PlanError(f"it drives {speed:.2g} m/s on the whole (lengths in m, durations in s?)")
    return legs


def points_of(legs: Legs) -> Plan:
    """Points at the ends of legs, in order; the speed at a point is the mean about it."""
    time, distance, height = (
        np.concatenate(([0.0], np.cumsum(each)))
        for each in (legs.duration, legs.length, legs.climb)
    )
    mean = np.concatenate(([0.0], legs.length / legs.duration, [0.0]))
    return Plan(time, distance, (mean[1:] + mean[:-1]) / 2.0, height)


def _check_units(by_speed: float, length: float) -> None:
    """Refuse lengths of one profile, m, by its speeds and its distance, of different units."""
    if by_speed > UNITS_APART * max(length, LEAST_LENGTH):
        raise PlanError(
            f"its speeds make {by_speed:.0f} m, its distance is {length:.0f} m; both in SI units?"
        )


def _nominal_plan(
    distance: np.ndarray, points: dict[str, np.ndarray], nominal_speed: float
) -> Plan:
    length = float(distance[-1])
    if length == 0:
        raise PlanError("the path has neither length nor duration")
    if not 0 < nominal_speed <= MAX_SPEED:
        raise PlanError(f"cannot drive {nominal_speed:g} m/s")
    ramp = min(nominal_speed**2 / (2 * COMFORT_ACCELERATION), length / 2)
    # The ends of both ramps become points, so that every leg has one constant acceleration.
    step = min(NOMINAL_STEP, NOMINAL_SECONDS * nominal_speed)
    steps = np.linspace(0.0, length, 2 + min(int(length / step), MAX_POINTS))
    s = np.concatenate((distance, steps, [ramp, length - ramp]))
    s = np.unique(s.round(6))  # no leg is as short as rounding
    squared = np.minimum(nominal_speed, _bend_speed(s, distance, points)) ** 2
    squared[[0, -1]] = 0.0
    # As fast as braking for what comes, and accelerating from what was, allow.
    gained = 2 * COMFORT_ACCELERATION * s
    squared = np.minimum.accumulate(squared - gained) + gained
    squared = np.minimum.accumulate((squared + gained)[::-1])[::-1] - gained
    squared[1:-1] = np.maximum(squared[1:-1], TINY)  # rounding of a long way
    speed = np.sqrt(np.maximum(squared, 0.0))
    time = np.concatenate(([0.0], np.cumsum(2 * np.diff(s) / (speed[1:] + speed[:-1]))))
    return Plan(time, s, speed, np.interp(s, distance, points["z"]))


def _bend_speed(s: np.ndarray, distance: np.ndarray, points: dict[str, np.ndarray]) -> np.ndarray:
    """Comfortable speed at distances `s`, m/s, from the circle through the path around each.

    Three points `BEND` apart: closer, the noise of a map would be bends.
    """
    before, here, after = (
        np.stack([np.interp(s + away, distance, points[axis]) for axis in "xy"], axis=-1)
        for away in (-BEND, 0.0, BEND)
    )
    first, second, across = here - before, after - here, after - before
    product = np.prod([np.hypot(*side.T) for side in (first, second, across)], axis=0)
    doubled = 2 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    back = (first * second).sum(axis=-1) < 0  # it turns back: no circle is small enough
    inside = (s >= BEND) & (s <= distance[-1] - BEND)
    curvature = np.where(inside, doubled / np.maximum(product, 1e-9), 0.0)
    speed = np.sqrt(COMFORT_LATERAL / np.maximum(curvature, 1e-9))
    return np.where(back & inside, SLOWEST, np.maximum(speed, SLOWEST))


def _check_size(points: int) -> None:
    if points > MAX_POINTS:
        raise PlanError(f"{points} points are more than {MAX_POINTS}")


def _array(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=float)


def _check_arrays(named: dict[str, np.ndarray]) -> None:
    first = next(iter(named.values()))
    if any(array.shape != first.shape for array in named.values()):
        shapes = ", ".join(f"{name} {array.shape}" for name, array in named.items())
        raise PlanError(f"arrays differ in shape: {shapes}")
    if first.ndim not in (1, 2) or first.size == 0 or first.shape[-1] < 2:
        raise PlanError(f"needs at least two points, shape is {first.shape}")
    for name, array in named.items():
        _refuse(~np.isfinite(array), f"{name} is not finite")


def _refuse(wrong: np.ndarray, reason: str, what: str = "point") -> None:
    if wrong.any():
        where = np.argwhere(wrong)[0]
        raise PlanError(f"{reason} at {what} {', '.join(str(int(i)) for i in where)}")
