"""Lag between the clocks of speed and battery, learned from a drive.

For each lag up to `MOST` steps, the power of a block of driving is regressed on the speed terms of
eq. 21, shifted by that lag. The lag with the largest explained share (the squared normalised
cross-correlation) is taken, as openpilot's `lagd` does for steering. Blocks are pooled, so no
parameter of the car is needed, and their scatter, by a jackknife, gives the 1-sigma.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import math
from typing import Annotated, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range
from evpinn_ros.core.signals.block import Block, Rows
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    SpeedReading,
    drawn_power,
)

STEP = 0.1  # s between lags, whose optimum a parabola refines, and of the grid of a block
STEPS_A_READING = 20  # grid steps between readings of a slow signal, whose lag may be longer
MOST = 50  # steps, the longest lag
BLOCK = 300  # steps of power in a block
SMOOTH = 0.5  # s over which both signals are averaged, or a step between readings if longer
TERMS = 4  # of speed: speeding up, slowing down, rolling, drag
ACCELERATION = 0.3  # m/s^2; more is speeding up or slowing down
DRIVEN = 0.1  # least share of such times in a block
LEAST_BLOCKS = 5  # blocks from which on a lag is learned
LEAST_POLLED = 10  # blocks from which on the lag of slow signals is known
BLOCKS_KEPT = 60
SHIFTS = np.arange(-MOST, MOST + 1)
SCALE = np.array([10.0, 10.0, 10.0, 1000.0])[:, None]  # of the terms, so that all are near 1
GAP, GAP_STEPS = 2.5, 6.0  # s, and usual steps, across which readings are joined
LONGEST = 60.0  # s, longest saved lag and longest pause within a drive

LEAST_READINGS = 6  # of a block
KNOWN, KNOWN_SHARE = 0.1, 0.1  # largest 1-sigma of a known lag: s, and share of `smooth`
SIGMAS = 3.0  # distance from zero at which a lag is applied
# Shortest lag that is applied, as a share of the time of averaging: 0.2 s at 10 Hz. Recorded cars
# gain nothing by a shorter one, and that of a polled log is not known better.
LEAST_SHARE = 0.4
LARGE = 0.5  # s; a longer lag is a fault of the source, and no parameter is valid until it is out
FURTHEST = -2.0, 5.0  # s, limits of the shift; a battery that comes later is a dropout


@dataclass(frozen=True, slots=True)
class Lag:
    """Time by which speed is stamped later than the battery, and its 1-sigma, s.

    `least` is the shortest lag that is applied, s; it is longer for a polled log.
    """

    seconds: Annotated[float, Range(-LONGEST, LONGEST)]
    sigma: Annotated[float, Range(0.0, LONGEST)]
    least: Annotated[float, Range(0.0, LONGEST)] = LEAST_SHARE * SMOOTH

    @property
    def matters(self) -> bool:
        """True if the lag is long enough to be applied, and surely not zero."""
        return abs(self.seconds) > max(self.least, SIGMAS * self.sigma)

    @property
    def large(self) -> bool:
        """True if the lag surely is a fault of the source of the stamps."""
        return abs(self.seconds) > max(LARGE, self.least) + SIGMAS * self.sigma

    def less(self, shift: float) -> Lag:
        """The lag that is left after a shift, s."""
        return replace(self, seconds=self.seconds - shift)


class LagBlock(NamedTuple):
    """Products over a block, about the means, at each of the n `SHIFTS`.

    Attributes:
        terms: of terms of speed, shape (n, TERMS, TERMS).
        cross: of terms with power, shape (n, TERMS).
        power: of power with itself, W^2.
    """

    terms: np.ndarray
    cross: np.ndarray
    power: float


def lag_block(
    speed: np.ndarray, power: np.ndarray, start: float, step: float = STEP, smooth: float = SMOOTH
) -> LagBlock | None:
    """Products of a block; None where the speed is steady.

    Args:
        speed: rows of time, s, and speed, m/s, of the block and `MOST` steps on both sides.
        power: rows of time, s, and power, W, of the block.
        start: begin of the block, s.
        step: of its grid, s.
        smooth: time over which both are averaged, s.
    """
    edges = start + step * np.arange(-MOST, BLOCK + MOST + 1)
    mean = _averaged(speed, edges, smooth)
    if np.mean(np.abs(np.diff(mean)) > ACCELERATION * step) < DRIVEN:
        return None
    kinetic = np.diff(mean**2) / (2.0 * step)
    middle = (mean[1:] + mean[:-1]) / 2.0
    terms = np.stack((np.maximum(kinetic, 0.0), np.minimum(kinetic, 0.0), middle, middle**3))
    drawn = _averaged(power, start + step * (np.arange(BLOCK) + 0.5), smooth + step)
    drawn = drawn - drawn.mean()
    shifted = np.lib.stride_tricks.sliding_window_view(terms / SCALE, BLOCK, axis=1)
    shifted = shifted.transpose(1, 0, 2)
    shifted = shifted - shifted.mean(axis=2, keepdims=True)
    return LagBlock(shifted @ shifted.transpose(0, 2, 1), shifted @ drawn, float(drawn @ drawn))


def lag_of(blocks: Sequence[LagBlock], step: float = STEP) -> Lag | None:
    """The lag of blocks of one grid together; None if they are few or show none."""
    count = len(blocks)
    if count < LEAST_BLOCKS:
        return None
    parts = [np.array(column) for column in zip(*blocks, strict=True)]
    whole = [part.sum(axis=0) for part in parts]
    (best,) = _optima(*(total[None] for total in whole))
    without = _optima(*(total - part for total, part in zip(whole, parts, strict=True)))
    sigma = step * math.sqrt((count - 1) * float(np.var(without)))
    if not math.isfinite(best + sigma):
        return None
    return Lag(step * float(best), min(sigma, LONGEST))


def _optima(terms: np.ndarray, cross: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Shifts of the largest explained share, shape (m,); NaN where it is at an end of `SHIFTS`."""
    ridge = 1e-6 * np.trace(terms, axis1=2, axis2=3)[..., None, None] * np.eye(TERMS)
    fitted = np.linalg.solve(terms + ridge, cross[..., None])[..., 0]
    explained = (fitted * cross).sum(axis=2) / np.maximum(power, 1e-9)[:, None]
    best = explained.argmax(axis=1)
    place = np.clip(best, 1, len(SHIFTS) - 2)
    before, at, after = (explained[np.arange(len(place)), place + side] for side in (-1, 0, 1))
    curved = before - 2.0 * at + after
    offset = np.divide(before - after, 2.0 * curved, out=np.zeros_like(at), where=curved < 0.0)
    return np.where(best == place, SHIFTS[place] + offset, np.nan)


def _averaged(signal: np.ndarray, moments: np.ndarray, width: float) -> np.ndarray:
    """Means of a signal, linear between its rows, over a `width`, s, around moments."""
    time, value = signal.T
    integral = np.append(0.0, np.cumsum(np.diff(time) * (value[1:] + value[:-1]) / 2.0))
    after, before = (
        np.interp(moments + side * width / 2.0, time, integral) for side in (1.0, -1.0)
    )
    return np.asarray((after - before) / width)


class _Signal:
    """The latest readings of a signal: s since a moment, and values."""

    def __init__(self) -> None:
        self.time, self.values = np.empty(0), np.empty(0)

    def extend(self, seconds: np.ndarray, values: np.ndarray) -> None:
        """Add the readings that are not NaN."""
        there = ~np.isnan(values)
        self.time = np.concatenate((self.time, seconds[there]))
        self.values = np.concatenate((self.values, values[there]))

    def forget_before(self, moment: float) -> None:
        """Forget all readings before a moment but the last."""
        first = max(0, int(self.time.searchsorted(moment)) - 1)
        self.time, self.values = self.time[first:], self.values[first:]

    def period(self, end: float) -> float:
        """Usual step of the readings up to a moment, s; NaN while few."""
        time = self.time[: self.time.searchsorted(end, side="right")]
        return math.nan if len(time) < LEAST_READINGS else float(np.median(np.diff(time)))

    def rows(self, begin: float, end: float) -> np.ndarray | None:
        """Rows of time and value around a span; None where there is a gap."""
        first = int(self.time.searchsorted(begin, side="right")) - 1
        last = int(self.time.searchsorted(end)) + 1
        if first < 0 or last > len(self.time):
            return None
        if np.diff(self.time[first:last]).max() > max(GAP, GAP_STEPS * self.period(end)):
            return None
        return np.column_stack((self.time, self.values))[first:last]


class LagLearner:
    """Lag of speed to battery, from readings of a drive in order of stamps.

    Attributes:
        lag: present estimate, None before the first.
    """

    def __init__(self) -> None:
        """Start without a lag."""
        self.lag: Lag | None = None
        self._step, self._smooth = STEP, SMOOTH
        self._blocks: deque[LagBlock] = deque(maxlen=BLOCKS_KEPT)
        self.begin_stretch()

    def begin_stretch(self) -> None:
        """Join nothing to the readings before; what was learned is kept."""
        self._speed, self._voltage, self._current = _Signal(), _Signal(), _Signal()
        self._new: list[tuple[Rows, Rows]] = []  # speeds and battery since the last block
        self._zero_ns: int | None = None
        self._start = 0.0  # s, first moment of speed that the next block needs

    @property
    def known(self) -> bool:
        """True if the lag is known well enough to rely on."""
        if self.lag is None or (self._smooth > SMOOTH and len(self._blocks) < LEAST_POLLED):
            return False
        return self.lag.sigma <= max(KNOWN, KNOWN_SHARE * self._smooth)

    def extend(self, speeds: Rows, battery: Rows) -> Iterator[int]:
        """Take readings; yields the stamp of each speed that completes a block."""
        if self._zero_ns is None:
            if not len(speeds.stamps):
                return
            self._zero_ns = int(speeds.stamps[0])
        self._new.append((speeds, battery))
        newest_ns = speeds.stamps[-1:]
        if not len(newest_ns) or (newest_ns[0] - self._zero_ns) / NANOSECONDS < self._due:
            return
        signals = (self._speed,), (self._voltage, self._current)
        for named, parts in zip(signals, zip(*self._new, strict=True), strict=True):
            stamps = np.concatenate([rows.stamps for rows in parts])
            columns = np.concatenate([rows.values for rows in parts], axis=1)
            for signal, values in zip(named, columns, strict=False):
                signal.extend((stamps - self._zero_ns) / NANOSECONDS, values)
        self._new.clear()
        while len(self._speed.time) and self._speed.time[-1] >= self._due:
            due = float(self._speed.time[self._speed.time.searchsorted(self._due)])
            if due > self._due + LONGEST:  # the car was parked
                self._start = due
            else:
                self._end_block()
                yield self._zero_ns + round(due * NANOSECONDS)
            for signal in (self._speed, self._voltage, self._current):
                signal.forget_before(self._start)

    @property
    def _due(self) -> float:
        """Moment from which on the next block is complete, s."""
        reach = MOST * self._step + self._smooth
        return self._start + BLOCK * self._step + 2.0 * reach + GAP

    def _end_block(self) -> None:
        period = max(self._speed.period(self._due), self._current.period(self._due))
        smooth, begin = max(SMOOTH, period), self._start
        # By the step before it may change, so that each block ends later than the last.
        self._start += BLOCK * self._step
        if math.isfinite(period) and not 0.5 < smooth / self._smooth < 2.0:
            # The rate changed, or that of a polled log is known only now: begin anew.
            self._smooth, self._step = smooth, max(STEP, round(period / STEPS_A_READING, 2))
            self.lag = None
            self._blocks.clear()
            return
        block = self._block(begin) if math.isfinite(period) else None
        if block is not None:
            self._blocks.append(block)
            lag = lag_of(self._blocks, self._step)
            if lag is not None:
                self.lag = replace(lag, least=LEAST_SHARE * self._smooth)

    def _block(self, begin: float) -> LagBlock | None:
        """The complete block from a moment on; None where it has gaps or steady speed."""
        smooth, length = self._smooth, BLOCK * self._step
        start = begin + MOST * self._step + smooth
        end = start + length
        speed = self._speed.rows(begin, end + start - begin)
        current = self._current.rows(start - smooth, end + smooth)
        voltage = self._voltage.rows(start - smooth, end + smooth)
        if speed is None or current is None or voltage is None:
            return None
        volts = np.interp(current[:, 0], voltage[:, 0], voltage[:, 1])
        power = np.column_stack((current[:, 0], drawn_power(volts, current[:, 1])))
        return lag_block(speed, power, start, self._step, smooth)


class Alignment(NamedTuple):
    """Alignment of the clocks of speed and battery.

    Attributes:
        lag: of this drive or of one before, None while unknown.
        doubtful: whether a large lag surely remains after the shift.
    """

    lag: Lag | None
    doubtful: bool


class Aligner:
    """Shifts the battery's stamps to the clock of speed, by the lag that earlier drives showed.

    The lag of a drive counts from the next drive on: so a drive has one clock.

    Attributes:
        shift_ns: added to the stamps of the battery.
    """

    def __init__(self, saved: Lag | None = None) -> None:
        """Start with the lag that earlier drives showed."""
        self._learner, self._before = LagLearner(), saved
        seconds = 0.0 if saved is None or not saved.matters else saved.seconds
        self.shift_ns = round(min(max(seconds, FURTHEST[0]), FURTHEST[1]) * NANOSECONDS)

    def begin_stretch(self) -> None:
        """Join nothing to the readings before; what was learned is kept."""
        self._learner.begin_stretch()

    @property
    def saved(self) -> Lag | None:
        """The known lag of this drive, else of earlier ones."""
        return self._learner.lag if self._learner.known else self._before

    @property
    def now(self) -> Alignment:
        """The present alignment."""
        of_drive = self._learner.lag or self._before
        left = None if of_drive is None else of_drive.less(self.shift_ns / NANOSECONDS)
        return Alignment(self.saved or self._learner.lag, left is not None and left.large)

    def shifted(self, block: Block) -> Block:
        """The block with battery stamps by the clock of speed."""
        rows = block.of_kind(BatteryReading)
        if not (self.shift_ns and len(rows.stamps)):
            return block
        return block.with_rows(BatteryReading, rows._replace(stamps=rows.stamps + self.shift_ns))

    def learn(self, block: Block) -> Iterator[tuple[int, Alignment]]:
        """Learn from shifted readings; yields (stamp, alignment from then on) of each block."""
        battery = block.of_kind(BatteryReading)
        battery = battery._replace(stamps=battery.stamps - self.shift_ns)
        for stamp_ns in self._learner.extend(block.of_kind(SpeedReading), battery):
            yield stamp_ns, self.now
