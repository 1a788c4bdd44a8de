"""Speed readings to speed and acceleration, by two methods that know their lag.

- `SpeedTrack.smoothed`: a local quadratic (Savitzky-Golay for uneven steps) around a past moment,
  using speed up to `smoothing_lag` after it.
- `CausalDifferentiator`: acceleration at the newest moment, which has no future to smooth over. It
  learns, from speed alone, the linear combination of past speed differences that best foretells
  what the smoother will say once it knows more.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque

import numpy as np

from evpinn_ros.signals.readings import NANOSECONDS

SMOOTHING_BACK = 0.5  # s of past speed in the local quadratic
MIN_POINTS = 4  # of a local quadratic: one more than it has coefficients
TRACK_LENGTH = 6.0  # s of speed kept; enough for MIN_POINTS at 1 Hz
LAG_TOLERANCE_NS = 10_000_000  # ns a reading may come early and still count as "that lag later"

COURSE_PERIOD = 0.1  # s, steps of the course of the acceleration around a moment
COURSE_AHEAD = 3  # steps of it that lie after the moment
COURSE = 11  # steps of it in all

TAPS = 10  # speed differences in the causal differentiator
TAP_PERIOD = 0.1  # s between them
INITIAL_TAPS = 4  # the first guess is the mean slope over this many
TAP_STD = 0.2  # 1-sigma of a weight before learning
TARGET_STD = 0.2  # m/s^2, how far smoothed and causal acceleration lie apart


class SpeedTrack:
    """The last seconds of speed in order of stamps."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._speeds: list[float] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest speed; the track must not be empty."""
        return self._stamps[-1]

    def add(self, stamp_ns: int, speed: float) -> bool:
        """Insert one speed, m/s, in order; False when this stamp is already there."""
        index = bisect_left(self._stamps, stamp_ns)
        if index < len(self._stamps) and self._stamps[index] == stamp_ns:
            return False
        self._stamps.insert(index, stamp_ns)
        self._speeds.insert(index, speed)
        oldest = self._stamps[-1] - int(TRACK_LENGTH * NANOSECONDS)
        surplus = bisect_left(self._stamps, oldest)
        del self._stamps[:surplus], self._speeds[:surplus]
        return True

    def smoothed(self, stamp_ns: int, until_ns: int) -> tuple[float, float]:
        """Speed, m/s, and acceleration, m/s^2, at a moment from a local quadratic.

        Args:
            stamp_ns: the moment.
            until_ns: speed after this is not used.

        Returns:
            Both, or NaN for the acceleration while there are fewer than `MIN_POINTS` speeds, or
            these lie too close together to tell it.
        """
        last = bisect_right(self._stamps, until_ns)
        first = bisect_left(self._stamps, stamp_ns - int(SMOOTHING_BACK * NANOSECONDS) - 1)
        first = max(0, min(first, last - MIN_POINTS))
        time = np.array([s - stamp_ns for s in self._stamps[first:last]]) / NANOSECONDS
        speed = np.array(self._speeds[first:last])
        if len(time) < MIN_POINTS:
            return float(speed[-1]) if len(speed) else np.nan, np.nan
        basis = np.stack((np.ones_like(time), time, time**2), axis=1)
        normal = basis.T @ basis
        try:
            coefficients = np.linalg.solve(normal, basis.T @ speed)
        except np.linalg.LinAlgError:
            return float(speed[-1]), np.nan
        return float(coefficients[0]), float(coefficients[1])

    def course(self, stamp_ns: int, until_ns: int, acceleration: float) -> tuple[float, ...]:
        """How the acceleration runs around a past moment: what one number for it leaves out.

        Args:
            stamp_ns: the moment.
            until_ns: speed after this is not used.
            acceleration: at the moment, m/s^2.

        Returns:
            Mean slope of speed in each `COURSE_PERIOD`, latest first, less the acceleration,
            m/s^2, shape (COURSE,); 0 where speed is not known.
        """
        last = bisect_right(self._stamps, until_ns)
        first = bisect_left(self._stamps, stamp_ns - int(_COURSE_SPAN * NANOSECONDS))
        first = max(0, first - 1)
        time = np.array([s - stamp_ns for s in self._stamps[first:last]]) / NANOSECONDS
        speed = np.interp(_COURSE_GRID, time, self._speeds[first:last])
        slopes = (speed[:-1] - speed[1:]) / COURSE_PERIOD
        tolerance = LAG_TOLERANCE_NS / NANOSECONDS
        known = (_COURSE_GRID[:-1] <= time[-1] + tolerance) & (_COURSE_GRID[1:] >= time[0])
        return tuple(np.where(known, slopes - acceleration, 0.0).tolist())

    def differences(self) -> np.ndarray:
        """Mean slopes of speed over the last `TAPS` periods, newest first, shape (TAPS,), m/s^2.

        Between readings speed is taken as linear; before the first as constant.
        """
        newest = self._stamps[-1]
        first = bisect_left(self._stamps, newest - int((TAPS + 1) * TAP_PERIOD * NANOSECONDS))
        first = max(0, first - 1)
        time = np.array([s - newest for s in self._stamps[first:]]) / NANOSECONDS
        grid = -TAP_PERIOD * np.arange(TAPS + 1)
        speed = np.interp(grid, time, self._speeds[first:])
        slopes: np.ndarray = (speed[:-1] - speed[1:]) / TAP_PERIOD
        return slopes


class CausalDifferentiator:
    """Acceleration of the newest moment from the speeds up to it, learned while driving.

    Recursive least squares (Haykin, Adaptive Filter Theory, ch. 10, without forgetting) of the
    smoothed acceleration on the last speed differences. No battery signal is used, so it works
    and goes on learning while the battery is silent.
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
        gain = self.covariance @ x
        gain = gain / (x @ gain + TARGET_STD**2)
        self.weights = self.weights + gain * (smoothed_acceleration - x @ self.weights)
        self.covariance = self.covariance - np.outer(gain, x @ self.covariance)

    def forget_pending(self) -> None:
        """Drop what waits for the smoother, after a gap or a jump of time."""
        self._pending.clear()


_COURSE_GRID = COURSE_PERIOD * (COURSE_AHEAD - np.arange(COURSE + 1))  # s after the moment
COURSE_TIMES = _COURSE_GRID[:-1] - COURSE_PERIOD / 2  # s after the moment, of each slope
_COURSE_SPAN = -float(_COURSE_GRID[-1])
