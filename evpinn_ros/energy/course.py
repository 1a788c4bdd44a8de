"""What a slow battery does not say between two of its words.

A straight line from one sample at 1 Hz to the next misses the launch and the braking in between.
The prediction, ten times as often, knows their course, though not their level. So between two
samples of the battery the power is taken as the prediction moved onto both,

    P(t) = predicted(t) + r(t),    r linear, measured - predicted at both ends,

and an error of the prediction that is linear over the step costs nothing. What stays uncertain:
errors of the prediction forget themselves within half a second, so that r at both ends tells two
errors of a moment, and their mean stands for the step with half the variance of one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import pairwise
import math
from typing import NamedTuple

from evpinn_ros.energy.quadrature import Step
from evpinn_ros.energy.silence import Bridge
from evpinn_ros.signals.readings import NANOSECONDS

LEAST_INSIDE = 2  # predictions in a step; with fewer they are no denser than the battery
WAITING = 1000  # samples kept at most


class Prediction(NamedTuple):
    """Predicted power at a moment and its 1-sigma, W."""

    stamp_ns: int
    power: float
    sigma: float


class MeasuredStep(NamedTuple):
    """A step between two samples of the battery, from its first stamp on."""

    begin_ns: int
    end_ns: int
    line: Step


class Correction(NamedTuple):
    """What is to be added to a straight line, and its variance, J^2."""

    bridge: Bridge
    variance: float


class Course:
    """Corrects steps of measured power once the predictions, which lag behind, have passed them.

    A step that no prediction ever passes, or that holds too few, stays a straight line.
    """

    def __init__(self, max_gap: float) -> None:
        """Nothing heard yet; predictions further apart than `max_gap`, s, tell no course."""
        self._max_gap = max_gap
        self._predictions: deque[Prediction] = deque(maxlen=WAITING)
        self._steps: deque[MeasuredStep] = deque(maxlen=WAITING)

    def push_predicted(self, prediction: Prediction) -> Iterator[Correction]:
        """Take a prediction newer than the last; gives the steps that it completes."""
        self._predictions.append(prediction)
        return self._completed()

    def push_measured(self, step: MeasuredStep) -> Iterator[Correction]:
        """Take a step newer than the last; gives it if it is complete."""
        self._steps.append(step)
        return self._completed()

    def _completed(self) -> Iterator[Correction]:
        while self._steps and self._predictions and self._past(self._steps[0].end_ns):
            step = self._steps.popleft()
            while len(self._predictions) > 1 and self._predictions[1].stamp_ns <= step.begin_ns:
                self._predictions.popleft()
            correction = self._correction(step)
            if correction is not None:
                yield correction

    def _past(self, stamp_ns: int) -> bool:
        return self._predictions[-1].stamp_ns >= stamp_ns

    def _correction(self, step: MeasuredStep) -> Correction | None:
        """What the predictions around and in a step add to its straight line."""
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
        begin = step.line.power - _between(near[0], near[1], step.begin_ns)
        change = step.line.power_next - _between(near[-2], near[-1], step.end_ns) - begin
        times, powers = [0.0], [step.line.power]
        for each in inside:
            times.append((each.stamp_ns - step.begin_ns) / NANOSECONDS)
            powers.append(each.power + begin + change * times[-1] / step.line.dt)
        samples = zip([*times, step.line.dt], [*powers, step.line.power_next], strict=True)
        pieces = (Step(t1 - t0, p0, p1) for (t0, p0), (t1, p1) in pairwise(samples))
        sigma = math.fsum(each.sigma for each in inside) / len(inside)
        return Correction(_added(step.line, pieces), (sigma * step.line.dt) ** 2 / 2)


def _between(before: Prediction, after: Prediction, stamp_ns: int) -> float:
    """Predicted power at a stamp on the straight line through two predictions, W."""
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    return before.power + share * (after.power - before.power)


def _added(line: Step, pieces: Iterator[Step]) -> Bridge:
    parts = [piece.parts for piece in pieces]
    drawn, regenerated = (math.fsum(column) for column in zip(*parts, strict=True))
    drawn, regenerated = drawn - line.parts[0], regenerated - line.parts[1]
    return Bridge(drawn - regenerated, regenerated, drawn + regenerated)
