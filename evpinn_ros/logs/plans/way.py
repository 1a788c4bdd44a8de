"""Makes legs from points with times, and removes the noise of a receiver from them."""

from __future__ import annotations

from typing import NamedTuple
import warnings

import numpy as np

from evpinn_ros.core.energy.driven import road_height
from evpinn_ros.core.energy.plan import (
    LONGEST,
    MAX_SPEED,
    Legs,
    PlanError,
    legs_of_trip,
    refuse,
    sums,
)
from evpinn_ros.core.signals.height import AltitudeDetector
from evpinn_ros.core.signals.readings import RANGES, AltitudeReading
from evpinn_ros.logs.table_drive import LEVEL

FARTHEST = MAX_SPEED * LONGEST  # m, longest possible trip
# Positions of a standing receiver drift: if the mean positions over `AROUND` s before and after
# a moment are less than `WANDER` m apart, the car stands, unless it ends up farther away.
AROUND, WANDER, STAYED = 10.0, 10.0, 25.0
LEAST_AROUND = 4  # positions before and after
HEIGHT_STEP = 50.0  # m between positions at which slopes of a track are computed
APART = 1e-5  # m between two positions; less is rounding
EARTH_RADIUS = 6_371_008.8  # m, the mean of WGS 84


NOISY_STEP = 2.0  # s between positions; in longer steps driving looks the same
NOISE_SECONDS = 1.0  # that noise of a receiver lasts at least
SHAKEN = 0.3  # m/s^2, median change of acceleration of a car in town
NOISE_LEFT = 0.1  # m/s^2 of acceleration, 1-sigma
LEAST_SHAKES = 10
TINY = 1e-9  # s


class Heights(NamedTuple):
    """Heights along a path: `along`, m from its start, and `height`, m; shape (m,) each."""

    along: np.ndarray
    height: np.ndarray

    @property
    def usable(self) -> np.ndarray:
        """True where a road can be so high: not for marks of voids, nor if all others are 0."""
        on_earth = possible_heights(self.height)
        return np.asarray(on_earth & self.height[on_earth].any())

    def climbs(self, distance: np.ndarray) -> np.ndarray | None:
        """Smoothed climb, m, from each of n distances to the next; NaN or None if unknown."""
        usable = self.usable
        if usable.sum() < 2:
            return None
        along = np.clip(self.along[usable], 0.0, FARTHEST)
        middle = (distance[1:] + distance[:-1]) / 2
        height = plausible_heights(along, self.height[usable])
        places = np.append(np.arange(0.0, distance[-1], HEIGHT_STEP), distance[-1])
        climb = np.diff(np.interp(distance, places, road_height(along, height, places)))
        return np.where((middle >= along[0]) & (middle <= along[-1]), climb, np.nan)

    def warn(self) -> None:
        """Warn if all heights are equal, and if some are unknown."""
        usable = self.usable
        count, unknown = len(usable), int((~usable).sum())
        if usable.sum() > 1 and np.ptp(self.height[usable]) == 0.0:
            warnings.warn(LEVEL, stacklevel=3)
        if 0 < unknown < count:
            text = f"elevation: unknown at {unknown} of {count} places"
            warnings.warn(f"{text}; interpolated between the others", stacklevel=3)

    def borders(self, most: int) -> np.ndarray:
        """Rising distances, m, between which the slope is constant, or unknown.

        The ends of the known heights, and a grid of `HEIGHT_STEP` unless it has over `most`
        distances; empty without heights.
        """
        usable = self.usable
        if usable.sum() < 2:
            return np.empty(0)
        ends: np.ndarray = self.along[usable][[0, -1]]
        whole = float(self.along[-1])
        if not whole < most * HEIGHT_STEP:
            return ends
        return np.asarray(np.union1d(np.arange(HEIGHT_STEP, whole, HEIGHT_STEP), ends))


def possible_heights(height: np.ndarray) -> np.ndarray:
    """True where a road can be so high, m; maps mark voids by -9999 or -32768."""
    (bounds,) = RANGES[AltitudeReading]
    return np.asarray((height >= bounds.least) & (height <= bounds.most))


def plausible_heights(along: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Heights, m, without leaps, as the estimator accepts them; `along` is m, never falling."""
    detector, rises = AltitudeDetector(), []
    for place, altitude in zip(along.tolist(), height.tolist(), strict=True):
        detector = detector.after(place, altitude)
        rises.append(0.0 if detector.rise is None else detector.rise.height)
    heights: np.ndarray = height[0] + np.cumsum(rises)
    return heights


def legs_between(time: np.ndarray, distance: np.ndarray, heights: Heights | None = None) -> Legs:
    """Legs of n points by time, s, and distance, m, both never falling; PlanError if no trip."""
    steps = np.diff(time)
    if not (np.isfinite(time).all() and (np.abs(distance) <= FARTHEST).all()):
        raise PlanError(f"a time is not finite, or a distance is above {FARTHEST / 1e3:g} km")
    refuse(steps < 0, "time goes back", after=1)
    kept = np.flatnonzero(np.concatenate(([True], steps > 0)))
    if len(kept) < 2:
        raise PlanError("its duration is 0 s")
    kept[-1] = len(time) - 1
    distance = distance[kept]
    climb = None
    if heights is not None:
        heights.warn()
        climb = heights.climbs(distance)
    return legs_of_trip(np.diff(distance), np.diff(time[kept]), climb)


def with_borders(
    time: np.ndarray, distance: np.ndarray, borders: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Times, s, and distances, m, of n points, with the `borders`, m, inserted."""
    place = np.searchsorted(distance, borders)
    inner = (place > 0) & (place < len(distance))
    place, borders = place[inner], borders[inner]
    before, after = distance[place - 1], distance[place]
    new = (borders - before > APART) & (after - borders > APART)
    place, borders, before, after = (column[new] for column in (place, borders, before, after))
    share = (borders - before) / (after - before)
    between = time[place - 1] + share * (time[place] - time[place - 1])
    return np.insert(time, place, between), np.insert(distance, place, borders)


def without_wander(place: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Longitudes and latitudes, degrees, shape (n, 2); those of each stop moved to their mean.

    Args:
        place: of n points, longitude and latitude, degrees, shape (n, 2).
        time: of these, s, shape (n,); nothing is moved where it falls.
    """
    if len(place) < 2 * LEAST_AROUND or (np.diff(time) < 0.0).any():
        return place
    totals = np.concatenate(
        (np.zeros((1, 2)), np.cumsum(place * _metres_per_degree(place), axis=0))
    )
    here = np.arange(1, len(place) + 1)
    around = max(AROUND, LEAST_AROUND * float(np.median(np.diff(time))))
    begin, end = (np.searchsorted(time, time + away, "right") for away in (-around, around))
    enough = np.minimum(here - begin, end - here) >= LEAST_AROUND
    before, after = (
        (totals[last] - totals[first]) / np.maximum(last - first, 1)[:, None]
        for first, last in ((begin, here), (here, end))
    )
    stands = enough & (np.hypot(*(after - before).T) < WANDER)
    moved = place.copy()
    edges = np.flatnonzero(np.diff(stands, prepend=False, append=False)).reshape(-1, 2)
    for first, last in edges.tolist():
        if np.hypot(*(after[last - 1] - before[first])) < STAYED:
            moved[first:last] = place[first:last].mean(0)
    return moved


def without_noise(place: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Longitudes and latitudes, degrees, shape (n, 2), without the noise of a receiver.

    Noise of 2 m once a second is 3 m/s in the speed, which would cost more than the drive. Its
    variance is that of the third differences beyond a car's changes of acceleration. A filter of
    fourth order, which keeps bends, leaves an acceleration of `NOISE_LEFT`.

    Args:
        place: of n points, longitude and latitude, degrees, shape (n, 2).
        time: of these, s, shape (n,); no step is changed where most are longer than `NOISY_STEP`.
    """
    from scipy.ndimage import gaussian_filter1d  # here: 30 MB that only noise needs

    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if not 0.0 < usual <= NOISY_STEP or (steps < 0.0).any():
        return place
    metres = np.unwrap(place, axis=0, period=360.0) * _metres_per_degree(place)
    width = _filter_width(metres, time, usual)
    if width < 0.5:
        return place
    moves = np.diff(metres, axis=0)
    gaps = np.flatnonzero(steps > 3.0 * usual)
    for first, last in zip(np.append(0, gaps + 1), np.append(gaps, len(steps)), strict=True):
        seconds, piece = steps[first:last, None], moves[first:last]
        if not seconds.any():
            continue
        smooth = np.zeros_like(piece)
        weight = np.maximum(gaussian_filter1d(seconds, width, axis=0), TINY)
        for _ in range(2):
            smooth += seconds * gaussian_filter1d(piece - smooth, width, axis=0) / weight
        moves[first:last] = smooth
    moved = np.concatenate((np.zeros((1, 2)), np.cumsum(moves, axis=0)))
    return np.asarray(place[0] + moved / _metres_per_degree(place))


def _filter_width(metres: np.ndarray, time: np.ndarray, usual: float) -> float:
    """Width, in usual steps of `usual` s, of the filter that leaves `NOISE_LEFT`; 0 if unknown.

    `metres` are n positions, shape (n, 2), and `time`, s, shape (n,), their times.
    """
    stride = max(1, round(NOISE_SECONDS / usual))
    seconds, moves = np.diff(time[::stride]), np.diff(metres[::stride], axis=0)
    every = stride * usual
    even = (np.abs(seconds - every) < every / 2.0) & moves.any(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = moves * (every / seconds[:, None])
        shakes = np.diff(speeds, 2, axis=0)[even[2:] & even[1:-1] & even[:-2]]
    if len(shakes) < LEAST_SHAKES:
        return 0.0
    square = np.median((shakes**2).sum(1)) / (2.0 * np.log(2.0))  # of one axis, if normal
    # The third difference of white noise has 20 times its variance.
    variance = max(float(square) - (SHAKEN * every**2) ** 2, 0.0) / 20.0
    return float((1.14 * variance * every / NOISE_LEFT**2) ** 0.2 / usual)


def _metres_per_degree(place: np.ndarray) -> np.ndarray:
    """Metres per degree of longitude and of latitude at the first place, shape (2,)."""
    shrunk = np.cos(np.radians(place[0, 1]))
    return np.asarray(np.radians(EARTH_RADIUS) * np.array([shrunk, 1.0]))


def way_length(longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    """Distance from the first of n places, degrees, along great circles, m; PlanError."""
    if not ((np.abs(latitude) <= 90) & (np.abs(longitude) <= 360)).all():
        raise PlanError("a position is not on Earth: are longitude and latitude in degrees?")
    x, y = np.radians(longitude), np.radians(latitude)
    across = np.cos(y[1:]) * np.cos(y[:-1]) * np.sin(np.diff(x) / 2) ** 2
    part = np.sqrt(np.sin(np.diff(y) / 2) ** 2 + across)
    steps = 2 * EARTH_RADIUS * np.arcsin(np.minimum(part, 1.0))
    return sums(steps)
