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

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.height import KNOWN_WITHIN, REACH, HeightProfile
from evpinn_ros.core.signals.kinematics import LAG_TOLERANCE_NS, SpeedTrack
from evpinn_ros.core.signals.power import BatteryTrack, MotorTrack
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.road import Conditions, Road
from evpinn_ros.core.signals.track import BEFORE, LATER

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
    """The border between two steps.

    Attributes:
        stamp_ns: the moment.
        order: place in the order of arrival at which it was added.
        odometer: m.
        air: integral of the air's flow since the start, m^3/s^2.
        motor: energy of driving and of braking since the edge before, J.
        conditions: around it.
        leapt: whether speed did since the edge before, by more than tyres can.
        heights: how many heights were known once it was added.
        seen: how far heights were known then, m by the odometer.
        speed: m/s, once an interval ends.
    """

    stamp_ns: int
    order: int
    odometer: float
    air: float
    motor: tuple[float, float]
    conditions: Conditions
    leapt: bool
    heights: int
    seen: float
    speed: float = math.nan


def _each(conditions: Conditions) -> Iterator[Conditions]:
    """The conditions at each moment; a temperature that is not known is None."""
    for row in zip(*(column.tolist() for column in conditions), strict=True):
        around = Conditions(*row)
        yield around._replace(celsius=None) if math.isnan(around.celsius) else around


class _Complete(NamedTuple):
    """Edges of an interval that waits for what lies around it."""

    edges: Sequence[_Edge]
    order: int


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
        self._complete: deque[_Complete] = deque()
        # Stamps and odometers of the last edges.
        self._passed = np.empty(0, np.int64), np.empty(0)
        self._last: _Edge | None = None

    @property
    def needed_ns(self) -> int:
        """Earliest moment that intervals yet to come look at, ns."""
        first = self._complete[0].edges if self._complete else self._edges
        return first[0].stamp_ns if first else LATER

    def intervals(self, orders: np.ndarray, stamps: np.ndarray) -> Iterator[tuple[int, Interval]]:
        """Take what the tracks hold since the last call; give the intervals that are ready.

        Each with the place in the order of arrival at which it is.

        Args:
            orders: places of the new speeds.
            stamps: of them, ns.
        """
        added = self._add_edges(orders, stamps)
        ready = 0
        while self._complete:
            ready = self._ready(self._complete[0], added, orders, stamps, ready)
            if ready == len(orders):
                return
            order = int(orders[ready])
            heights = next(edge.heights for edge in reversed(added) if edge.order <= order)
            for interval in self._split(self._complete.popleft().edges, order, heights):
                yield order, interval

    def finish(self) -> Iterator[Interval]:
        """The intervals that are waiting, with what is known now: the drive ends, or a gap."""
        if len(self._edges) > 1:
            self._end()
        self._edges = []
        while self._complete:
            yield from self._split(self._complete.popleft().edges, LATER, self._height.known[0])

    def settle(self) -> None:
        """Take all as come before."""
        self._complete = deque(part._replace(order=BEFORE) for part in self._complete)
        pending = self._complete[0].edges if self._complete else self._edges
        if pending:
            self._height.forget_before(pending[0].odometer)
        if self._last is not None:
            self._last.order, self._last.heights = BEFORE, self._height.known[0]

    def _add_edges(self, orders: np.ndarray, stamps: np.ndarray) -> list[_Edge]:
        """Take the edges up to the moments from which more may come; give the last and them."""
        edge_ns = self._next_edges(int(stamps[-1]) - self._settled_ns)
        last = self._last
        added = [] if last is None else [last]
        if not len(edge_ns):
            return added
        by = orders[np.searchsorted(stamps, edge_ns + self._settled_ns)]
        conditions = self._road.conditions(edge_ns, by)
        # The first edge of all ends no step.
        ends = edge_ns if last is None else np.append(last.stamp_ns, edge_ns)
        distance, air, leaps = self._speed.driven(ends, conditions.head_wind[last is None :])
        motor = self._motor.energies(ends, by[last is None :])
        begin = (0.0, 0.0) if last is None else (last.odometer, last.air)
        first = 0 if last is None else 1
        odometers, flows = (
            np.cumsum(np.append(start, steps))[first:]
            for start, steps in zip(begin, (distance, air), strict=True)
        )
        if last is None:
            leaps, motor = np.append(False, leaps), np.column_stack(([math.nan] * 2, motor))
        periods = np.maximum(self._speed.period(by), self._battery.period(by))
        rows = zip(
            *(column.tolist() for column in (edge_ns, by, odometers, flows)),
            map(tuple, motor.T.tolist()), _each(conditions), leaps.tolist(),
            self._heights(edge_ns, odometers, by), periods.tolist(), strict=True,
        )  # fmt: skip
        for *row, heights, period in rows:
            self._last = _Edge(*row, *heights)
            added.append(self._last)
            self._edges.append(self._last)
            whole_ns = int(max(DURATION, READINGS * period) * NANOSECONDS) - LAG_TOLERANCE_NS
            if self._last.stamp_ns - self._edges[0].stamp_ns >= whole_ns:
                self._end()
                self._edges = [self._last]
        return added

    def _heights(
        self, edge_ns: np.ndarray, odometers: np.ndarray, by: np.ndarray
    ) -> list[tuple[int, float]]:
        """How many heights are known once each edge is added, and up to where, m."""
        passed = len(self._passed[0])
        stamps, ways = (
            np.append(before, new)
            for before, new in zip(self._passed, (edge_ns, odometers), strict=True)
        )
        self._passed = stamps[1 - PASSED :], ways[1 - PASSED :]
        if not self._road.shows_heights:
            return [self._height.known] * len(edge_ns)
        counts = []
        for heights in self._road.heights(stamps, ways, by, passed, PASSED):
            for place, height in heights:
                self._height.add(place, height)
            counts.append(self._height.known)
        return counts

    def _next_edges(self, settled_ns: int) -> np.ndarray:
        """Stamps of speed at least `STEP` apart, up to the moment from which more may come."""
        stamps = self._speed.stamps
        stamps = stamps[: np.searchsorted(stamps, settled_ns, side="right")]
        least_ns = int(STEP * NANOSECONDS) - LAG_TOLERANCE_NS
        if self._last is None:
            place = 0
        else:
            place = int(np.searchsorted(stamps, self._last.stamp_ns + least_ns))
        places = []
        while place < len(stamps):
            places.append(place)
            place = int(np.searchsorted(stamps, stamps[place] + least_ns))
        return np.asarray(stamps[places])

    def _end(self) -> None:
        """Let the edges so far be an interval; smooth speed at those where it is not known."""
        new = [edge for edge in self._edges if math.isnan(edge.speed)]
        speeds = self._speed.smoothed(np.array([edge.stamp_ns for edge in new]), EDGE_AHEAD_NS)
        for edge, speed in zip(new, speeds.tolist(), strict=True):
            edge.speed = speed
        self._complete.append(_Complete(self._edges, self._edges[-1].order))

    def _ready(
        self,
        part: _Complete,
        added: Sequence[_Edge],
        orders: np.ndarray,
        stamps: np.ndarray,
        first: int,
    ) -> int:
        """Which of the new speeds, from `first` on, makes a part ready; their number if none.

        All is known then, by what may come no more, whatever the order of arrival.
        """
        end = part.edges[-1]
        first = max(first, int(np.searchsorted(orders, part.order)))
        settled_ns = stamps[first:] - self._settled_ns - end.stamp_ns
        waited = int(np.searchsorted(settled_ns, WAIT_NS, side="right"))
        settled_ns, by = settled_ns[:waited], orders[first : first + waited]
        (after_ns,), (came,) = self._battery.first_after(np.array([end.stamp_ns]))
        battery = (came <= by) & (after_ns - end.stamp_ns <= settled_ns)
        dropout = settled_ns > self._battery.gap_ns(by)
        edge = np.searchsorted([edge.order for edge in added], by, side="right") - 1
        way = np.array([edge.odometer for edge in added])[edge]
        seen = np.array([edge.seen for edge in added])[edge]
        height = (way - seen >= KNOWN_WITHIN) | (seen >= end.odometer + REACH)
        ready = np.flatnonzero((battery | dropout) & height)
        return first + (int(ready[0]) if len(ready) else waited)

    def _split(self, edges: Sequence[_Edge], by: int, heights: int) -> Iterator[Interval]:
        """The interval between edges, or two of it where the battery drops out or comes back.

        By a place in the order of arrival, when so many heights are known.
        """
        stamps = np.array([edge.stamp_ns for edge in edges])
        measured = self._battery.covered(stamps, by).tolist()
        first = 0
        for last in range(1, len(edges)):
            if last == len(edges) - 1 or measured[last] != measured[last - 1]:
                yield self._interval(edges[first : last + 1], by, heights)
                first = last

    def _interval(self, edges: Sequence[_Edge], by: int, count: int) -> Interval:
        start, end = edges[0], edges[-1]
        measured = self._battery.energy(start.stamp_ns, end.stamp_ns, by)
        odometers = np.array([edge.odometer for edge in edges])
        heights = self._height.means_around(odometers, count)
        climb = np.zeros(len(edges) - 1) if heights is None else np.diff(heights)
        drive, brake = np.array([edge.motor for edge in edges[1:]]).T
        speed = np.array([edge.speed for edge in edges])
        steps = Steps(
            duration=np.diff([edge.stamp_ns for edge in edges]) / NANOSECONDS,
            distance=np.diff(odometers),
            air=np.diff([edge.air for edge in edges]),
            kinetic=np.diff(speed**2) / 2,
            climb=climb,
            motor_drive=drive,
            motor_brake=brake,
            motor_scaled=bool(self._motor.scaled(by)),
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
