"""Detectors of a wrong sign: current against acceleration or charge, grade against energy."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.signals.detector import (
    AGAINST_CHARGE,
    AGAINST_HILLS,
    AGAINST_INERTIA,
    CURRENT_SIGN,
    DRAWN_AT_REST,
    GRADE_SIGN,
)
from evpinn_ros.core.signals.interval import Interval

MEMORY = 60.0  # s of pulling away and braking that the verdict rests on
HARD = 0.5  # m/s^2: from here on inertia outweighs road load and auxiliaries
MOVING = 2.0  # m/s

CHARGE_STEP = 0.02  # of state of charge: more than it creeps by itself while a battery rests
STANDING = 0.1  # m/s
AT_REST_MEMORY = 30.0  # s

ALIKE = 100.0  # m, correlation length of a reported grade, and of gusts
ROAD_MEMORY = 20e3  # m of road that the verdict rests on
FAST = 5.0  # m/s: slower, auxiliaries outweigh hills

MOST_SUM = 1e15
Sum: TypeAlias = Annotated[float, Range(-MOST_SUM, MOST_SUM)]


class SignSums(NamedTuple):
    """Power signed by acceleration, its size, J, and the time of both, s."""

    signed: Sum = 0.0
    size: Sum = 0.0
    seconds: Sum = 0.0


NO_SUMS = SignSums()


@dataclass(frozen=True, slots=True)
class SignDetector:
    """Detector of current of the wrong sign: to accelerate costs power, in every car.

    The evidence is the sum of power signed by acceleration over the sum of its size, while the car
    pulls away or brakes with more than `HARD`: about +0.9 if the sign is right, -0.9 if it is
    flipped.
    """

    sums: SignSums = NO_SUMS
    verdict: bool | None = None

    @property
    def detected(self) -> str | None:
        """`CURRENT_SIGN` or None."""
        return CURRENT_SIGN if self.verdict else None

    def after(self, speed: float, acceleration: float, power: float, step: float) -> SignDetector:
        """The detector after a measured power, W, that stands for `step` seconds."""
        if abs(acceleration) < HARD or speed < MOVING:
            return self
        keep = math.exp(-step / MEMORY)
        signed, size, seconds = (keep * total for total in self.sums)
        signed += math.copysign(power, power * acceleration) * step
        size += abs(power) * step
        seconds += step
        against = -signed / size if size > 0.0 else math.nan
        verdict = AGAINST_INERTIA.judge(self.verdict, against, seconds)
        return SignDetector(SignSums(signed, size, seconds), verdict)


@dataclass(frozen=True, slots=True)
class ChargeDetector:
    """Detector of current of the wrong sign: charging fills the battery, drawing empties it.

    Two rules. Each `CHARGE_STEP` of the state of charge must go with the sign of the energy that
    flowed meanwhile, moving or not. And a car at rest draws no more for long than heating cabin
    and battery takes; if more seems drawn, the car is charging.

    Attributes:
        charge: state of charge at the last step of it, NaN before.
        drawn: since then, J.
        at_rest: mean power drawn at rest, W.
        verdict: of either rule, the one that judged last.
    """

    charge: float = math.nan
    drawn: float = 0.0
    at_rest: float = 0.0
    verdict: bool | None = None

    @property
    def detected(self) -> str | None:
        """`CURRENT_SIGN` or None."""
        return CURRENT_SIGN if self.verdict else None

    def after(self, power: float, charge: float, speed: float, step: float) -> ChargeDetector:
        """The detector after the readings of `step` seconds.

        Args:
            power: drawn from the battery, W.
            charge: state of charge, 0..1, NaN where unknown.
            speed: m/s, NaN where unknown.
            step: s.
        """
        before, drawn, verdict = self.charge, self.drawn + power * step, self.verdict
        if math.isnan(before):
            before, drawn = charge, 0.0
        change = charge - before
        if abs(change) >= CHARGE_STEP:
            direction = math.copysign(1.0, change * drawn)
            verdict = AGAINST_CHARGE.judge(verdict, direction, abs(drawn))
            before, drawn = charge, 0.0
        at_rest = 0.0
        if abs(speed) < STANDING:
            keep = math.exp(-step / AT_REST_MEMORY)
            at_rest = keep * self.at_rest + (1.0 - keep) * power
        return ChargeDetector(before, drawn, at_rest, DRAWN_AT_REST.judge(verdict, at_rest))


@dataclass(frozen=True, slots=True)
class GradeDetector:
    """Detector of a reported grade of the wrong sign: to climb costs energy.

    Regresses the climb that the battery's energy shows on the reported one, over the road: 1 if
    the sign is right, -1 if it is flipped, 0 if the report has nothing to do with the road. Each
    `ALIKE` counts as one observation.

    Attributes:
        sums: of 1, x, y, x^2, x y and y^2 along the road, m.
    """

    sums: tuple[Sum, ...] = (0.0,) * 6
    verdict: bool | None = None

    def __post_init__(self) -> None:
        """Refuse sums that are not these six."""
        if len(self.sums) != 6:
            raise ValueError("grade: sums are missing")

    @property
    def detected(self) -> str | None:
        """`GRADE_SIGN` or None."""
        return GRADE_SIGN if self.verdict else None

    def after(self, interval: Interval, residual: float, weight_over_eta: float) -> GradeDetector:
        """The detector after one more interval.

        Args:
            interval: learned from; one without a measured height says nothing.
            residual: energy measured less predicted, J.
            weight_over_eta: m g / eta, N.
        """
        road = abs(interval.distance)
        if not interval.height_known or road < FAST * interval.duration:
            return self
        x = float(interval.steps.climb.sum()) / road
        y = x + residual / weight_over_eta / road
        new = np.array([1.0, x, y, x * x, x * y, y * y])
        sums = math.exp(-road / ROAD_MEMORY) * np.array(self.sums) + road * new
        verdict = AGAINST_HILLS.judge(self.verdict, -_sigmas(sums), float(sums[0]))
        return GradeDetector(tuple(sums.tolist()), verdict)


def _sigmas(sums: np.ndarray) -> float:
    """The regression's coefficient over its 1-sigma, NaN while it is undetermined."""
    road = float(sums[0])
    x, y, xx, xy, yy = (sums[1:] / road).tolist()
    spread, both, size = xx - x * x, xy - x * y, yy - y * y
    rest = size * spread - both**2  # of the variance of y, times that of x
    if spread <= 0.0 or rest <= 0.0:
        return math.nan
    return float(both * math.sqrt(road / ALIKE / rest))
