"""A plan as steps of the road, which do not depend on how the plan is cut.

A point on the line between its neighbours adds no information, nor does a border between legs of
one speed and slope (`estimation.even`). Both are left out, and the rest is divided by fixed rules,
so that energy and sigma depend on the road alone. Values at the plan's points are interpolated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.energy.plan import Legs, Plan, beside_line, sums, telling
from evpinn_ros.core.estimation.even import PIECE_SECONDS, Path, air_of, even_course
from evpinn_ros.core.estimation.unevenness import Runs, runs_along
from evpinn_ros.core.signals.interval import Steps

# Largest change of speed in a step, m/s, and over the highest speed of the line.
SMALL_CHANGE, SMALL_SHARE = 1.0, 0.25
MOST_STEPS = 100_000  # of a plan, or one for each of its lines
ON_A_LINE = 1e-7, 1e-6  # m/s and m; a smaller distance from a line is rounding
WIND_STEPS = 50.0  # within `wind_length`


class Course(NamedTuple):
    """Steps of one trip.

    Attributes:
        time: at the ends of the steps, s since the start, shape (n + 1,).
        distance: at the same places, m since the start, shape (n + 1,).
        steps: n of them.
        unknown: m of each step whose height is not known, shape (n,).
        run: number of the line, or run of legs, of each step, shape (n,).
        runs: lines or runs of legs by this number.
    """

    time: np.ndarray
    distance: np.ndarray
    steps: Steps
    unknown: np.ndarray
    run: np.ndarray
    runs: Runs


def course_of(
    plan: Plan | Legs, density: float, head_wind: float = 0.0, wind_length: float = math.inf
) -> Course:
    """The course of one trip.

    Args:
        plan: its points or legs.
        density: of the air, kg/m^3.
        head_wind: against the car at the start, m/s over ground.
        wind_length: m within which the wind fades to 1/e.
    """
    piece = wind_length / WIND_STEPS if head_wind else math.inf
    if isinstance(plan, Legs):
        return _of_legs(plan, density, head_wind, wind_length, piece)
    return _of_points(plan, density, head_wind, wind_length, piece)


def _of_legs(
    legs: Legs, density: float, head_wind: float, wind_length: float, piece: float
) -> Course:
    zero = np.zeros_like(legs.duration)
    path = Path(legs.duration, legs.length, zero, zero, legs.climb, zero + density, zero)
    even = even_course(path, legs.length * ~legs.height_known, piece, onward=legs.onward)
    time, distance = sums(even.steps.duration), sums(even.steps.distance)
    wind = head_wind * np.exp(-distance / wind_length)
    air = air_of(even.steps.distance / even.steps.duration, (wind[1:] + wind[:-1]) / 2.0)
    steps = Steps(*even.steps[:5])._replace(air=air * even.steps.distance)
    return Course(time, distance, steps, even.unknown, even.run, runs_along(even))


def _of_points(
    plan: Plan, density: float, head_wind: float, wind_length: float, piece: float
) -> Course:
    """Distance is cubic in time on a line, so speed is the parabola with the given ends."""
    kept = _telling(plan)
    time, distance, speed, height = (
        column[kept] for column in (plan.time, plan.distance, plan.speed, plan.elevation)
    )
    time, distance = time - time[0], distance - distance[0]
    duration, length = np.diff(time), np.diff(distance)
    runs = Runs(duration, length, np.full_like(length, density))
    line, time, distance, speed, height = _divided(time, distance, speed, height, piece)
    duration, length = np.diff(time), np.diff(distance)
    start, end, middle = speed[:-1], speed[1:], _middle(duration, length, speed)
    wind = head_wind * np.exp(-distance / wind_length)

    def drag(speed: np.ndarray, wind: np.ndarray) -> np.ndarray:
        return np.asarray(air_of(speed, wind) * speed)

    between = drag(middle, (wind[1:] + wind[:-1]) / 2.0)
    air = (drag(start, wind[:-1]) + 4.0 * between + drag(end, wind[1:])) * duration / 6.0
    steps = Steps(duration, length, air, (end**2 - start**2) / 2.0, np.diff(height))
    unknown = length * (np.ptp(plan.elevation) == 0.0 and not plan.level)
    return Course(time, distance, steps, unknown, line, runs)


def _telling(plan: Plan) -> np.ndarray:
    """True for points that do not lie on the line between others, shape (n,)."""
    small, rounding = ON_A_LINE
    time, distance, speed, height = plan.time, plan.distance, plan.speed, plan.elevation

    def farther(here: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        share = (time[here] - time[start]) / (time[end] - time[start])
        line, whole = speed[start] + share * (speed[end] - speed[start]), speed[start] + speed[end]
        np.divide((speed[start] + line) * share, whole, out=share, where=whole > 0.0)
        way = share * (distance[end] - distance[start])
        return np.asarray(np.abs(distance[here] - distance[start] - way) / rounding)

    faster = beside_line(time, speed, small * (1.0 + speed))
    higher = beside_line(distance, height, rounding)
    return telling(len(time), faster, farther, higher)


def _middle(duration: np.ndarray, length: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Speeds in the middle of lines; where speeds contradict distances it might reverse."""
    return np.asarray(np.maximum(1.5 * length / duration - (speed[:-1] + speed[1:]) / 4.0, 0.0))


def _divided(
    time: np.ndarray, distance: np.ndarray, speed: np.ndarray, height: np.ndarray, piece: float
) -> tuple[np.ndarray, ...]:
    """Lines divided into steps: number of each step's line; time, distance, speed, height of ends.

    Args:
        time: at the ends of the lines, s.
        distance: there, m.
        speed: there, m/s.
        height: there, m.
        piece: longest step, m.
    """
    duration, length = np.diff(time), np.diff(distance)
    start, end, middle = speed[:-1], speed[1:], _middle(duration, length, speed)
    change = np.abs(middle - start) + np.abs(end - middle)
    highest = np.maximum(np.maximum(start, end), middle)
    small = np.clip(SMALL_SHARE * highest, 1e-3, SMALL_CHANGE)
    pieces = np.maximum.reduce((change / small, duration / PIECE_SECONDS, length / piece))
    most = max(MOST_STEPS // len(length), 1)
    # A whole number of pieces plus rounding is no piece more.
    pieces = np.clip(np.ceil(pieces - 1e-6), 1, most).astype(int)
    line = np.repeat(np.arange(len(length)), pieces)
    step = np.arange(len(line)) - (np.cumsum(pieces) - pieces)[line]
    share = step / pieces[line]
    first, last, top = start[line], end[line], middle[line]
    # The parabola through three speeds, and its integral as a share of the length of the line.
    rise, bend = 4.0 * top - 3.0 * first - last, 2.0 * (first + last) - 4.0 * top
    between = np.maximum(first + share * (rise + share * bend), 0.0)
    way = share * (first + share * (rise / 2.0 + share * bend / 3.0))
    whole = (start + 4.0 * middle + end) / 6.0
    way = np.divide(way, whole[line], out=share.copy(), where=whole[line] > 0.0)
    way = np.maximum.accumulate(np.clip(way, 0.0, 1.0) + line) - line

    def at(column: np.ndarray, share: np.ndarray) -> np.ndarray:
        return np.append(column[line] + share * np.diff(column)[line], column[-1])

    return (
        line,
        at(time, share),
        at(distance, way),
        np.append(between, speed[-1]),
        at(height, way),
    )
