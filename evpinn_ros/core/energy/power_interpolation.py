"""Power between two samples of the battery, from the course of the prediction.

A straight line from one sample at 1 Hz to the next misses the launch and the braking in between.
The prediction, ten times as often, knows their course, though not their level. So between two
samples of the battery the power is taken as the prediction moved onto both,

    P(t) = predicted(t) + r(t),    r = measured - predicted at both ends,

with r linear in between: an error of the prediction that is linear over the step costs nothing.
Over a dropout that ends within a minute the errors at its ends are forgotten on the way, within
tau: r is the mean of an Ornstein-Uhlenbeck bridge, nearly zero in the middle.

The Runge-Kutta network takes two pieces of that course at a time, the sample between them being
the known midpoint; one step from battery sample to battery sample, with the middle alone, was
worse than all samples (docs/project/benchmark_history.md). The trapezoid rule is the cross-check.
What stays uncertain of a step: r at both ends tells two errors of a moment, and their mean stands
for the step with half the variance of one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.energy.dropout import Bridge
from evpinn_ros.core.energy.quadrature import Step
from evpinn_ros.core.energy.rknn import Rknn
from evpinn_ros.core.signals.readings import NANOSECONDS

LEAST_INSIDE = 2  # predictions in a step; with fewer they are no denser than the battery
WAITING = 1000  # samples kept at most
LONGEST = 59.0  # s; of a longer dropout the ends tell nothing, and the state of charge may
MEMORY = 0.5  # s, tau: of errors of the prediction; docs/project/benchmark_history.md has others


class PredictedPower(NamedTuple):
    """Predicted power at a moment and its 1-sigma, W."""

    stamp_ns: int
    power: float
    sigma: float


class MeasuredStep(NamedTuple):
    """A step between two samples of the battery.

    Attributes:
        begin_ns: stamp of the first.
        end_ns: stamp of the second.
        line: the straight line between them.
        dropout: what has been counted for it if it was a dropout, None where the line has.
    """

    begin_ns: int
    end_ns: int
    line: Step
    dropout: Bridge | None = None


class PowerInterpolation:
    """Corrects what was counted between samples of the battery once predictions have passed.

    A correction is what is added to what was counted for a step, and the variance of that, J^2. A
    step that no prediction ever passes, or that holds too few, stays as it was counted.
    """

    def __init__(self, max_gap: float, network: Rknn | None) -> None:
        """Begin without a reading.

        Args:
            max_gap: predictions further apart, s, tell no course.
            network: integrates, the trapezoid rule where there is none.
        """
        self._max_gap, self._network = max_gap, network
        self._predictions: deque[PredictedPower] = deque(maxlen=WAITING)
        self._steps: deque[MeasuredStep] = deque(maxlen=WAITING)

    def add_predicted(
        self, stamp_ns: int, power: float, sigma: float
    ) -> Iterator[tuple[Bridge, float]]:
        """Take a predicted power, W, newer than the last; gives corrections of what it ends."""
        self._predictions.append(PredictedPower(stamp_ns, power, sigma))
        return self._completed()

    def add_measured(self, step: MeasuredStep) -> Iterator[tuple[Bridge, float]]:
        """Take a step newer than the last; gives its correction if it is complete."""
        self._steps.append(step)
        return self._completed()

    def _completed(self) -> Iterator[tuple[Bridge, float]]:
        while self._steps and self._predictions:
            if self._predictions[-1].stamp_ns < self._steps[0].end_ns:
                return
            step = self._steps.popleft()
            while len(self._predictions) > 1 and self._predictions[1].stamp_ns <= step.begin_ns:
                self._predictions.popleft()
            correction = self._correction(step)
            if correction is not None:
                yield correction

    def _correction(self, step: MeasuredStep) -> tuple[Bridge, float] | None:
        """Correction by the predictions around and in a step."""
        near = [*self._predictions]
        end = next(i for i, each in enumerate(near) if each.stamp_ns >= step.end_ns)
        near = near[: end + 1]
        inside = [each for each in near if step.begin_ns < each.stamp_ns < step.end_ns]
        known = near[0].stamp_ns <= step.begin_ns and all(
            after.stamp_ns - before.stamp_ns <= self._max_gap * NANOSECONDS
            for before, after in pairwise(near)
        )
        if len(inside) < LEAST_INSIDE or not known:
            return None
        time, power = _joined(step, near)
        found = self._integral(time, power)
        if step.dropout is not None:
            return found.less(step.dropout)._replace(covered_s=0.0), 0.0
        sigma = math.fsum(each.sigma for each in inside) / len(inside)
        counted = Bridge.of_parts(*step.line.parts)
        return found.less(counted), (sigma * step.line.dt) ** 2 / 2

    def _integral(self, time: np.ndarray, power: np.ndarray) -> Bridge:
        """Energy of a step, from the course of power at these times since its start, s."""
        samples = pairwise(zip(time.tolist(), power.tolist(), strict=True))
        parts = [Step(t1 - t0, p0, p1).parts for (t0, p0), (t1, p1) in samples]
        drawn, regenerated = (math.fsum(column) for column in zip(*parts, strict=True))
        if self._network is not None:
            drawn = self._network.along(time, power) + regenerated
        return Bridge.of_parts(drawn, regenerated)


def _joined(step: MeasuredStep, near: list[PredictedPower]) -> tuple[np.ndarray, np.ndarray]:
    """Time since its start, s, and power, W, of the course of a step, from end to end."""
    stamps = [(each.stamp_ns - step.begin_ns) / NANOSECONDS for each in near]
    times, powers = np.array(stamps), np.array([each.power for each in near])
    length, ends = step.line.dt, np.array([step.line.power, step.line.power_next])
    begin, end = ends - np.interp([0.0, length], times, powers)
    inside = (times > 0) & (times < length)
    t = times[inside]
    if step.dropout is None:
        error = begin + (end - begin) * t / length
    else:
        forgotten = np.sinh((length - t) / MEMORY), np.sinh(t / MEMORY)
        error = (begin * forgotten[0] + end * forgotten[1]) / math.sinh(length / MEMORY)
    joined = np.concatenate((ends[:1], powers[inside] + error, ends[1:]))
    return np.concatenate(([0.0], t, [length])), joined
