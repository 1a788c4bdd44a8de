"""What the car meets now and no model knows: gusts, ripples of grade, a wet road, a bend.

A force that fades within seconds (an Ornstein-Uhlenbeck process), followed by a filter of its own
behind the power filter. Were it a state of that one, it would explain away what the slow states
have to learn, and power predicted without the battery would be worse for it.

It is no last value held: one sample moves it little, and seconds after the battery falls silent
it is gone.
"""

from __future__ import annotations

import math

from evpinn_ros.estimation.parameter_filter import CORRELATION_TIME, OUTLIER

LOAD_STD = 200.0  # N, 1-sigma: a grade of one percent
LOAD_TIME = 10.0  # s in which it fades


class UnknownLoad:
    """Kalman filter of one force, N."""

    def __init__(self) -> None:
        """Start without any."""
        self.forget()

    def forget(self) -> None:
        """Begin on another road."""
        self._force, self._variance = 0.0, LOAD_STD**2
        self._last_ns: int | None = None

    def advance(self, stamp_ns: int) -> None:
        """Let time pass up to a stamp."""
        step = 0.0 if self._last_ns is None else max(0.0, (stamp_ns - self._last_ns) * 1e-9)
        self._last_ns = stamp_ns
        keep = math.exp(-step / LOAD_TIME)
        self._force *= keep
        self._variance = keep**2 * self._variance + (1 - keep**2) * LOAD_STD**2

    def power(self, speed: float) -> tuple[float, float]:
        """Power against the force at a speed, m/s, and its 1-sigma, W."""
        return self._force * speed, math.sqrt(self._variance) * abs(speed)

    def update(self, speed: float, residual: float, residual_std: float, step: float) -> None:
        """Learn from the residual of the power filter, W, that stands for `step` seconds."""
        power, std = self.power(speed)
        surprise = residual - power
        variance = residual_std**2 * max(1.0, CORRELATION_TIME / step)
        variance *= max(1.0, abs(surprise) / (OUTLIER * math.hypot(std, residual_std)))
        gain = self._variance * speed / (std**2 + variance)
        self._force += gain * surprise
        self._variance *= 1.0 - gain * speed
