"""Speed readings to speed and acceleration, by two methods that know their lag.

- `Speeds.smoothed`: a local quadratic (Savitzky-Golay for uneven steps) around a past moment,
  using speed up to `smoothing_lag` after it.
- `CausalDifferentiator`: acceleration at the newest moment, which has no future to smooth over. It
  learns, from speed alone, the linear combination of past speed differences that best predicts
  the output of the smoother once later readings are in.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.track import SignalTrack

SMOOTHING_BACK = 0.5  # s of past speed in the local quadratic
MIN_POINTS = 3  # of a local quadratic: as many as it has coefficients
MAX_ACCELERATION = 15.0  # m/s^2, beyond tyres: a fault of the speed signal
LEAST_LEAP = 1.0  # m/s, beyond the resolution of any bus
LAG_TOLERANCE_NS = 10_000_000  # ns a reading may come early and still count as "that lag later"

# Spans around a moment whose slope of speed is in the acceleration profile, s after it.
PROFILE_EDGES = np.array([(0.1, 0.3), (-0.3, -0.1), (-0.6, -0.4)])
PROFILE = len(PROFILE_EDGES)

TAPS = 10  # speed differences in the causal differentiator
TAP_PERIOD = 0.1  # s between them
INITIAL_TAPS = 4  # the first guess is the mean slope over this many
TAP_STD = 0.2  # 1-sigma of a weight before learning
LOOK_BACK_NS = int((TAPS + 2) * TAP_PERIOD * NANOSECONDS)  # of speed that a moment rests on
TARGET_STD = 0.2  # m/s^2, how far smoothed and causal acceleration lie apart


class SpeedTrack(SignalTrack):
    """The latest speeds, m/s, in order of stamps."""

    def __len__(self) -> int:
        return len(self.stamps)

    def leaps(self, begin_ns: int, end_ns: int) -> bool:
        """True if speed changed by more than tyres can between two readings from begin to end.

        Wheels that slip or lock do that, and a fault of the signal; its resolution does not.
        """
        first, last = bisect_left(self.stamps, begin_ns), bisect_right(self.stamps, end_ns)
        return any(
            abs(after - before)
            > LEAST_LEAP + MAX_ACCELERATION * abs(next_ns - stamp_ns) / NANOSECONDS
            for (stamp_ns, before), (next_ns, after) in pairwise(
                zip(self.stamps[first:last], self.values[first:last], strict=True)
            )
        )

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest speed; the track must not be empty."""
        return self.stamps[-1]

    @property
    def newest(self) -> float:
        """The newest speed, m/s; the track must not be empty."""
        return self.values[-1]

    def restart(self, gap: float) -> None:
        """Forget the speeds before a gap, s; of a slow signal it is a step like others."""
        self.cadence.add_step(gap)
        self.stamps.clear()
        self.values.clear()

    def travelled(self, start_ns: int, end_ns: int, head_wind: float) -> tuple[float, float]:
        """Distance, m, and integral of the air's flow, m^3/s^2, between two speeds' stamps.

        Between readings speed is linear, so both are exact while the flow keeps its sign
        (Simpson's rule is, for cubes).

        Args:
            start_ns: stamp of a speed.
            end_ns: the same, later.
            head_wind: m/s, see `Sample`.
        """
        first, last = bisect_left(self.stamps, start_ns), bisect_right(self.stamps, end_ns)
        speed = np.array(self.values[first:last])
        step = np.diff(self.stamps[first:last]) / NANOSECONDS
        middle = (speed[1:] + speed[:-1]) / 2

        def drag(v: np.ndarray) -> np.ndarray:
            flow = v + head_wind
            return np.asarray(flow * np.abs(flow) * v)

        air = (drag(speed[:-1]) + 4 * drag(middle) + drag(speed[1:])) / 6
        return float(middle @ step), float(air @ step)

    def smoothed(self, stamps: Sequence[int], ahead_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """`Speeds.smoothed` at moments in order, each from speeds up to `ahead_ns` after it."""
        zero_ns = stamps[0]
        speeds = self.since(zero_ns - LOOK_BACK_NS, zero_ns)
        moments = np.array([stamp_ns - zero_ns for stamp_ns in stamps], np.int64)
        until = np.searchsorted(speeds.stamps, moments + ahead_ns, side="right")
        return speeds.smoothed(moments, until)

    def since(self, oldest_ns: int, zero_ns: int) -> Speeds:
        """The speeds from a moment on, and some before, with stamps since `zero_ns`."""
        first = max(0, bisect_left(self.stamps, oldest_ns) - MIN_POINTS)
        stamps = [stamp_ns - zero_ns for stamp_ns in self.stamps[first:]]
        return Speeds(np.array(stamps, np.int64), np.array(self.values[first:]))


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

        Of a slow signal it goes through a reading and its two neighbours: the acceleration is
        then the central difference, whose integral along v is that of the kinetic energy.

        Args:
            moments: ns, shape (m,).
            until: how many speeds, from the first on, each may use, shape (m,).

        Returns:
            Both, shape (m,), or NaN for the acceleration where there are fewer than `MIN_POINTS`
            speeds, or these lie too close together to determine it.
        """
        back_ns = int(SMOOTHING_BACK * NANOSECONDS) + 1
        first = np.minimum(np.searchsorted(self.stamps, moments - back_ns), until - MIN_POINTS)
        index = np.maximum(first, 0)[:, None] + np.arange((until - np.maximum(first, 0)).max())
        used = index < until[:, None]
        index = np.minimum(index, len(self.stamps) - 1)
        time = (self.stamps[index] - moments[:, None]) / NANOSECONDS
        basis = np.stack((np.ones_like(time), time, time**2), axis=1) * used[:, None]
        normal = basis @ basis.transpose(0, 2, 1)
        few = until < MIN_POINTS
        normal[few] = np.eye(3)
        try:
            coefficients = np.linalg.solve(normal, basis @ self.values[index][..., None])[..., 0]
        except np.linalg.LinAlgError:
            if len(moments) > 1:
                alone = [self.smoothed(*pair) for pair in zip(*_ones(moments, until), strict=True)]
                speeds, accelerations = zip(*alone, strict=True)
                return np.concatenate(speeds), np.concatenate(accelerations)
            few = np.array([True])
            coefficients = np.empty((1, 3))
        coefficients[few, 0], coefficients[few, 1] = self.values[until[few] - 1], np.nan
        return coefficients[:, 0], coefficients[:, 1]

    def slopes(self, moments: np.ndarray, until: np.ndarray) -> np.ndarray:
        """Mean slope of speed over each span of `PROFILE_EDGES` around moments, m/s^2.

        The arguments are those of `smoothed`; shape (m, PROFILE), NaN where speed is not known.
        """
        time, begin, end = self.time, *PROFILE_EDGES.T
        seconds = (moments / NANOSECONDS)[:, None]
        last = time[until - 1][:, None]
        ends = (np.interp(np.minimum(seconds + e, last), time, self.values) for e in (begin, end))
        before, after = ends
        known = seconds + end <= last + LAG_TOLERANCE_NS / NANOSECONDS
        known &= seconds + begin >= time[0]
        return np.where(known, (after - before) / (end - begin), np.nan)

    def differences(self, moments: np.ndarray) -> np.ndarray:
        """Mean slopes of speed over the last `TAPS` periods before moments, newest first, m/s^2.

        Between readings speed is taken as linear; before the first as constant. Shape (m, TAPS).
        """
        grid = (moments / NANOSECONDS)[:, None] - TAP_PERIOD * np.arange(TAPS + 1)
        speed = np.interp(grid, self.time, self.values)
        return np.asarray((speed[:, :-1] - speed[:, 1:]) / TAP_PERIOD)


def profile(slopes: Iterable[float], acceleration: float) -> tuple[float, ...]:
    """Acceleration profile around a moment: what one number for it leaves out.

    Slopes less the acceleration, m/s^2, shape (PROFILE,); 0 where they are not known.
    """
    return tuple(0.0 if math.isnan(slope) else slope - acceleration for slope in slopes)


def _ones(*arrays: np.ndarray) -> Iterator[list[np.ndarray]]:
    """Arrays as lists of arrays of one element."""
    return (np.split(array, len(array)) for array in arrays)


class CausalDifferentiator:
    """Acceleration of the newest moment from the speeds up to it, learned while driving.

    Recursive least squares (Haykin, Adaptive Filter Theory, ch. 10, without forgetting) of the
    smoothed acceleration on the last speed differences. No battery signal is used, so it works
    and goes on learning during a dropout.
    """

    def __init__(self) -> None:
        self.weights = np.zeros(TAPS)
        self.weights[:INITIAL_TAPS] = 1.0 / INITIAL_TAPS
        self.covariance = np.eye(TAPS) * TAP_STD**2
        self._pending: deque[tuple[int, np.ndarray]] = deque(maxlen=1000)

    def acceleration(self, stamp_ns: int, differences: np.ndarray) -> float:
        """Acceleration now, m/s^2; the differences, shape (TAPS,), are kept to learn from."""
        self._pending.append((stamp_ns, differences))
        return float(differences @ self.weights)

    def learn(self, stamp_ns: int, smoothed_acceleration: float) -> None:
        """Learn from the acceleration, m/s^2, that the smoother found for an earlier stamp."""
        while self._pending and self._pending[0][0] < stamp_ns:
            self._pending.popleft()
        if not self._pending or self._pending[0][0] != stamp_ns:
            return
        _, x = self._pending.popleft()
        along = self.covariance @ x
        gain = along / (x @ along + TARGET_STD**2)
        self.weights = self.weights + gain * (smoothed_acceleration - x @ self.weights)
        self.covariance = self.covariance - gain[:, None] * along

    def forget_pending(self) -> None:
        """Drop what waits for the smoother, after a gap or a jump of time."""
        self._pending.clear()
