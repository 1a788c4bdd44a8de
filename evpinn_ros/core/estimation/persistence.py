"""What the battery last gave beside the prediction: it holds for some tenths of a second.

The trim (`estimation.trim`) rests on what was known up to the watermark, some tenths of a second
ago. What it errs by is alike in neighbouring samples: of five recorded cars 64 to 86 % of an error
is left after 0.1 s, 37 to 67 % after 0.2 s. So `power/predicted` adds the error of the newest
battery reading that is stamped before its sample, as it decays (Ornstein and Uhlenbeck).
"""

from __future__ import annotations

from collections import deque
import math

import numpy as np

from evpinn_ros.core.signals.readings import NANOSECONDS

DECAY = 0.3  # s
FORGOTTEN = 10.0 * DECAY  # s
OUTLIER = 3.0  # sigmas beyond which an error counts for no more
MOST_KEPT = 500  # predictions, which battery readings may lie between
LEAST_SIGMA = 0.2  # of that of the prediction: a sensor and its stamp err too


class Persistence:
    """Adds to predictions what the battery had beside them."""

    def __init__(self) -> None:
        """Nothing predicted."""
        self._latest: deque[tuple[int, float]] = deque(maxlen=MOST_KEPT)

    def add(
        self, stamps: np.ndarray, predicted: np.ndarray, told_ns: np.ndarray, told: np.ndarray
    ) -> np.ndarray:
        """Power and 1-sigma of n samples, W, shape (n, 2).

        Args:
            stamps: of the samples, ns, rising, shape (n,).
            predicted: power and its 1-sigma, W, shape (n, 2).
            told_ns: stamps of the newest battery reading before each, ns, shape (n,).
            told: its power, W, NaN where there is none to go by, shape (n,).
        """
        if not len(stamps):
            return predicted
        known_ns, known = np.array([*self._latest], dtype=object).reshape(-1, 2).T
        self._latest.extend(zip(stamps.tolist(), predicted[:, 0].tolist(), strict=True))
        at_ns = np.concatenate((known_ns.astype(np.int64), stamps))
        powers = np.concatenate((known.astype(float), predicted[:, 0]))
        zero_ns = at_ns[0]
        of_told = np.interp(np.maximum(told_ns, zero_ns) - zero_ns, at_ns - zero_ns, powers)
        power, sigma = predicted.T
        age = np.where(told_ns < zero_ns, np.inf, (stamps - told_ns) / NANOSECONDS)
        kept = np.exp(-age / DECAY) * ((age < FORGOTTEN) & ~np.isnan(told))
        told = np.where(kept > 0.0, told, power)
        error = np.clip(told - of_told, -OUTLIER * sigma, OUTLIER * sigma)
        least = np.minimum(np.minimum(power, told), 0.0)
        share = np.maximum(np.sqrt(1.0 - kept**2), LEAST_SIGMA)
        return np.stack((np.maximum(power + kept * error, least), sigma * share), axis=1)

    def add_one(
        self, stamp_ns: int, power: float, sigma: float, told_ns: int, told: float
    ) -> tuple[float, float]:
        """The scalar twin of `add`."""
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
