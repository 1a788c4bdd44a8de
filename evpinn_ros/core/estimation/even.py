"""Legs of a trip driven evenly, as steps that do not depend on how the legs are cut.

A plan of legs is a function of the road: its speed, its slope and what is known of its height.
Neighbours of equal speed are one run, and neighbours in a run with one slope are one leg, so a
border between equal legs changes nothing. Within `RAMP` of the border between two runs, at most up
to their middles, kinetic energy changes linearly along the way from one speed to the other. A trip
begins standing, and ends so unless its road goes on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

EQUAL_SPEED = 0.02  # difference of logarithms within which a leg continues a run
SAME = 1e-9  # difference of slopes, densities and winds that is rounding
RAMP = 15.0  # s before a border between runs, and after it, in which speed changes
PIECE_SECONDS = 60.0  # longest step, because tyres and cabin warm up


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


class Even(NamedTuple):
    """Legs of a trip as even steps.

    Attributes:
        steps: n of them; their air is that of the wind of the leg.
        unknown: m of each step whose height is not known, shape (n,).
        run: number of each step's run, from 0 on, shape (n,).
    """

    steps: Path
    unknown: np.ndarray
    run: np.ndarray


def runs_of(duration: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Number of the run, neighbours of one speed, that each leg belongs to, shape (n,)."""
    numbers, number, least, most = [], -1, math.inf, -math.inf
    lower, upper = math.exp(-EQUAL_SPEED), math.exp(EQUAL_SPEED)
    for speed in (np.abs(distance) / duration).tolist():
        if not least <= speed <= most:
            number, least, most = number + 1, lower * speed, upper * speed
        numbers.append(number)
    return np.array(numbers)


def even_course(
    legs: Path,
    unknown: np.ndarray | None = None,
    piece: float = math.inf,
    *,
    onward: bool = False,
) -> Even:
    """The steps of legs at even speed.

    Args:
        legs: of one trip.
        unknown: m of each leg whose height is not known.
        piece: longest step, m.
        onward: True if the road goes on, so that the last speed is kept.
    """
    run = runs_of(legs.duration, legs.distance)
    unknown = np.zeros_like(legs.duration) if unknown is None else unknown
    length = np.abs(legs.distance)
    shares = (
        np.divide(column, length, out=np.zeros_like(length), where=length > 0.0)
        for column in (legs.climb, unknown)
    )
    changes = np.zeros(len(run) - 1, bool)
    for column in (run, *shares, legs.density, legs.wind):
        changes |= np.abs(np.diff(column)) > SAME
    begins = np.concatenate(([0], np.flatnonzero(changes) + 1))
    summed = np.stack((legs.duration, length, legs.climb, unknown))
    joined = np.add.reduceat(summed, begins, axis=1)
    run, density, wind = run[begins], legs.density[begins], legs.wind[begins]
    ends = np.concatenate((np.zeros((4, 1)), np.cumsum(joined, axis=1)), axis=1)
    time, kinetic_at, kinetic = _ramps(run, ends[0], ends[1])
    if onward:
        kinetic[-1] = kinetic[-2]
    knots = [_divided(joined, ends[0], piece), time, ends[0, -1:]]
    knot = np.unique(np.concatenate(knots))
    at = np.stack([np.interp(knot, ends[0], column) for column in ends])
    duration, distance, climb, unseen = np.diff(at, axis=1)
    leg = np.searchsorted(ends[0], (knot[1:] + knot[:-1]) / 2.0) - 1
    leg = np.clip(leg, 0, len(begins) - 1)
    mean = joined[1, leg] / joined[0, leg]
    steps = Path(
        duration,
        distance,
        air_of(mean, wind[leg]) * distance,
        np.diff(np.interp(at[1], kinetic_at, kinetic)),
        climb,
        density[leg],
        wind[leg],
    )
    return Even(steps, unseen, run[leg])


def air_of(speed: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """Integral of v^3 per metre at even speed in a wind, m^2/s^2."""
    flow = speed + wind
    return np.asarray(flow * np.abs(flow))


def _ramps(
    run: np.ndarray, time: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends of the ramps of runs: times, s; and places, m, with kinetic energies, J/kg.

    Args:
        run: number of each leg's run, shape (n,).
        time: at the ends of the legs, s, shape (n + 1,).
        along: there, m.
    """
    borders = np.concatenate(([0], np.flatnonzero(np.diff(run)) + 1, [len(run)]))
    begin, end = time[borders[:-1]], time[borders[1:]]
    ramp = np.minimum(RAMP, (end - begin) / 2.0)
    times = np.stack((begin + ramp, end - ramp), axis=1).ravel()
    kinetic = 0.5 * (np.diff(along[borders]) / (end - begin)) ** 2
    places = np.concatenate((along[:1], np.interp(times, time, along), along[-1:]))
    return times, places, np.concatenate(([0.0], np.repeat(kinetic, 2), [0.0]))


def _divided(legs: np.ndarray, time: np.ndarray, piece: float) -> np.ndarray:
    """Times, s, that divide legs into steps of at most `PIECE_SECONDS` and `piece`, m."""
    pieces = np.maximum(legs[0] / PIECE_SECONDS, legs[1] / piece)
    # A whole number of pieces plus rounding is no piece more.
    pieces = np.maximum(np.ceil(pieces - 1e-6), 1).astype(int)
    leg = np.repeat(np.arange(legs.shape[1]), pieces)
    first = np.cumsum(pieces) - pieces
    return np.asarray(time[leg] + (np.arange(len(leg)) - first[leg]) / pieces[leg] * legs[0, leg])
