"""The newest speeds as they arrive, from which power is predicted without waiting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.arrived_power import NO_POWER, ArrivedPower, ArrivedPowerTrack
from evpinn_ros.core.signals.block import NO_ROWS
from evpinn_ros.core.signals.kinematics import (
    LOOK_BACK_NS,
    PROFILE,
    PROFILE_NS,
    TAP_PERIOD,
    TAPS,
    SpeedTrack,
)
from evpinn_ros.core.signals.power import NOMINAL_RATIO
from evpinn_ros.core.signals.readings import NANOSECONDS, MotorReading, Reading, SpeedReading
from evpinn_ros.core.signals.reorder import Arrived
from evpinn_ros.core.signals.track import NEVER


class NewestSpeeds(NamedTuple):
    """Speeds that are newer than all that came before them.

    Attributes:
        stamps: ns, increasing, shape (n,).
        known_ns: stamp up to which everything was learned before each, shape (n,).
        speed: m/s, shape (n,).
        differences: of speed before each (`kinematics.Speeds.differences`), shape (n, TAPS).
        slopes: around each (`kinematics.Speeds.slopes`), shape (n, PROFILE).
        motor_power: W, by the last torque that arrived, NaN where unknown, shape (n,).
        battery_ns: stamps of the newest battery reading before each, or `NEVER`, shape (n,).
        battery_power: power of that reading, W, shape (n,).
    """

    stamps: np.ndarray
    known_ns: np.ndarray
    speed: np.ndarray
    differences: np.ndarray
    slopes: np.ndarray
    motor_power: np.ndarray
    battery_ns: np.ndarray
    battery_power: np.ndarray

    def where(self, chosen: np.ndarray | slice) -> NewestSpeeds:
        """The rows of a mask or slice."""
        return NewestSpeeds._make(column[chosen] for column in self)

    def until(self, stamp_ns: int) -> tuple[NewestSpeeds, NewestSpeeds]:
        """Speeds whose `known_ns` is before a stamp, and the others."""
        count = int(self.known_ns.searchsorted(stamp_ns))
        return self.where(slice(count)), self.where(slice(count, None))


NO_SPEEDS = NewestSpeeds(
    np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty((0, TAPS)),
    np.empty((0, PROFILE)), np.empty(0), np.empty(0, np.int64), np.empty(0),
)  # fmt: skip


class Moved(NamedTuple):
    """Columns of `NewestSpeeds` of one speed."""

    differences: list[float]
    slopes: list[float]
    motor_power: float


MOST_LATEST = 2000  # speeds
GRID_NS = tuple(round(-TAP_PERIOD * tap * NANOSECONDS) for tap in range(TAPS + 1))
NO_ARRIVALS = Arrived(*NO_ROWS[SpeedReading], np.empty(0, np.int64))


class NewestTrack:
    """Follows speed in order of arrival, and the battery's power (`battery`)."""

    def __init__(self, max_gap: float, motor_ratio: float) -> None:
        """Start empty; max_gap as in `SignalTrack`, motor_ratio in rad per m, NaN if unknown."""
        self.battery = ArrivedPowerTrack()
        self._max_gap, self._speed = max_gap, SpeedTrack(max_gap)
        self._ratio = NOMINAL_RATIO if math.isnan(motor_ratio) else motor_ratio
        self._motor_ns, self._torque, self._turning = NEVER, math.nan, math.nan  # the last reading
        # The latest speeds; the last `_new` of them came one by one and are not in the track yet.
        self._latest: list[tuple[int, float]] = []
        self._new = 0

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest speed, None before the first."""
        if self._latest:
            return self._latest[-1][0]
        return self._speed.newest_ns if len(self._speed) else None

    def add_motor(self, reading: MotorReading) -> None:
        """Take a torque of the motor, in order of arrival."""
        self._motor_ns, self._torque, self._turning = (
            reading.stamp_ns, reading.torque, reading.speed,
        )  # fmt: skip

    def add_speed(self, stamp_ns: int, speed: float) -> Moved | None:
        """Add one speed; None if it is not the newest, or follows a gap: then call `add`.

        The scalar version of `add`.
        """
        if not self._latest and len(self._speed):
            track = self._speed
            self._latest = [*zip(track.stamps.tolist(), track.values.tolist(), strict=True)]
        latest = self._latest
        if not latest or not 0 < stamp_ns - latest[-1][0] <= self._max_gap * NANOSECONDS:
            return None
        latest.append((stamp_ns, speed))
        self._new += 1
        if len(latest) > MOST_LATEST and self._new > MOST_LATEST // 2:
            self._extend()
            latest = self._latest = latest[-MOST_LATEST // 2 :]
        grid = _interpolated(latest, GRID_NS)
        differences = [(after - before) / TAP_PERIOD for after, before in pairwise(grid)]
        first_ns, slopes = latest[0][0], []
        for begin_ns, end_ns in PROFILE_NS.tolist():
            if end_ns > 0 or stamp_ns + begin_ns < first_ns:
                slopes.append(math.nan)
                continue
            after, before = _interpolated(latest, (end_ns, begin_ns))
            slopes.append((after - before) * NANOSECONDS / (end_ns - begin_ns))
        power = self._torque * (
            self._ratio * speed if self._turning != self._turning else self._turning
        )
        fresh = stamp_ns - self._motor_ns <= self._max_gap * NANOSECONDS
        return Moved(differences, slopes, power if fresh else math.nan)

    def _extend(self) -> None:
        """Add the speeds that came one by one to the track."""
        if self._new:
            stamps, values = zip(*self._latest[-self._new :], strict=True)
            self._speed.extend(np.array(stamps, np.int64), np.array(values))
            self._speed.forget_before(int(self._speed.newest_ns) - LOOK_BACK_NS)
            self._new = 0

    def add(
        self, arrived: Mapping[type[Reading], Arrived], battery: ArrivedPower = NO_POWER
    ) -> NewestSpeeds:
        """Add readings in order of arrival; returns the speeds that are newer than all before."""
        self._extend()
        self._latest = []
        speeds, motor = arrived.get(SpeedReading, NO_ARRIVALS), arrived.get(MotorReading)
        before = np.maximum.accumulate(np.append(self._speed.newest_ns, speeds.stamps))[:-1]
        speeds = speeds.where(speeds.stamps > before)
        speed, newest = speeds.values[0], self.battery.before_each(speeds, battery)
        moved = *self._moved(speeds.stamps, speed), self._motor_power(motor, speeds)
        return NewestSpeeds(speeds.stamps, speeds.watermark_ns, speed, *moved, *newest)

    def _moved(self, stamps: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Differences and slopes of speed at moments; nothing is joined across a gap."""
        parts = [(NO_SPEEDS.differences, NO_SPEEDS.slopes)]
        while len(stamps):
            count = self._speed.until_gap(stamps)
            if not count:
                self._speed.restart((int(stamps[0]) - self._speed.newest_ns) / NANOSECONDS)
                continue
            moments, stamps = np.split(stamps, [count])
            values, speed = np.split(speed, [count])
            self._speed.extend(moments, values)
            zero_ns = int(moments[0])
            speeds = self._speed.since(zero_ns - LOOK_BACK_NS, zero_ns)
            until = np.arange(len(speeds.stamps) - count, len(speeds.stamps)) + 1
            moments = moments - zero_ns
            parts.append((speeds.differences(moments), speeds.slopes(moments, until)))
            self._speed.forget_before(int(self._speed.newest_ns) - LOOK_BACK_NS)
        differences, slopes = map(np.concatenate, zip(*parts, strict=True))
        return differences, slopes

    def _motor_power(self, motor: Arrived | None, speeds: Arrived) -> np.ndarray:
        """Power by the last torque that arrived before each speed, W; NaN where it is too old."""
        if motor is None and math.isnan(self._torque):
            return np.full(len(speeds.stamps), np.nan)
        motor_ns, values = np.array([self._motor_ns]), np.array([[self._torque], [self._turning]])
        places = np.empty(0)
        if motor is not None:
            motor_ns = np.append(motor_ns, motor.stamps)
            values = np.concatenate((values, motor.values), axis=1)
            self._motor_ns, places = int(motor_ns[-1]), motor.order
            self._torque, self._turning = values[:, -1].tolist()
        which = places.searchsorted(speeds.order)
        motor_ns, (torque, turning) = motor_ns[which], values[:, which]
        power = torque * np.where(np.isnan(turning), self._ratio * speeds.values[0], turning)
        return np.where(speeds.stamps - motor_ns <= self._max_gap * NANOSECONDS, power, np.nan)


def _interpolated(latest: Sequence[tuple[int, float]], after_ns: Sequence[int]) -> list[float]:
    """Speeds at moments after the last, ns, in falling order; constant before the first."""
    now_ns, place, speeds = latest[-1][0], len(latest) - 1, []
    for moment_ns in after_ns:
        moment_ns += now_ns
        while place > 0 and latest[place - 1][0] >= moment_ns:
            place -= 1
        end_ns, speed = latest[place]
        if end_ns > moment_ns and place > 0:
            begin_ns, before = latest[place - 1]
            speed += (moment_ns - end_ns) / (end_ns - begin_ns) * (speed - before)
        speeds.append(speed)
    return speeds
