"""Readings in, one time-ordered stream of samples and intervals out: a block at a time.

Speed sets the pace. Each new speed gives a newest sample at once; each moment that lies
`smoothing_lag` back gives a smoothed one (at most one each `SAMPLE_PERIOD`), and it is measured
once battery readings on both sides of it are known, not before the smoothed
moments up to the later one, so that no prediction rests on a battery reading of its own moment or
after, and not before `allowed_lateness` has passed since the later one, so that the samples are
the same in whatever order battery readings come until then. Voltage and current may come apart.
Beside the samples, which predict and follow power, stand the intervals that the car is learned
from (`signals.interval`). What is late, doubled or impossible is dropped and counted by reason.
Time that jumps is not this module's: whoever feeds a stream puts a `signals.time_jump.StampGuard`
before it.

The arithmetic of a block is done in arrays, each value by the readings that had come by then
(`signals.track`). A block is cut where a reading comes out of order or after a gap; how it is cut
changes nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import NO_ROWS, Block, Rows, impossible
from evpinn_ros.core.signals.interval import Interval, IntervalBuilder
from evpinn_ros.core.signals.kinematics import (
    LAG_TOLERANCE_NS,
    LOOK_BACK_NS,
    MAX_ACCELERATION,
    PROFILE,
    CausalDifferentiator,
    Speeds,
    SpeedTrack,
    profile,
)
from evpinn_ros.core.signals.power import BatteryTrack, MotorTrack
from evpinn_ros.core.signals.readings import (
    MAX_SPEED,
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.signals.road import GradeSource, Road
from evpinn_ros.core.signals.sample import NO_SAMPLES, Events, Measured, Samples, joined_samples
from evpinn_ros.core.signals.track import BEFORE, LATER, NEVER

SAMPLE_PERIOD = 0.1  # s, shortest step between smoothed samples
PERIOD_NS = int(SAMPLE_PERIOD * NANOSECONDS) - LAG_TOLERANCE_NS


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Settings by which readings become samples.

    Attributes:
        smoothing_lag: s of future speed the smoothed samples may use.
        allowed_lateness: s by which a reading may be older than the newest of its kind. Power is
            learned this much later; beyond `smoothing_lag` that costs accuracy.
        max_gap: s without speed (or battery) across which nothing is joined; signals that come
            slowly are joined across some of their own steps (`track.SignalTrack`).
        grade_source: where grade comes from.
    """

    smoothing_lag: float = 0.3
    allowed_lateness: float = 0.3
    max_gap: float = 2.5
    grade_source: GradeSource = GradeSource.AUTO


class _Smoothed(NamedTuple):
    """Moments that lie `smoothing_lag` back, shape (n,) each, slopes (n, PROFILE)."""

    order: np.ndarray
    stamps: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    slopes: np.ndarray


class _Part(NamedTuple):
    """What a part of a block gave, by places in the whole block."""

    newest: Samples = NO_SAMPLES
    newest_order: np.ndarray = np.empty(0, np.int64)
    smoothed: Samples = NO_SAMPLES
    smoothed_order: np.ndarray = np.empty(0, np.int64)
    measured: Samples = NO_SAMPLES
    measured_order: np.ndarray = np.empty(0, np.int64)
    measured_place: np.ndarray = np.empty(0, np.int64)
    measured_power: np.ndarray = np.empty(0)
    told: np.ndarray = np.empty((2, 0), np.int64)
    powers: np.ndarray = np.empty((2, 0))
    moments: np.ndarray = np.empty((2, 0), np.int64)
    battery: np.ndarray = np.empty((3, 0), np.int64)


class SampleStream:
    """Readings of one car in, samples and intervals in order of time out.

    Attributes:
        dropped: readings not used, by reason.
    """

    def __init__(
        self,
        settings: StreamSettings,
        air_density: float,
        motor_ratio: float = math.nan,
        *,
        intervals_alone: bool = False,
    ) -> None:
        """Start empty.

        Args:
            settings: how to align.
            air_density: kg/m^3, used while no temperature is known.
            motor_ratio: rad that the motor turns per m of road, NaN where unknown.
            intervals_alone: give no samples.
        """
        self._intervals_alone = intervals_alone
        self._settings = settings
        self._lag_ns = int(settings.smoothing_lag * NANOSECONDS) - LAG_TOLERANCE_NS
        lateness_ns = int(settings.allowed_lateness * NANOSECONDS)
        self._late_ns = max(0, lateness_ns - LAG_TOLERANCE_NS)
        self._motor_ratio = motor_ratio
        self._differentiator = CausalDifferentiator()
        self._road = Road(settings.grade_source, air_density)
        self.dropped: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget every reading, after a jump of time; what was learned of speed is kept."""
        gap = self._settings.max_gap
        self._speed, self._battery = SpeedTrack(gap), BatteryTrack(gap)
        self._motor = MotorTrack(gap, self._motor_ratio)
        self._moments = np.empty(0, np.int64)  # that no smoothed sample was made of yet
        self._unmeasured = NO_SAMPLES
        self._last_moment_ns = NEVER
        self._begin_stretch()

    def _begin_stretch(self) -> None:
        """Join nothing across what was: a jump of time, or a gap."""
        self._differentiator.forget_pending()
        self._road.forget()
        self._intervals = IntervalBuilder(
            self._speed, self._battery, self._motor, self._road, self._late_ns
        )

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest speed, None before the first."""
        return self._speed.newest_ns if len(self._speed) else None

    @property
    def unknown(self) -> tuple[str, ...]:
        """Optional inputs without data (see `Road.unknown`)."""
        return self._road.unknown(self.newest_ns or 0)

    @property
    def battery_ns(self) -> int | None:
        """Stamp of the newest battery reading, None before the first."""
        newest_ns = int(self._battery.newest_ns())
        return None if newest_ns == NEVER else newest_ns

    @property
    def battery_gap_ns(self) -> int:
        """Nanoseconds without the battery after which a dropout begins, by its own rate."""
        return int(self._battery.gap_ns())

    def finish(self) -> Iterator[Interval]:
        """The intervals that wait for more of a drive that is over."""
        if len(self._speed):
            yield from self._intervals.finish()

    def add_block(self, block: Block) -> Events:
        """Take readings in the order they came, and give what they complete."""
        self._taken = np.ones(block.length, dtype=bool)
        self._ended: list[tuple[int, Interval]] = []
        self._smoothed_before = 0  # in this block
        block = self._possible(block)
        parts, first = [], 0
        while first < block.length:
            count = self._in_order(block.part(first, block.length))
            if count:
                parts.append(self._add(block.part(first, first + count), first))
            elif not self._is_gap(block, first):
                parts.append(self._add_stray(next(block.part(first, first + 1).readings()), first))
                count = 1
            first += count
        return self._events(parts)

    def _events(self, parts: list[_Part]) -> Events:
        part = parts[0] if len(parts) == 1 else _joined_parts(parts)
        measured = Measured(
            part.measured_order, part.measured_place, part.measured, part.measured_power
        )
        return Events(
            part.newest, part.newest_order, part.smoothed, part.smoothed_order, measured,
            self._ended, (*part.told, *part.powers), tuple(part.moments),
            tuple(part.battery), self._taken,
        )  # fmt: skip

    def _possible(self, block: Block) -> Block:
        """The block without readings that are impossible, or hold nothing."""
        for kind, rows in block.rows.items():
            wrong = impossible(kind, rows)
            if kind is BatteryReading:
                unmeasured = np.isnan(rows.values[:2]).all(axis=0)
                seen = np.zeros(len(unmeasured), dtype=bool)
                for _, which in wrong:
                    seen |= which
                if (unmeasured & ~seen).any():
                    wrong = [*wrong, ("battery_unmeasured", unmeasured & ~seen)]
            for reason, which in wrong:
                self._drop(reason, rows.order[which])
            if wrong:
                block = block.with_rows(kind, rows.where(self._taken[rows.order]))
        return block

    def _drop(self, reason: str, orders: Any) -> None:
        """Count readings that are not used, or not whole."""
        self.dropped[reason] += np.size(orders)
        self._taken[orders] = False

    def _in_order(self, block: Block) -> int:
        """How many readings of a block, from the first on, come in order and without a gap."""
        count = block.length
        speeds = block.of_kind(SpeedReading)
        in_order = self._speed.in_order(speeds.stamps)
        if in_order:
            stamps = speeds.stamps[:in_order]
            newest = self._speed.stamps[-1:] if len(self._speed) else stamps[:1]
            steps = stamps - np.concatenate((newest, stamps[:-1]))
            if steps.max() > self._settings.max_gap * NANOSECONDS:  # no gap is shorter
                *_, gaps = self._speed.rates(stamps)
                before = np.concatenate(([self._speed.gap_ns()], gaps[:-1]))
                apart = np.flatnonzero(steps > before)
                in_order = int(apart[0]) if len(apart) else in_order
        tracks = (
            (speeds, in_order),
            (rows := block.of_kind(BatteryReading), self._battery.in_order(rows)),
            (rows := block.of_kind(MotorReading), self._motor.power.in_order(rows.stamps)),
            (rows := block.of_kind(AltitudeReading), self._road.altitudes.in_order(rows.stamps)),
        )
        for rows, ordered in tracks:
            if ordered < len(rows.order):
                count = min(count, int(rows.order[ordered]))
        return count

    def _is_gap(self, block: Block, place: int) -> bool:
        """Begin another stretch where a speed comes after a gap; False where it does not."""
        speeds = block.of_kind(SpeedReading)
        index = int(speeds.order.searchsorted(place))
        here = index < len(speeds.order) and speeds.order[index] == place
        if not here or speeds.stamps[index] <= self._speed.newest_ns:
            return False
        self._ended += [(place, interval) for interval in self._intervals.finish()]
        gap = (int(speeds.stamps[index]) - self._speed.newest_ns) / NANOSECONDS
        self._speed.restart(gap)
        self._moments = np.empty(0, np.int64)
        self._begin_stretch()
        return True

    def _add_stray(self, reading: Reading, order: int) -> _Part:
        """Take a reading that comes out of order."""
        if isinstance(reading, SpeedReading):
            if self._speed.newest_ns - reading.stamp_ns > self._late_ns:
                self._drop("speed_late", order)
            elif not self._speed.insert(reading.stamp_ns, reading.speed):
                self._drop("speed_doubled", order)
            return _Part(moments=np.array([[order], [self._speed.newest_ns]]))
        if isinstance(reading, AltitudeReading):
            self._road.insert(reading)
        elif isinstance(reading, MotorReading):
            if len(self._speed):
                power = self._motor.powers(_row_of(reading), self._speed.values[-1:])
                self._motor.power.insert(reading.stamp_ns, float(power[0]))
        elif isinstance(reading, BatteryReading):
            return self._add_stray_battery(reading, order)
        return _Part()

    def _add_stray_battery(self, reading: BatteryReading, order: int) -> _Part:
        newest_ns = int(self._battery.newest_ns())
        if newest_ns - reading.stamp_ns > self._late_ns and newest_ns != NEVER:
            self._drop("battery_late", order)
            return _Part()
        if not self._battery.insert(reading):
            self._drop("battery_doubled", order)
            return _Part()
        rows = _row_of(reading)._replace(order=np.array([LATER]))
        part = _Part(
            told=np.array([[order], [reading.stamp_ns]]),
            powers=np.array([self._battery.told(rows), rows.values[3]]),
            battery=np.array([[order], [self._battery.newest_ns()], [self._battery.gap_ns()]]),
        )
        return self._with_measured(part, NO_ROWS[SpeedReading], order, self._last_moment_ns)

    def _add(self, block: Block, first: int) -> _Part:
        """Take readings in order, whose places begin at `first`."""
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        if not (len(speeds.order) or len(battery.order)):
            self._road.extend(block, speeds.order, speeds.values[0])
            self._add_motor(block.of_kind(MotorReading))
            self._settle()
            return _Part()
        travelled = np.diff(speeds.stamps, prepend=self._speed.stamps[-1:]) / NANOSECONDS
        distances = np.abs(speeds.values[0][len(speeds.stamps) - len(travelled) :]) * travelled
        self._road.extend(block, speeds.order[len(speeds.order) - len(travelled) :], distances)
        self._battery.extend(battery)
        self._speed.extend(speeds.order, speeds.stamps, speeds.values[0])
        self._add_motor(block.of_kind(MotorReading))
        part = self._battery_part(battery, first)
        last_moment_ns = self._last_moment_ns
        if len(speeds.order):
            part = part._replace(moments=np.array((speeds.order + first, speeds.stamps)))
            if not self._intervals_alone:
                part = self._sampled(part, speeds, first)
            ready = self._intervals.intervals(speeds.order, speeds.stamps)
            self._ended += [(order + first, interval) for order, interval in ready]
        part = self._with_measured(part, speeds, first, last_moment_ns)
        self._settle()
        return part

    def _settle(self) -> None:
        """Take all as come before the next part."""
        needed_ns = self._intervals.needed_ns
        if self._unmeasured.size:
            needed_ns = min(needed_ns, int(self._unmeasured.stamp_ns[0]))
        for track in (self._speed, self._battery, self._motor, self._road):
            track.settle(needed_ns)
        self._intervals.settle()

    def _add_motor(self, rows: Rows) -> None:
        """Take readings of the motor's torque; before the first speed they tell nothing."""
        if not len(self._speed) or not len(rows.order):
            return
        index = self._speed.count(rows.order) - 1
        rows, index = rows.where(index >= 0), index[index >= 0]
        power = self._motor.powers(rows, self._speed.values[index])
        self._motor.power.extend(rows.order, rows.stamps, power)

    def _battery_part(self, rows: Rows, first: int) -> _Part:
        if not len(rows.order):
            return _Part()
        order = rows.order + first
        newest, gap = self._battery.newest_ns(rows.order), self._battery.gap_ns(rows.order)
        return _Part(
            told=np.array((order, rows.stamps)),
            powers=np.array((self._battery.told(rows), rows.values[3])),
            battery=np.array((order, newest, gap)),
        )

    def _sampled(self, part: _Part, speeds: Rows, first: int) -> _Part:
        """The part with its newest and its smoothed samples."""
        zero_ns = int(speeds.stamps[0])
        oldest_ns = min([zero_ns, *self._moments[:1].tolist()]) - LOOK_BACK_NS
        track = self._speed.since(oldest_ns, zero_ns)
        until = len(track.stamps) - len(speeds.order) + 1 + np.arange(len(speeds.order))
        stamps = speeds.stamps - zero_ns
        smoothed, impossible_orders = self._due(self._smoothed(track, speeds, until, zero_ns))
        if impossible_orders:
            self._drop("acceleration_impossible", np.array(impossible_orders) + first)
        learned = np.searchsorted(smoothed.order, speeds.order)
        acceleration = self._differentiator.accelerations(
            speeds.stamps,
            track.differences(stamps),
            (smoothed.stamps, smoothed.acceleration),
            learned,
        )
        slopes = track.slopes(stamps, until)
        possible = np.abs(acceleration) <= MAX_ACCELERATION
        if not possible.all():
            self._drop("acceleration_impossible", speeds.order[~possible] + first)
        newest = _Smoothed(speeds.order, speeds.stamps, speeds.values[0], acceleration, slopes)
        newest = _Smoothed(*(column[possible] for column in newest))
        count, both = len(newest.order), zip(newest, smoothed, strict=True)
        samples = self._samples(_Smoothed(*map(np.concatenate, both)))
        return part._replace(
            newest=samples.where(slice(count)),
            newest_order=newest.order + first,
            smoothed=samples.where(slice(count, None)),
            smoothed_order=smoothed.order + first,
        )

    def _smoothed(self, track: Speeds, speeds: Rows, until: np.ndarray, zero_ns: int) -> _Smoothed:
        """The moments that lie `smoothing_lag` back by now.

        Args:
            track: the speeds, with stamps since `zero_ns`.
            speeds: the new ones.
            until: how many of the track there are up to each of them, shape (n,).
            zero_ns: ns.
        """
        pending, count = len(self._moments), len(speeds.order)
        moments = np.concatenate((self._moments, speeds.stamps))
        passed = speeds.stamps.searchsorted(moments + self._lag_ns)
        passed[pending:] = np.maximum(passed[pending:], np.arange(count))
        passed = np.maximum.accumulate(passed)
        now = passed < count
        self._moments = moments[~now]
        moments, passed = moments[now], passed[now]
        if not len(moments):
            nothing = np.empty(0)
            return _Smoothed(moments, moments, nothing, nothing, np.empty((0, PROFILE)))
        at = moments - zero_ns, until[passed]
        speed, acceleration = track.smoothed(*at)
        order = speeds.order[passed]
        return _Smoothed(order, moments, speed, acceleration, track.slopes(*at))

    def _due(self, moved: _Smoothed) -> tuple[_Smoothed, list[int]]:
        """Those that are possible and far enough from the last one; places of the impossible."""
        known = ~np.isnan(moved.acceleration)
        possible = np.abs(moved.acceleration) <= MAX_ACCELERATION
        possible &= np.abs(moved.speed) <= MAX_SPEED
        chosen: list[int] = []
        impossible_orders: list[int] = []
        last = self._last_moment_ns
        rows = zip(moved.stamps.tolist(), known.tolist(), possible.tolist(), strict=True)
        for index, (stamp_ns, is_known, is_possible) in enumerate(rows):
            if stamp_ns - last < PERIOD_NS or not is_known:
                continue
            if not is_possible:
                impossible_orders.append(int(moved.order[index]))
                continue
            chosen.append(index)
            last = stamp_ns
        self._last_moment_ns = last
        return _Smoothed(*(column[chosen] for column in moved)), impossible_orders

    def _samples(self, moved: _Smoothed) -> Samples:
        by, stamps = moved.order, moved.stamps
        around = self._road.conditions(stamps, by)
        return Samples(
            stamp_ns=stamps,
            speed=moved.speed,
            acceleration=moved.acceleration,
            grade=self._road.grades(stamps, by),
            air_density=around.air_density,
            known_auxiliary=around.load,
            profile=profile(moved.slopes, moved.acceleration),
            head_wind=around.head_wind,
            celsius=around.celsius,
            doubted_load=around.doubted_load,
            motor_power=self._motor.at(stamps, by),
            motor_scaled=self._motor.scaled(by),
        )

    def _with_measured(self, part: _Part, speeds: Rows, first: int, last_moment_ns: int) -> _Part:
        """The part with the samples whose power its readings determine.

        Args:
            part: of the block.
            speeds: of it, with places within it.
            first: place of the part in the block.
            last_moment_ns: of the last smoothed sample before it.
        """
        waiting = self._unmeasured.and_then(part.smoothed)
        begin = self._smoothed_before
        self._smoothed_before += part.smoothed.size
        if not waiting.size:
            return part
        orders, stamps = part.smoothed_order - first, part.smoothed.stamp_ns
        after, came = self._battery.first_after(waiting.stamp_ns)
        place = np.searchsorted(stamps, after)
        passed = np.append(orders, LATER)[place]
        place = place + (np.append(stamps, NEVER)[place] == after)
        passed[last_moment_ns >= after] = BEFORE
        by = np.maximum(np.maximum(came, passed), self._settled_by(after, speeds))
        given, dropped, by = _in_turn(by, self._hopeless(waiting.stamp_ns, speeds))
        self._unmeasured = waiting.where(~(given | dropped))
        measured, by = waiting.where(given), np.maximum(by[given], 0)
        place = np.maximum(place[given], np.searchsorted(orders, by))
        place = np.maximum.accumulate(place)
        power = self._battery.at(measured.stamp_ns, by)
        known = ~np.isnan(power)
        return part._replace(
            measured=measured if known.all() else measured.where(known),
            measured_order=by[known] + first,
            measured_place=place[known] + begin,
            measured_power=power[known],
        )

    def _settled_by(self, after: np.ndarray, speeds: Rows) -> np.ndarray:
        """Places from which on nothing older than moments, ns, may come."""
        before_ns = self._speed.stamps[: len(self._speed) - len(speeds.order)][-1:]
        index = speeds.stamps.searchsorted(after + self._late_ns)
        by = np.append(speeds.order, LATER)[index]
        if len(before_ns):
            by[before_ns[0] >= after + self._late_ns] = BEFORE
        return by

    def _hopeless(self, stamps: np.ndarray, speeds: Rows) -> np.ndarray:
        """Places from which on no two readings to be joined can settle moments, ns."""
        never = np.full(len(stamps), LATER)
        if not len(speeds.order):
            return never
        longest = self._battery.gap_ns(speeds.order) + self._late_ns + self._lag_ns
        if speeds.stamps[-1] - stamps[0] <= longest.min():
            return never
        earliest = speeds.stamps.searchsorted(stamps + longest.min(), side="right")
        latest = speeds.stamps.searchsorted(stamps + longest.max(), side="right")
        orders = np.append(speeds.order, LATER)
        for index in np.flatnonzero(earliest < latest).tolist():
            some = slice(earliest[index], latest[index])
            too_old = speeds.stamps[some] - stamps[index] > longest[some]
            if too_old.any():
                latest[index] = earliest[index] + int(too_old.argmax())
        return np.asarray(orders[latest])


def _joined_parts(parts: Sequence[_Part]) -> _Part:
    """Parts of a block, one after another."""
    whole: list[Any] = []
    for column in zip(*(parts or [_Part()]), strict=True):
        if not isinstance(column[0], Samples):
            whole.append(np.concatenate(column, axis=-1))
        else:
            whole.append(joined_samples(column))
    return _Part(*whole)


def _in_turn(by: np.ndarray, hopeless: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which samples are given and which dropped, and the places: each waits for those before it.

    Args:
        by: places from which on each could be given, shape (n,).
        hopeless: places from which on each is dropped, shape (n,).
    """
    in_order, nothing = np.maximum.accumulate(by), np.zeros(len(by), dtype=bool)
    if (in_order <= hopeless).all():
        return in_order < LATER, nothing, in_order
    given, dropped, now, turn = nothing.copy(), nothing, BEFORE, BEFORE
    for index, (given_by, given_up) in enumerate(zip(by.tolist(), hopeless.tolist(), strict=True)):
        given_by, given_up = max(given_by, turn), max(given_up, now)
        if min(given_by, given_up) >= LATER:
            break
        given[index], dropped[index] = given_by <= given_up, given_by > given_up
        by[index] = now = min(given_by, given_up)
        turn = now + dropped[index]
    return given, dropped, by


def _row_of(reading: Reading) -> Rows:
    """One reading as rows."""
    return Block.of([reading]).rows[type(reading)]
