"""Intervals of driving: the weak form of eq. 12-21, without a derivative.

The residual of learning is energy over an interval, not power at a sample. The integral of v a is
the difference of v^2 / 2 and that of v sin(grade) the difference of height, exactly, so no
acceleration is needed; battery energy is integrated between the battery's own stamps. An interval
is 10 s of a fast bus or a polled car and some readings of a phone's log, by the same code (the
variational form of a PINN: Kharazmi 2019; of system identification: Messenger and Bortz 2021). In
shorter ones slow errors would count as white noise. Where the battery drops out an interval ends,
so that all that was measured is learned from.

Within an interval, steps of at least `STEP` keep driving and braking apart.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.height import REACH, HeightProfile
from evpinn_ros.core.signals.kinematics import LAG_TOLERANCE_NS, SpeedTrack
from evpinn_ros.core.signals.power import BatteryTrack, MotorTrack
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.road import Conditions, Road

STEP = 0.5  # s, shortest step within an interval
DURATION = 10.0  # s, shortest interval, but for one that a dropout or a gap ends
READINGS = 6  # usual steps of the slower signal that an interval spans at least
# Speed after an edge that its own is smoothed with, ns. By a local quadratic: a mean flattens the
# ups and downs of speed, which made m/eta 0.7 % too large.
EDGE_AHEAD_NS = 250_000_000
PASSED = 20  # edges among which late altitudes find their place
WAIT_NS = 60 * NANOSECONDS  # longest wait for the height or battery around an interval


class Steps(NamedTuple):
    """The steps of an interval as columns of shape (n,).

    Attributes:
        duration: s.
        distance: m.
        air: integral of flow |flow| v with the flow of air against the car, m^3/s^2.
        kinetic: difference of v^2 / 2, J/kg.
        climb: difference of height, m; 0 where unknown.
        motor_drive: energy of the motor where it drives, J, NaN while unknown, as in a plan.
        motor_brake: the same where it brakes, positive J.
        motor_scaled: whether these are in J; else up to a factor, for the gear is not known.
    """

    duration: np.ndarray
    distance: np.ndarray
    air: np.ndarray
    kinetic: np.ndarray
    climb: np.ndarray
    motor_drive: np.ndarray = np.array(math.nan)
    motor_brake: np.ndarray = np.array(math.nan)
    motor_scaled: bool = True

    @property
    def motor_known(self) -> bool:
        """True if the energy of the motor is known all along."""
        return not np.isnan(self.motor_drive).any()


@dataclass(frozen=True, slots=True)
class Interval:
    """Some seconds of driving.

    Attributes:
        start_ns: begin.
        end_ns: end.
        steps: what the car did.
        conditions: air, temperature and reported loads; the loads are the mean over it.
        height_known: whether `climb` is measured.
        energy: drawn from the battery, J, NaN where not measured.
        sampling_variance: of that, due to the rate of its readings, J^2.
        leaps: whether speed changed by more than tyres can: wheels slipped, or the signal failed.
        returned: the part of `energy` that went back into the battery, positive J; NaN unknown.
    """

    start_ns: int
    end_ns: int
    steps: Steps
    conditions: Conditions
    height_known: bool
    energy: float
    sampling_variance: float
    leaps: bool = False
    returned: float = math.nan

    @property
    def duration(self) -> float:
        """Length, s."""
        return (self.end_ns - self.start_ns) / NANOSECONDS

    @property
    def distance(self) -> float:
        """Length on the road, m."""
        return float(self.steps.distance.sum())


@dataclass(slots=True)
class _Edge:
    """The border between two steps."""

    stamp_ns: int
    odometer: float
    air: float
    motor: tuple[float, float]
    conditions: Conditions
    leapt: bool  # speed, by more than tyres can, since the edge before
    speed: float = math.nan  # m/s, once an interval ends


class IntervalBuilder:
    """Cuts a drive into intervals from tracks that others fill.

    An interval is given once the battery is known on both sides of it and the car has gone
    `height.REACH` beyond it, so that heights are averages around a place; not later than
    `WAIT_NS`, without what is missing then.
    """

    def __init__(
        self,
        speed: SpeedTrack,
        battery: BatteryTrack,
        motor: MotorTrack,
        road: Road,
        late_ns: int,
    ) -> None:
        """Start empty; nothing younger than late_ns is looked at, for more may come."""
        self._speed, self._battery, self._motor, self._road = speed, battery, motor, road
        self._height = HeightProfile()
        self._settled_ns = max(late_ns, EDGE_AHEAD_NS)
        self._edges: list[_Edge] = []
        self._complete: deque[list[_Edge]] = deque()
        self._passed: deque[tuple[int, float]] = deque(maxlen=PASSED)
        self._odometer = self._air = 0.0

    def intervals(self) -> Iterator[Interval]:
        """Take what the tracks hold since the last call; give the intervals that are ready."""
        settled_ns = self._speed.newest_ns - self._settled_ns
        for stamp_ns in self._next_edges(settled_ns):
            self._add_edge(stamp_ns)
        while self._complete and self._ready(self._complete[0][-1]):
            yield from self._split(self._complete.popleft())

    def finish(self) -> Iterator[Interval]:
        """The intervals that are waiting, with what is known now: the drive ends, or a gap."""
        if len(self._edges) > 1:
            self._end()
        self._edges = []
        while self._complete:
            yield from self._split(self._complete.popleft())

    @property
    def duration(self) -> float:
        """Shortest interval at the rates of the signals, s."""
        period = max(self._speed.cadence.period, self._battery.period)
        return max(DURATION, READINGS * period)

    def _next_edges(self, settled_ns: int) -> list[int]:
        """Stamps of speed at least `STEP` apart, up to the moment from which more may come."""
        stamps = self._speed.stamps
        last = self._edges[-1].stamp_ns if self._edges else None
        first = 0 if last is None else bisect_right(stamps, last)
        edges = []
        for stamp_ns in stamps[first : bisect_right(stamps, settled_ns)]:
            if last is None or stamp_ns - last >= STEP * NANOSECONDS - LAG_TOLERANCE_NS:
                edges.append(stamp_ns)
                last = stamp_ns
        return edges

    def _add_edge(self, stamp_ns: int) -> None:
        conditions = self._road.conditions(stamp_ns)
        motor, leapt = (math.nan, math.nan), False
        if self._edges:
            last = self._edges[-1].stamp_ns
            leapt = self._speed.leaps(last, stamp_ns)
            distance, air = self._speed.travelled(last, stamp_ns, conditions.head_wind)
            self._odometer, self._air = self._odometer + distance, self._air + air
            motor = self._motor.energy(last, stamp_ns)
        edge = _Edge(stamp_ns, self._odometer, self._air, motor, conditions, leapt)
        self._passed.append((stamp_ns, self._odometer))
        stamps, odometers = zip(*self._passed, strict=True)
        for place, height in self._road.heights(stamps, odometers):
            self._height.add(place, height)
        self._edges.append(edge)
        whole_ns = int(self.duration * NANOSECONDS) - LAG_TOLERANCE_NS
        if stamp_ns - self._edges[0].stamp_ns >= whole_ns:
            self._end()
            self._edges = [edge]

    def _end(self) -> None:
        """Let the edges so far be an interval; smooth speed at those where it is not known."""
        new = [edge for edge in self._edges if math.isnan(edge.speed)]
        speeds, _ = self._speed.smoothed([edge.stamp_ns for edge in new], EDGE_AHEAD_NS)
        for edge, speed in zip(new, speeds.tolist(), strict=True):
            edge.speed = speed
        self._complete.append(self._edges)

    def _ready(self, end: _Edge) -> bool:
        """True if all is known, by what may come no more: whatever the order of arrival."""
        settled_ns = self._speed.newest_ns - self._settled_ns
        if settled_ns - end.stamp_ns > WAIT_NS:
            return True
        after_ns = self._battery.next_ns(end.stamp_ns)
        battery = after_ns is not None and after_ns <= settled_ns
        dropout = settled_ns - end.stamp_ns > self._battery.gap_ns
        known = self._height.known_at(self._odometer)
        height = not known or self._height.reaches(end.odometer + REACH)
        return (battery or dropout) and height

    def _split(self, edges: list[_Edge]) -> Iterator[Interval]:
        """The interval between edges, or two of it where the battery drops out or comes back."""
        stamps = [edge.stamp_ns for edge in edges]
        measured = self._battery.covered(stamps).tolist()
        first = 0
        for last in range(1, len(edges)):
            if last == len(edges) - 1 or measured[last] != measured[last - 1]:
                yield self._interval(edges[first : last + 1])
                first = last

    def _interval(self, edges: list[_Edge]) -> Interval:
        start, end = edges[0], edges[-1]
        measured = self._battery.energy(start.stamp_ns, end.stamp_ns)
        heights = self._height.means_around(np.array([edge.odometer for edge in edges]))
        climb = np.zeros(len(edges) - 1) if heights is None else np.diff(heights)
        drive, brake = np.array([edge.motor for edge in edges[1:]]).T
        speed = np.array([edge.speed for edge in edges])
        steps = Steps(
            duration=np.diff([edge.stamp_ns for edge in edges]) / NANOSECONDS,
            distance=np.diff([edge.odometer for edge in edges]),
            air=np.diff([edge.air for edge in edges]),
            kinetic=np.diff(speed**2) / 2,
            climb=climb,
            motor_drive=drive,
            motor_brake=brake,
            motor_scaled=self._motor.scaled,
        )
        return Interval(
            start_ns=start.stamp_ns,
            end_ns=end.stamp_ns,
            steps=steps,
            conditions=end.conditions._replace(
                load=float(np.mean([edge.conditions.load for edge in edges])),
                doubted_load=float(np.mean([edge.conditions.doubted_load for edge in edges])),
            ),
            height_known=heights is not None,
            energy=measured.energy,
            sampling_variance=measured.variance,
            leaps=any(edge.leapt for edge in edges[1:]),
            returned=measured.returned,
        )
