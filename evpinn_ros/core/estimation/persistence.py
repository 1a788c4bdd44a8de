"""The error of the last battery reading, added to predictions while it decays.

The trim (`estimation.trim`) rests on what was known up to the watermark, some tenths of a second
ago. Errors of neighbouring samples are alike: in drives of three cars 64 to 86 % of an error is
left after 0.1 s, 37 to 67 % after 0.2 s. So `power/predicted` adds the error of the newest battery
reading that is stamped before its sample, as it decays (Ornstein and Uhlenbeck).
"""

from __future__ import annotations

from collections import deque
import math

from evpinn_ros.core.signals.readings import NANOSECONDS

DECAY = 0.3  # s
FORGOTTEN = 10.0 * DECAY  # s
OUTLIER = 3.0  # sigmas at which errors are cut off
MOST_KEPT = 500  # predictions kept, between which battery readings may lie
LEAST_SIGMA = 0.2  # of that of the prediction: a sensor and its stamp err too


class Persistence:
    """Adds the decaying error of the newest battery reading to predictions."""

    def __init__(self) -> None:
        """Start without a prediction."""
        self._latest: deque[tuple[int, float]] = deque(maxlen=MOST_KEPT)

    def add(
        self, stamp_ns: int, power: float, sigma: float, told_ns: int, told: float
    ) -> tuple[float, float]:
        """Power of a sample and its 1-sigma, W.

        Args:
            stamp_ns: of the sample; stamps rise.
            power: predicted, W.
            sigma: its 1-sigma, W.
            told_ns: stamp of the newest battery reading before the sample, ns.
            told: its power, W; NaN if there is none.
        """
        self._latest.append((stamp_ns, power))
        age = (stamp_ns - told_ns) / NANOSECONDS
        if told != told or age >= FORGOTTEN or told_ns < self._latest[0][0]:
            return power, sigma
        kept = math.exp(-age / DECAY)
        error = told - self._predicted_at(told_ns)
        error = min(max(error, -OUTLIER * sigma), OUTLIER * sigma)
        share = max(math.sqrt(1.0 - kept**2), LEAST_SIGMA)
        return max(power + kept * error, min(power, told, 0.0)), sigma * share

    def _predicted_at(self, moment_ns: int) -> float:
        """Power that was predicted at a moment between the latest, W, on a straight line."""
        end_ns, power = self._latest[-1]
        for place in range(len(self._latest) - 2, -1, -1):
            begin_ns, before = self._latest[place]
            if begin_ns <= moment_ns:
                return before + (power - before) * (moment_ns - begin_ns) / (end_ns - begin_ns)
            end_ns, power = begin_ns, before
        return power
