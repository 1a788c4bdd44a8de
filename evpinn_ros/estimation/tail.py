"""The newest samples of driving as journeys: what no interval holds yet."""

from __future__ import annotations

from bisect import bisect_left
import math

import numpy as np

from evpinn_ros.estimation.journey import NOWHERE, Journey, noise_of
from evpinn_ros.estimation.terms import Equation, Warmth, conditions_of
from evpinn_ros.signals.interval import Steps
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample

MAX_STEP = 10.0  # s that one sample may stand for
KEPT = 1000  # samples that are remembered at least: intervals wait up to a minute for heights


class Tail:
    """Sums of the steps between samples, of which journeys are differences.

    A step's kinetic energy is an exact difference, as an interval's is. Nothing is computed
    before a journey is asked for, which is in dropouts alone.
    """

    def __init__(self, equation: Equation) -> None:
        """Nothing driven by a car."""
        self._equation = equation
        self._samples: list[Sample] = []
        self._stamps: list[int] = []
        self._sums: list[Journey] = []

    def add(self, sample: Sample) -> None:
        """Take the next sample."""
        if self._stamps and sample.stamp_ns <= self._stamps[-1]:
            return
        self._samples.append(sample)
        self._stamps.append(sample.stamp_ns)
        if len(self._stamps) >= 2 * KEPT:
            for each in (self._samples, self._stamps, self._sums):
                del each[:KEPT]

    def between(self, start_ns: int, end_ns: int, warmth: Warmth) -> Journey:
        """Journey from one stamp to another, as far as it is remembered."""
        if not self._stamps:
            return NOWHERE
        for index in range(len(self._sums), len(self._samples)):
            before = self._sums[-1] if self._sums else NOWHERE
            step = self._step(index, warmth) if self._sums else NOWHERE
            self._sums.append(before.plus(step))
        return self._until(end_ns).less(self._until(start_ns))

    def _step(self, index: int, warmth: Warmth) -> Journey:
        """The step that ends with a sample."""
        begin, end = self._samples[index - 1 : index + 1]
        seconds = min((end.stamp_ns - begin.stamp_ns) / NANOSECONDS, MAX_STEP)
        speed = (begin.speed + end.speed) / 2.0
        way, wind = abs(speed) * seconds, end.head_wind

        def drag(v: float) -> float:
            return (v + wind) * abs(v + wind) * abs(v)

        air = (drag(begin.speed) + 4.0 * drag(speed) + drag(end.speed)) / 6.0 * seconds
        kinetic = (end.speed**2 - begin.speed**2) / 2.0
        climb = speed * seconds * math.sin((begin.grade + end.grade) / 2.0)
        motor = np.array([1.0, -1.0]) * end.motor_power * seconds
        moved = seconds, way, air, kinetic, climb, *np.maximum(motor, 0.0)
        steps = Steps._make((*(np.array([each]) for each in moved), end.motor_scaled))
        rows = self._equation.rows(steps, conditions_of(end), warmth)
        unseen = 0.0 if end.grade or steps.motor_known else way
        return Journey(rows[0], seconds, noise_of(steps), unseen)

    def _until(self, stamp_ns: int) -> Journey:
        """The sum up to a stamp, with its share of the step that spans it."""
        after = bisect_left(self._stamps, stamp_ns)
        if after in (0, len(self._stamps)):
            return self._sums[min(after, len(self._stamps) - 1)]
        begin_ns, end_ns = self._stamps[after - 1 : after + 1]
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        before = self._sums[after - 1]
        return before.plus(self._sums[after].less(before).share(share))
