"""Plan along the points of a path: by their stamps, or as a gentle driver would take the path.

Without stamps the car starts at its present speed, ends at rest, keeps to a nominal speed, and
brakes and accelerates comfortably around bends.
"""

from __future__ import annotations

import numpy as np

from evpinn_ros.core.energy.plan import (
    LONGEST,
    MAX_POINTS,
    MAX_SPEED,
    Plan,
    PlanError,
    as_floats,
    beside_line,
    check_arrays,
    check_size,
    refuse,
    sums,
    telling,
)

MAX_LEG = 10e3  # m between two points without stamps; more is refused
NOMINAL_SPEED = 50 / 3.6  # m/s, where a path has no usable stamps
COMFORT_ACCELERATION = 1.0  # m/s^2, gentle for a person standing in a bus as well
COMFORT_LATERAL = 2.0  # m/s^2, what drivers take in a bend without hurry
SLOWEST = 1.0  # m/s through the sharpest bend
BEND = 10.0  # m before and after a point, between which the curvature is computed
# Longest steps of a nominal profile, m and s; points are added to a sparser path.
NOMINAL_STEP, NOMINAL_SECONDS = 25.0, 2.0
TINY = 1e-6  # m^2/s^2
ON_A_LINE = 1e-6  # m; a point closer to the line between its neighbours lies on it


def plan_from_path(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    stamps: np.ndarray | None = None,
    *,
    nominal_speed: float = NOMINAL_SPEED,
    start_speed: float = 0.0,
) -> Plan:
    """A plan from path points.

    With stamps, speed is the slope of a monotone cubic through distance over time: zero where
    the path waits. Stamps that are absent or all equal are unusable; the car then starts at
    `start_speed`, ends at rest, accelerates and brakes with `COMFORT_ACCELERATION`, takes bends
    with `COMFORT_LATERAL` and else drives `nominal_speed`.

    Args:
        x: m, shape (n,) as all, n >= 2.
        y: m.
        z: m, elevation.
        stamps: s, or None.
        nominal_speed: m/s.
        start_speed: m/s; if too fast for the path, the car brakes comfortably from it.

    Raises:
        PlanError: the points are not a trip.
    """
    check_size(len(x))
    points = {"x": as_floats(x), "y": as_floats(y), "z": as_floats(z)}
    time = None if stamps is None else as_floats(stamps)
    check_arrays(points if time is None else points | {"stamps": time})
    with np.errstate(over="ignore"):  # an infinite leg is refused as too long
        legs = np.sqrt(sum(np.diff(points[axis]) ** 2 for axis in "xyz"))
    if time is not None and np.ptp(time) == 0:
        time = None
    farthest = MAX_LEG if time is None else MAX_SPEED * LONGEST
    refuse(legs > farthest, f"jumps farther than {farthest / 1e3:g} km", after=1)
    distance = sums(legs)
    if time is None:
        return _nominal_plan(distance, points, nominal_speed, start_speed)
    duration = np.diff(time)
    refuse(duration < 0, "time goes back", after=1)
    # Equal points are one; so are points closer than the rounding of the distance.
    kept = np.concatenate(([True], (duration > 0) | (np.diff(distance) > 0)))
    time, distance, elevation = time[kept] - time[0], distance[kept], points["z"][kept]
    too_fast = np.diff(distance) > MAX_SPEED * np.diff(time)
    refuse(too_fast, f"faster than {MAX_SPEED:g} m/s", after=1)
    return _stamped_plan(time, distance, elevation)


def _stamped_plan(time: np.ndarray, distance: np.ndarray, elevation: np.ndarray) -> Plan:
    """The plan of points with stamps, s, and distances, m, neither of which falls.

    A point within a stretch of one mean speed and slope changes nothing: it moves to where the car
    is at its stamp.
    """
    corners = _telling(time, distance, elevation)
    knots, along = time[corners], distance[corners]
    slopes = np.clip(monotone_slopes(knots, along), 0.0, MAX_SPEED)
    speed = np.interp(time, knots, slopes)
    stretch = np.clip(np.searchsorted(knots, time, "right") - 1, 0, len(knots) - 2)
    driven = (speed + slopes[stretch]) * (time - knots[stretch])
    whole = (slopes[1:] + slopes[:-1]) * np.diff(knots)
    even = (time - knots[stretch]) / np.diff(knots)[stretch]
    share = np.divide(driven, whole[stretch], out=even, where=whole[stretch] > 0.0)
    way = along[stretch] + share * np.diff(along)[stretch]
    rise = elevation[corners][stretch] + share * np.diff(elevation[corners])[stretch]
    distance, elevation = (
        np.where(corners, given, moved) for given, moved in ((distance, way), (elevation, rise))
    )
    return Plan(time, distance, speed, elevation)


def _telling(along: np.ndarray, *columns: np.ndarray) -> np.ndarray:
    """True for points off the lines between others, over `along`, shape (n,)."""
    return telling(len(along), *(beside_line(along, column, ON_A_LINE) for column in columns))


def monotone_slopes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Slopes at the points, shape (n,), of the monotone cubic through y that never falls.

    Fritsch and Butland (1984): zero beside a stretch where y is constant, else a harmonic mean.
    As `scipy.interpolate.PchipInterpolator`, whose import would be a third of all that nodes load.
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


def _nominal_plan(
    distance: np.ndarray, points: dict[str, np.ndarray], nominal_speed: float, start_speed: float
) -> Plan:
    length = float(distance[-1])
    if length == 0:
        raise PlanError("the path has neither length nor duration")
    if not 0 < nominal_speed <= MAX_SPEED:
        raise PlanError(f"cannot drive {nominal_speed:g} m/s")
    # Speed changes within these metres of the start and of the end.
    first, last = (
        min(abs(nominal_speed**2 - end**2) / (2 * COMFORT_ACCELERATION), length / 2)
        for end in (start_speed, 0.0)
    )
    # The ends of both ramps become points, so that every leg has one constant acceleration.
    step = min(NOMINAL_STEP, NOMINAL_SECONDS * nominal_speed)
    steps = np.linspace(0.0, length, 2 + min(int(length / step), MAX_POINTS))
    bends = distance[_telling(distance, *points.values())]
    s = np.concatenate((bends, steps, [first, length - last]))
    s = np.unique(s.round(6))  # no leg is shorter than rounding
    squared = np.minimum(nominal_speed, _bend_speed(s, distance, points)) ** 2
    gained = 2 * COMFORT_ACCELERATION * s
    squared = np.maximum(squared, start_speed**2 - gained)
    squared[[0, -1]] = start_speed**2, 0.0
    # The fastest profile that brakes for later limits and accelerates from earlier ones.
    squared = np.minimum.accumulate(squared - gained) + gained
    squared = np.minimum.accumulate((squared + gained)[::-1])[::-1] - gained
    squared[1:-1] = np.maximum(squared[1:-1], TINY)  # against rounding on long paths
    with_path = np.unique(np.concatenate((s, distance.round(6).clip(0.0, s[-1]))))
    s, squared = with_path, np.interp(with_path, s, squared)
    speed = np.sqrt(np.maximum(squared, 0.0))
    time = sums(2 * np.diff(s) / (speed[1:] + speed[:-1]))
    return Plan(time, s, speed, np.interp(s, distance, points["z"]))


def _bend_speed(s: np.ndarray, distance: np.ndarray, points: dict[str, np.ndarray]) -> np.ndarray:
    """Comfortable speed at distances `s`, m/s, from the circle through the path around each.

    The circle is through three points `BEND` apart: with less, noise of a map would be bends.
    """
    before, here, after = (
        np.stack([np.interp(s + away, distance, points[axis]) for axis in "xy"], axis=-1)
        for away in (-BEND, 0.0, BEND)
    )
    first, second, across = here - before, after - here, after - before
    product = np.prod([np.hypot(*side.T) for side in (first, second, across)], axis=0)
    doubled = 2 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    back = (first * second).sum(axis=-1) < 0  # the path turns back: no circle is small enough
    inside = (s >= BEND) & (s <= distance[-1] - BEND)
    curvature = np.where(inside, doubled / np.maximum(product, 1e-9), 0.0)
    speed = np.sqrt(COMFORT_LATERAL / np.maximum(curvature, 1e-9))
    return np.where(back & inside, SLOWEST, np.maximum(speed, SLOWEST))
