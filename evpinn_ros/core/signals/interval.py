"""Intervals of driving: the weak form of eq. 12-21, without a derivative.

The residual of learning is energy over an interval, not power at a sample. The integral of v a is
the difference of v^2 / 2 and that of v sin(grade) the difference of height, exactly, so no
acceleration is needed; battery energy is integrated between the battery's own stamps. An interval
lasts 10 s on a fast bus or a polled car, longer in a phone's slow log (the variational form of a
PINN: Kharazmi 2019; of system identification: Messenger and Bortz 2021). In shorter ones slow
errors would count as white noise. An interval ends where the battery drops out, so that all
measured energy is learned from.

Within an interval, steps of at least `STEP` keep driving and braking apart.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.signals.height import KNOWN_WITHIN, REACH, HeightProfile
from evpinn_ros.core.signals.kinematics import LAG_TOLERANCE_NS, SpeedTrack
from evpinn_ros.core.signals.power import BatteryTrack, MotorTrack
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.road import Conditions, Road
from evpinn_ros.core.signals.track import LATER, NEVER

STEP = 0.5  # s, shortest step within an interval
DURATION = 10.0  # s, shortest interval, except one that a dropout or a gap ends
READINGS = 6  # least length of an interval in usual steps of the slower signal
# Time after an edge, ns, whose speeds smooth the speed at the edge, by a local quadratic: a mean
# flattens the ups and downs of speed, which made m/eta 0.7 % too large.
EDGE_AHEAD_NS = 250_000_000
LEAST_STEP_NS = int(STEP * NANOSECONDS) - LAG_TOLERANCE_NS
LOAD = Conditions._fields.index("load")
WAIT_NS = 60 * NANOSECONDS  # longest wait for the height or battery around an interval


class Steps(NamedTuple):
    """The steps of an interval as columns of shape (n,).

    Attributes:
        duration: s.
        distance: m.
        air: integral of flow |flow| v with the flow of air against the car, m^3/s^2.
        kinetic: difference of v^2 / 2, J/kg.
        climb: difference of height, m; 0 where unknown.
        motor_drive: energy of the motor while it drives, J; NaN if unknown, as in plans.
        motor_brake: the same while it brakes, positive J.
        motor_scaled: True if these are in J; False if an unknown gear ratio scales them.
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

    @property
    def without_motor(self) -> Steps:
        """The same motion, with the energy of the motor unknown."""
        return Steps(self.duration, self.distance, self.air, self.kinetic, self.climb)


@dataclass(frozen=True, slots=True)
class Interval:
    """Driving between two stamps, with its battery energy.

    Attributes:
        start_ns: begin.
        end_ns: end.
        steps: motion of the car.
        conditions: at its end; the load is the mean over the interval.
        height_known: whether `climb` is measured.
        energy: drawn from the battery, J, NaN where not measured.
        sampling_variance: variance of `energy` due to the battery's sampling rate, J^2.
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
        """From its first stamp to its last, s."""
        return (self.end_ns - self.start_ns) / NANOSECONDS

    @property
    def distance(self) -> float:
        """Length on the road, m."""
        return float(self.steps.distance.sum())


class _Edges(NamedTuple):
    """Borders between steps, in order of stamps, shape (n, ...) each.

    Attributes:
        stamps: ns.
        odometer: m.
        air: integral of the air's flow since the start, m^3/s^2.
        motor: energy of driving and of braking since the edge before, J, shape (n, 2).
        around: columns of `Conditions`, shape (n, 5).
        leapt: whether speed changed since the edge before by more than tyres can.
        speed: m/s, smoothed.
        seen: odometer up to which heights were known when the edge was added, m.
    """

    stamps: np.ndarray
    odometer: np.ndarray
    air: np.ndarray
    motor: np.ndarray
    around: np.ndarray
    leapt: np.ndarray
    speed: np.ndarray
    seen: np.ndarray

    def where(self, chosen: slice) -> _Edges:
        """The edges of a slice."""
        return _Edges._make(column[chosen] for column in self)


NO_EDGES = _Edges(
    np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty((0, 2)), np.empty((0, 5)),
    np.empty(0, bool), np.empty(0), np.empty(0),
)  # fmt: skip


class IntervalBuilder:
    """Cuts a drive into intervals, up to the newest speed of its tracks, which the owner fills.

    An interval is ready once the battery is known on both sides of it and heights are known
    `height.REACH` beyond it, so that they are averages around a place; after `WAIT_NS` it is ready
    without either.
    """

    def __init__(
        self, speed: SpeedTrack, battery: BatteryTrack, motor: MotorTrack, road: Road
    ) -> None:
        """Start without an edge."""
        self._speed, self._battery, self._motor, self._road = speed, battery, motor, road
        self._height = HeightProfile()
        self._edges = NO_EDGES  # from the first edge of the next interval on
        self._begin = 0  # index of the first edge of the open interval
        self._complete: deque[tuple[int, int]] = deque()  # indices of first and last edges
        self._looked_ns = NEVER  # up to here no complete interval was ready

    @property
    def needed_ns(self) -> int:
        """Earliest moment that later intervals need, ns."""
        return int(self._edges.stamps[0]) if len(self._edges.stamps) else LATER

    def intervals(self) -> Iterator[tuple[int, Interval]]:
        """Yields (stamp of the speed that made it ready, interval)."""
        self._add_edges()
        while self._complete:
            ready_ns = self._ready_ns(self._complete[0][1])
            if ready_ns == LATER:
                break
            first, last = self._complete.popleft()
            seen = float(self._edges.seen[self._last_edge(ready_ns)])
            for interval in self._split(self._edges.where(slice(first, last + 1)), seen):
                yield ready_ns, interval
        self._forget()

    def finish(self) -> Iterator[Interval]:
        """Yields the waiting intervals as they are, at the end of a drive or at a gap.

        The last edge stays: the next interval begins there.
        """
        if len(self._edges.stamps) > self._begin + 1:
            self._complete.append((self._begin, len(self._edges.stamps) - 1))
        while self._complete:
            first, last = self._complete.popleft()
            edges = self._edges.where(slice(first, last + 1))
            yield from self._split(edges, self._height.seen)
        self._edges, self._begin = self._edges.where(slice(-1, None)), 0

    def _forget(self) -> None:
        """Drop the edges before the first interval to come."""
        first = self._complete[0][0] if self._complete else self._begin
        if first:
            self._edges = self._edges.where(slice(first, None))
            self._begin -= first
            self._complete = deque((a - first, b - first) for a, b in self._complete)
            self._height.forget_before(float(self._edges.odometer[0]))

    def _add_edges(self) -> None:
        """Add edges at the speeds that can be smoothed by now."""
        edges, new_ns = self._edges, self._next_edges()
        if not len(new_ns):
            return
        is_first = not len(edges.stamps)  # it ends no step
        ends = new_ns if is_first else np.append(edges.stamps[-1], new_ns)
        around = self._road.conditions(new_ns)
        distance, air, leaps = self._speed.driven(ends, around.head_wind[is_first:])
        motor = self._motor.energies(ends).T
        if is_first:
            distance, air, leaps = (np.append(0, column) for column in (distance, air, leaps))
            motor = np.concatenate((np.full((1, 2), np.nan), motor))
        begin = (0.0, 0.0) if is_first else (edges.odometer[-1], edges.air[-1])
        odometer, flow = (
            np.cumsum(np.append(start, steps))[1:]
            for start, steps in zip(begin, (distance, air), strict=True)
        )
        seen = self._add_heights(new_ns, odometer)
        columns = np.stack(np.broadcast_arrays(*around), axis=1).astype(float)
        speed = self._speed.smoothed(new_ns, EDGE_AHEAD_NS)
        new = _Edges(new_ns, odometer, flow, motor, columns, leaps.astype(bool), speed, seen)
        self._edges = _Edges._make(map(np.concatenate, zip(edges, new, strict=True)))
        self._end_intervals(len(edges.stamps))

    def _next_edges(self) -> np.ndarray:
        """Stamps of speeds at least `STEP` apart, up to the last that can be smoothed by now."""
        stamps = self._speed.stamps
        stamps = stamps[: stamps.searchsorted(stamps[-1] - EDGE_AHEAD_NS, side="right")]
        last_ns = self._edges.stamps[-1:]
        place = int(stamps.searchsorted(last_ns[0] + LEAST_STEP_NS)) if len(last_ns) else 0
        places = []
        nexts = stamps.searchsorted(stamps + LEAST_STEP_NS).tolist()
        while place < len(stamps):
            places.append(place)
            place = nexts[place]
        return np.asarray(stamps[places])

    def _add_heights(self, stamps: np.ndarray, odometer: np.ndarray) -> np.ndarray:
        """Add the heights up to each new edge; returns `_Edges.seen` of these."""
        if not self._road.shows_heights:
            return np.full(len(stamps), self._height.seen)
        before = (self._edges.stamps, stamps), (self._edges.odometer, odometer)
        if not len(self._edges.stamps):
            before = (stamps[:1], stamps), (odometer[:1], odometer)
        seen = []
        for heights in self._road.heights(*(np.append(a[-1:], b) for a, b in before)):
            for place, height in heights:
                self._height.add(place, height)
            seen.append(self._height.seen)
        return np.array(seen)

    def _end_intervals(self, first: int) -> None:
        """End intervals at edges from a place on."""
        stamps = self._edges.stamps
        new = stamps[first:]
        periods = np.maximum(self._speed.period(new), self._battery.period(new))
        whole = np.maximum(DURATION, READINGS * periods) * NANOSECONDS - LAG_TOLERANCE_NS
        rows = zip(stamps[first:].tolist(), whole.tolist(), strict=True)
        begin_ns = int(stamps[self._begin])
        for place, (stamp_ns, whole_ns) in enumerate(rows, start=first):
            if stamp_ns - begin_ns >= whole_ns:
                self._complete.append((self._begin, place))
                self._begin, begin_ns = place, stamp_ns

    def _last_edge(self, stamps: Any) -> Any:
        """Places of the last edges that were added by speeds at stamps, ns."""
        return self._edges.stamps.searchsorted(stamps - EDGE_AHEAD_NS, side="right") - 1

    def _ready_ns(self, last: int) -> int:
        """Stamp of the speed that makes an interval ready, by its last edge; `LATER` if none."""
        end_ns, speeds = int(self._edges.stamps[last]), self._speed.stamps
        begin_ns = max(self._looked_ns, end_ns + EDGE_AHEAD_NS)
        speeds = speeds[speeds.searchsorted(begin_ns) :]
        # What was known when each of these speeds came.
        after = speeds - end_ns
        battery = speeds >= self._battery.first_after(np.array([end_ns]))
        dropout = after > self._battery.gap_ns(speeds)
        added = self._last_edge(speeds)
        seen = self._edges.seen[added]
        height = self._edges.odometer[added] - seen >= KNOWN_WITHIN
        height |= seen >= self._edges.odometer[last] + REACH
        ready = np.flatnonzero(((battery | dropout) & height) | (after > WAIT_NS))
        if len(ready):
            self._looked_ns = int(speeds[ready[0]])
            return self._looked_ns
        self._looked_ns = int(self._speed.stamps[-1]) + 1
        return LATER

    def _split(self, edges: _Edges, seen: float) -> Iterator[Interval]:
        """The interval between edges, or two of it where the battery drops out or comes back."""
        measured = self._battery.covered(edges.stamps)
        ends = [*(np.flatnonzero(measured[1:] != measured[:-1]) + 1).tolist(), len(measured)]
        first = 0
        for last in ends:
            yield self._interval(edges.where(slice(first, last + 1)), seen)
            first = last

    def _interval(self, edges: _Edges, seen: float) -> Interval:
        start_ns, end_ns = edges.stamps[[0, -1]].tolist()
        measured = self._battery.energy(start_ns, end_ns)
        heights = self._height.means_around(edges.odometer, seen)
        steps = Steps(
            duration=np.diff(edges.stamps) / NANOSECONDS,
            distance=np.diff(edges.odometer),
            air=np.diff(edges.air),
            kinetic=np.diff(edges.speed**2) / 2,
            climb=np.zeros(len(edges.stamps) - 1) if heights is None else np.diff(heights),
            motor_drive=edges.motor[1:, 0],
            motor_brake=edges.motor[1:, 1],
            motor_scaled=bool(self._motor.scaled(end_ns)),
        )
        around = Conditions(*edges.around[-1].tolist())
        return Interval(
            start_ns=start_ns,
            end_ns=end_ns,
            steps=steps,
            conditions=around._replace(
                celsius=None if math.isnan(around.celsius) else around.celsius,
                load=float(edges.around[:, LOAD].mean()),
                load_known=bool(around.load_known),
            ),
            height_known=heights is not None,
            energy=measured.energy,
            sampling_variance=measured.variance,
            leaps=bool(edges.leapt[1:].any()),
            returned=measured.returned,
        )
