"""Speed and acceleration from speed readings, by two methods of known lag.

- `Speeds.smoothed`: a local quadratic (Savitzky-Golay for uneven steps) around a past moment,
  using speed up to `smoothing_lag` after it.
- `CausalDifferentiator`: acceleration at the newest moment, which has no future to smooth over. It
  learns, from speed alone, the linear combination of past speed differences that best predicts
  the output of the smoother once later readings are in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.track import SignalTrack

SMOOTHING_BACK = 0.5  # s of past speed in the local quadratic
SMOOTHED_AT_ONCE = 2000  # moments
MIN_POINTS = 3  # of a local quadratic: as many as it has coefficients
MAX_ACCELERATION = 15.0  # m/s^2, beyond tyres: a fault of the speed signal
LEAST_LEAP = 1.0  # m/s, beyond the resolution of any bus
LAG_TOLERANCE_NS = 10_000_000  # ns a reading may come early and still count as "that lag later"

# Begin and end, s after a moment, of the spans whose mean slopes make its acceleration profile.
PROFILE_EDGES = np.array([(0.1, 0.3), (-0.3, -0.1), (-0.6, -0.4)])
PROFILE_NS = np.rint(PROFILE_EDGES * NANOSECONDS).astype(np.int64)
PROFILE = len(PROFILE_EDGES)

TAPS = 10  # speed differences in the causal differentiator
TAP_PERIOD = 0.1  # s between them
UNKNOWN_FIT = np.eye(3)  # normal matrix in place of one of too few points
INITIAL_TAPS = 4  # the first guess is the mean slope over this many
TAP_STD = 0.2  # 1-sigma of a weight before learning
LOOK_BACK_NS = int((TAPS + 2) * TAP_PERIOD * NANOSECONDS)  # of past speed that a moment needs
TARGET_STD = 0.2  # m/s^2, how far smoothed and causal acceleration lie apart


class Motion(NamedTuple):
    """Motion between n moments, shape (n - 1,) each.

    Attributes:
        distance: m.
        air: `Steps.air`, m^3/s^2.
        leaps: whether speed changed by more than tyres can between two readings, because wheels
            slip or lock, or the signal fails.
    """

    distance: np.ndarray
    air: np.ndarray
    leaps: np.ndarray


class SpeedTrack(SignalTrack):
    """The latest speeds, m/s, in order of stamps."""

    def driven(self, stamps: np.ndarray, head_wind: np.ndarray) -> Motion:
        """Motion between the stamps of n speeds.

        Between readings speed is linear, so distance and flow are exact while the flow keeps its
        sign (Simpson's rule is exact for cubes).

        Args:
            stamps: of speeds in this track, ns, in order.
            head_wind: between them, m/s, see `Sample`, shape (n - 1,).
        """
        places = self.stamps.searchsorted(stamps)
        chosen = slice(places[0], places[-1] + 1)
        speed, steps = self.values[chosen], np.diff(self.stamps[chosen]) / NANOSECONDS
        middle, wind = (speed[1:] + speed[:-1]) / 2, np.repeat(head_wind, np.diff(places))

        def drag(v: np.ndarray) -> np.ndarray:
            flow = v + wind
            return np.asarray(flow * np.abs(flow) * v)

        air = (drag(speed[:-1]) + 4 * drag(middle) + drag(speed[1:])) / 6
        leaps = np.abs(np.diff(speed)) > LEAST_LEAP + MAX_ACCELERATION * steps
        begins = places[:-1] - places[0]
        return Motion(
            np.add.reduceat(middle * steps, begins),
            np.add.reduceat(air * steps, begins),
            np.logical_or.reduceat(leaps, begins),
        )

    def smoothed(self, stamps: np.ndarray, ahead_ns: int) -> np.ndarray:
        """Speeds by `Speeds.smoothed` at moments in order, from speeds up to `ahead_ns` later."""
        zero_ns = int(stamps[0])
        speeds, moments = self.since(zero_ns - LOOK_BACK_NS, zero_ns), stamps - zero_ns
        until = speeds.stamps.searchsorted(moments + ahead_ns, side="right")
        return speeds.smoothed(moments, until)[0]

    def since(self, oldest_ns: int, zero_ns: int) -> Speeds:
        """The speeds from `oldest_ns` on, and `MIN_POINTS` before, with stamps since `zero_ns`."""
        first = max(0, int(self.stamps.searchsorted(oldest_ns)) - MIN_POINTS)
        return Speeds(self.stamps[first:] - zero_ns, self.values[first:])


class Speeds(NamedTuple):
    """Speeds as arrays: ns since some moment, increasing, and m/s; shape (n,) each."""

    stamps: np.ndarray
    values: np.ndarray

    @property
    def time(self) -> np.ndarray:
        """Stamps in s."""
        return self.stamps / NANOSECONDS

    def smoothed(self, moments: np.ndarray, until: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Speed, m/s, and acceleration, m/s^2, at m moments from a local quadratic around each.

        On a slow signal it goes through a reading and its two neighbours: the acceleration is
        then the central difference, whose integral times v is that of the kinetic energy.

        Args:
            moments: ns, shape (m,).
            until: number of speeds, from the first on, that each may use, shape (m,).

        Returns:
            Both, shape (m,); the acceleration is NaN where fewer than `MIN_POINTS` speeds, or
            speeds too close together, do not determine it.
        """
        if len(moments) > SMOOTHED_AT_ONCE:  # so that memory stays bounded
            return self._smoothed_in_parts(moments, until, SMOOTHED_AT_ONCE)
        back_ns = int(SMOOTHING_BACK * NANOSECONDS) + 1
        first = np.minimum(self.stamps.searchsorted(moments - back_ns), until - MIN_POINTS)
        first = np.maximum(first, 0)
        # A row of speeds for each moment, as long as the longest; speeds that it lacks weigh 0.
        index = first[:, None] + np.arange((until - first).max())
        used = index < until[:, None]
        index = np.minimum(index, len(self.stamps) - 1)
        time = (self.stamps[index] - moments[:, None]) / NANOSECONDS
        basis = np.stack((np.ones_like(time), time, time**2), axis=1) * used[:, None]
        normal = basis @ basis.transpose(0, 2, 1)
        few = until < MIN_POINTS
        normal[few] = UNKNOWN_FIT
        try:
            coefficients = np.linalg.solve(normal, basis @ self.values[index][..., None])[..., 0]
        except np.linalg.LinAlgError:
            if len(moments) > 1:  # one singular matrix fails the solve of all
                return self._smoothed_in_parts(moments, until, 1)
            few = np.array([True])
            coefficients = np.empty((1, 3))
        coefficients[few, 0], coefficients[few, 1] = self.values[until[few] - 1], np.nan
        return coefficients[:, 0], coefficients[:, 1]

    def _smoothed_in_parts(
        self, moments: np.ndarray, until: np.ndarray, size: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """`smoothed` of at most `size` moments at once."""
        parts = (slice(begin, begin + size) for begin in range(0, len(moments), size))
        columns = zip(*(self.smoothed(moments[p], until[p]) for p in parts), strict=True)
        speeds, accelerations = map(np.concatenate, columns)
        return speeds, accelerations

    def slopes(self, moments: np.ndarray, until: np.ndarray) -> np.ndarray:
        """Mean slope of speed over each span of `PROFILE_EDGES` around moments, m/s^2.

        The arguments are those of `smoothed`; shape (m, PROFILE), NaN where speed is not known.
        """
        time, begin, end = self.time, *PROFILE_EDGES.T
        seconds = (moments / NANOSECONDS)[:, None]
        last = time[until - 1][:, None]
        ends = (np.interp(np.minimum(seconds + e, last), time, self.values) for e in (begin, end))
        before, after = ends
        # In whole ns, because a reading may come exactly `LAG_TOLERANCE_NS` early.
        begin_ns, end_ns = moments[:, None] + PROFILE_NS[:, 0], moments[:, None] + PROFILE_NS[:, 1]
        known = end_ns <= self.stamps[until - 1][:, None] + LAG_TOLERANCE_NS
        known &= begin_ns >= self.stamps[0]
        return np.where(known, (after - before) / (end - begin), np.nan)

    def differences(self, moments: np.ndarray) -> np.ndarray:
        """Mean slopes of speed over the last `TAPS` periods before moments, newest first, m/s^2.

        Shape (m, TAPS). Speed is linear between readings, and constant before the first.
        """
        grid = (moments / NANOSECONDS)[:, None] - TAP_PERIOD * np.arange(TAPS + 1)
        speed = np.interp(grid, self.time, self.values)
        return np.asarray((speed[:, :-1] - speed[:, 1:]) / TAP_PERIOD)


def profile(slopes: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Acceleration profiles: slopes around moments less the acceleration there, m/s^2.

    Shapes (n, PROFILE) and (n,); the profile is 0 where the slope is NaN.
    """
    beyond = slopes - acceleration[:, None]
    return np.where(np.isnan(beyond), 0.0, beyond)


class Taps(NamedTuple):
    """Weights of the causal differentiator before m accelerations and after each of them.

    Attributes:
        information: shape (m + 1, TAPS, TAPS).
        products: of it and the weights, shape (m + 1, TAPS).
    """

    information: np.ndarray
    products: np.ndarray

    def weights(self, counts: np.ndarray) -> np.ndarray:
        """Weights after each of n counts of accelerations, shape (n, TAPS)."""
        used, which = np.unique(counts, return_inverse=True)
        solved = np.linalg.solve(self.information[used], self.products[used][..., None])[..., 0]
        return np.asarray(solved[which])


class CausalDifferentiator:
    """Acceleration of the newest moment from the speeds up to it, learned while driving.

    Recursive least squares (Haykin, Adaptive Filter Theory, ch. 10, without forgetting) of the
    smoothed acceleration on the last speed differences, in information form, where a block needs
    cumulative sums alone. It uses no battery signal, so it works and learns during a dropout.

    Attributes:
        information: shape (TAPS, TAPS).
        products: of it and the weights, shape (TAPS,).
    """

    def __init__(self) -> None:
        weights = np.zeros(TAPS)
        weights[:INITIAL_TAPS] = 1.0 / INITIAL_TAPS
        self.information = np.eye(TAPS) / TAP_STD**2
        self.products = weights / TAP_STD**2

    def learn(self, differences: np.ndarray, accelerations: np.ndarray) -> Taps:
        """Learn smoothed accelerations, m/s^2, shape (m,), from differences, shape (m, TAPS)."""
        squares = differences[:, :, None] * differences[:, None, :] / TARGET_STD**2
        information = np.concatenate((self.information[None], squares)).cumsum(axis=0)
        along = differences * accelerations[:, None] / TARGET_STD**2
        products = np.concatenate((self.products[None], along)).cumsum(axis=0)
        self.information, self.products = information[-1], products[-1]
        return Taps(information, products)
