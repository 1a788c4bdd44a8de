"""Corrects predicted power by the error at the newest battery reading, which decays in 0.3 s.

The trim (`estimation.trim`) uses data up to the watermark, some tenths of a second ago. Errors of
neighbouring samples are correlated: 64 to 86 % of an error is left after 0.1 s. So
`power/predicted` adds the error at the newest battery reading before its sample, with the decay of
an Ornstein-Uhlenbeck process. Two weights, which begin at 0, correct this decay and scale the
change of the prediction since then. Recursive least squares learns them at every battery reading
from the one before it.
"""

from __future__ import annotations

from collections import deque
import math

from evpinn_ros.core.signals.readings import NANOSECONDS

DECAY = 0.3  # s
FORGOTTEN = 10.0 * DECAY  # s
OUTLIER = 3.0  # sigmas beyond which an error counts for no more
MOST_KEPT = 500  # predictions, to interpolate at battery readings
LEAST_SIGMA = 0.2  # share of the prediction's sigma that is left: sensor and stamp err too
FADING = 100.0  # s, time constant with which the weights return to 0


class Persistence:
    """Adds the decayed error at the newest battery reading to predictions."""

    def __init__(self) -> None:
        """Begin without a prediction."""
        self._latest: deque[tuple[int, float]] = deque(maxlen=MOST_KEPT)
        self._last: tuple[int, float, float] | None = None  # stamp, prediction and error, W
        self._weights = _Weights()

    def add(
        self, stamp_ns: int, power: float, sigma: float, battery_ns: int, battery: float
    ) -> tuple[float, float]:
        """Power of a sample and its 1-sigma, W.

        Args:
            stamp_ns: of the sample; stamps rise.
            power: predicted, W.
            sigma: its 1-sigma, W.
            battery_ns: stamp of the newest battery reading before the sample, ns.
            battery: its power, W, NaN if there is none or it is not to be used.
        """
        self._latest.append((stamp_ns, power))
        age = (stamp_ns - battery_ns) / NANOSECONDS
        if battery != battery or age >= FORGOTTEN or battery_ns < self._latest[0][0]:
            return power, sigma
        then = self._predicted_at(battery_ns)
        error = _within(battery - then, OUTLIER * sigma)
        self._learn(battery_ns, then, battery - then, error, sigma)
        kept = math.exp(-age / DECAY)
        given = kept * error + self._weights.of(*_terms(age, error, power - then))
        share = max(math.sqrt(1.0 - kept**2), LEAST_SIGMA)
        return max(power + given, min(power, battery, 0.0)), sigma * share

    def _learn(
        self, battery_ns: int, then: float, seen: float, error: float, sigma: float
    ) -> None:
        """Learn the weights from the error of a battery reading and that of the one before."""
        before, self._last = self._last, (battery_ns, then, error)
        if before is None or before[0] == battery_ns:
            return
        age = (battery_ns - before[0]) / NANOSECONDS
        left = math.exp(-age / DECAY) * before[2]
        self._weights.learn(*_terms(age, before[2], then - before[1]), seen - left, sigma, age)

    def _predicted_at(self, moment_ns: int) -> float:
        """Predicted power at a moment, W, interpolated between the latest predictions."""
        end_ns, power = self._latest[-1]
        for place in range(len(self._latest) - 2, -1, -1):
            begin_ns, before = self._latest[place]
            if begin_ns <= moment_ns:
                return before + (power - before) * (moment_ns - begin_ns) / (end_ns - begin_ns)
            end_ns, power = begin_ns, before
        return power


def _terms(age: float, error: float, change: float) -> tuple[float, float]:
    """The two terms that are weighted, W, at an age, s, of an error, with which both decay."""
    kept = math.exp(-age / DECAY)
    return kept * age / DECAY * error, kept * change


class _Weights:
    """Two weights and their covariance; each begins at 0 with a variance of 1.

    Scalars, because arrays of two would take ten times as long.
    """

    def __init__(self) -> None:
        self._first, self._second = 0.0, 0.0
        self._var_first, self._shared, self._var_second = 1.0, 0.0, 1.0

    def of(self, first: float, second: float) -> float:
        """Weighted sum of two terms."""
        return self._first * first + self._second * second

    def learn(self, first: float, second: float, seen: float, sigma: float, passed: float) -> None:
        """Learn from a measured sum of two terms, with its 1-sigma, `passed` s after the last."""
        left = math.exp(-passed / FADING)
        fresh = 1.0 - left**2
        self._first, self._second = left * self._first, left * self._second
        self._var_first = left**2 * self._var_first + fresh
        self._shared *= left**2
        self._var_second = left**2 * self._var_second + fresh
        with_first = self._var_first * first + self._shared * second
        with_second = self._shared * first + self._var_second * second
        variance = with_first * first + with_second * second + sigma**2
        if not variance > 0.0:
            return
        surprise = _within(seen - self.of(first, second), OUTLIER * math.sqrt(variance))
        self._first += with_first * surprise / variance
        self._second += with_second * surprise / variance
        self._var_first -= with_first**2 / variance
        self._shared -= with_first * with_second / variance
        self._var_second -= with_second**2 / variance


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
