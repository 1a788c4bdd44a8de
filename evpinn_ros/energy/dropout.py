"""Time without the battery, and what the prediction says of it."""

from __future__ import annotations

from typing import NamedTuple

from evpinn_ros.energy.plausible import Joules, Seconds


class Bridge(NamedTuple):
    """Prediction for a dropout, or for many.

    Attributes:
        energy: net, J.
        regenerated: as positive J.
        gross: drawn and regenerated together, J.
        covered_s: time that the prediction covers, s.
    """

    energy: Joules = 0.0
    regenerated: Joules = 0.0
    gross: Joules = 0.0
    covered_s: Seconds = 0.0

    @classmethod
    def of_parts(cls, drawn: float, regenerated: float) -> Bridge:
        """Make one of drawn and regenerated energy, J, over a time that is counted elsewhere."""
        return cls(drawn - regenerated, regenerated, drawn + regenerated)

    def plus(self, other: Bridge) -> Bridge:
        """Both together."""
        return Bridge(*(a + b for a, b in zip(self, other, strict=True)))

    def less(self, other: Bridge) -> Bridge:
        """Difference to an earlier one."""
        return Bridge(*(a - b for a, b in zip(self, other, strict=True)))


class Dropout(NamedTuple):
    """One battery dropout that ended.

    Attributes:
        end_ns: stamp of the battery's first word after it.
        duration: s.
        bridge: what the prediction says of it.
        short_sigma: 1-sigma of its energy by errors of power that pass, J.
        sigma: the same with the error that lasts, J.
    """

    end_ns: int
    duration: float
    bridge: Bridge
    short_sigma: float
    sigma: float

    @property
    def unknown_s(self) -> float:
        """Time of it that nothing is known of, for speed was silent too, s."""
        return max(self.duration - self.bridge.covered_s, 0.0)


class Dropouts(NamedTuple):
    """All dropouts together, and what the prediction adds between two samples of the battery.

    Attributes:
        bridged: what the prediction says of them.
        variance: of its energy, J^2.
        lasting_variance: the part of that by errors that last through a dropout, J^2.
        seconds: their duration.
    """

    bridged: Bridge = Bridge()
    variance: float = 0.0
    lasting_variance: float = 0.0
    seconds: float = 0.0

    def after(self, dropout: Dropout) -> Dropouts:
        """With one more."""
        return Dropouts(
            self.bridged.plus(dropout.bridge),
            self.variance + dropout.sigma**2,
            self.lasting_variance + dropout.sigma**2 - dropout.short_sigma**2,
            self.seconds + dropout.duration,
        )

    def corrected(self, bridge: Bridge, variance: float) -> Dropouts:
        """With what a prediction adds, J, and its variance, J^2, while the battery speaks."""
        return self._replace(bridged=self.bridged.plus(bridge), variance=self.variance + variance)
