"""Lag between the clocks of speed and battery, learned from a drive.

For each lag up to `MOST` steps, the power of a block of driving is regressed on the speed terms of
eq. 21, shifted by that lag. The lag with the largest explained share (the squared normalised
cross-correlation) is taken, as openpilot's `lagd` does for steering. Blocks are pooled, so no
parameter of the car is needed, and their scatter, by a jackknife, gives the 1-sigma.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
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
STEPS_A_READING = 20  # of a signal that is polled slowly, whose lag may be longer
MOST = 50  # steps, the longest lag that is looked for
BLOCK = 300  # steps of power in a block
SMOOTH = 0.5  # s over which both are averaged alike, or one step between readings of a slow one
TERMS = 4  # of speed: speeding up, slowing down, rolling, drag
ACCELERATION = 0.3  # m/s^2, that counts as speeding up or slowing down
DRIVEN = 0.1  # least share of such times in a block
LEAST_BLOCKS = 5  # from which a lag is learned,
LEAST_POLLED = 10  # and from which it is known where signals are slow
BLOCKS_KEPT = 60
SHIFTS = np.arange(-MOST, MOST + 1)
SCALE = np.array([10.0, 10.0, 10.0, 1000.0])[:, None]  # of the terms, so that all are near 1
GAP, GAP_STEPS = 2.5, 6.0  # s, and usual steps, across which readings are joined
LONGEST = 60.0  # s, of a saved lag

LEAST_READINGS = 6  # of a block
KNOWN, KNOWN_SHARE = 0.1, 0.1  # s, and of `smooth`: 1-sigma of a lag that is known
SIGMAS = 3.0  # that a lag is away from zero where it is applied
# Of the time that both are averaged over, shortest lag that is applied: 0.2 s at 10 Hz. Recorded
# cars whose lag is below have nothing to gain, and that of a polled log is not known better.
LEAST_SHARE = 0.4
LARGE = 0.5  # s, beyond which the lag is a fault to be mended, and parameters wait for it
FURTHEST = -2.0, 5.0  # s: a battery that comes later than that is taken for a dropout
SLEW = 0.005  # s of shift in a second of stamps: energies stay right to half a percent


@dataclass(frozen=True, slots=True)
class Lag:
    """Time by which speed is stamped later than the battery, and its 1-sigma, s.

    `least` is the shortest lag that is applied, s: of a polled log it is longer.
    """

    seconds: Annotated[float, Range(-LONGEST, LONGEST)]
    sigma: Annotated[float, Range(0.0, LONGEST)]
    least: Annotated[float, Range(0.0, LONGEST)] = LEAST_SHARE * SMOOTH

    @property
    def matters(self) -> bool:
        """True if it is long enough to be applied, and surely not zero."""
        return abs(self.seconds) > max(self.least, SIGMAS * self.sigma)

    @property
    def large(self) -> bool:
        """True if it surely is a fault, to be corrected where the stamps are made."""
        return abs(self.seconds) > max(LARGE, self.least) + SIGMAS * self.sigma

    def less(self, shift: float) -> Lag:
        """What a shift, s, leaves of it."""
        return replace(self, seconds=self.seconds - shift)


class LagBlock(NamedTuple):
    """Sums over a block at each of `SHIFTS`, about their means.

    Terms by terms, shape (n, TERMS, TERMS), terms by power, (n, TERMS), and power by itself.
    """

    terms: np.ndarray
    cross: np.ndarray
    power: float


def lag_block(
    speed: np.ndarray, power: np.ndarray, start: float, step: float = STEP, smooth: float = SMOOTH
) -> LagBlock | None:
    """Sums of the block that begins at a moment, s; None where the car does not speed up or slow.

    Args:
        speed: rows of time, s, and speed, m/s, from `MOST` steps before it to as many after.
        power: rows of time, s, and power, W, of the block.
        start: begin of the block.
        step: of its grid, s.
        smooth: s, over which both are averaged alike.
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
    """The lag that blocks of a grid show together; None while they are few or show none."""
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
    """Shifts at the greatest explained share of m sums; NaN where it is at the end of `SHIFTS`."""
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
    """Means of a signal, linear between its rows, over a width, s, around moments."""
    time, value = signal.T
    integral = np.append(0.0, np.cumsum(np.diff(time) * (value[1:] + value[:-1]) / 2.0))
    after, before = (
        np.interp(moments + side * width / 2.0, time, integral) for side in (1.0, -1.0)
    )
    return np.asarray((after - before) / width)


class _Signal:
    """The latest readings of a signal: s since a moment, and values."""

    def __init__(self) -> None:
        self.time: list[float] = []
        self.values: list[float] = []

    def extend(self, seconds: np.ndarray, values: np.ndarray) -> None:
        """Take readings but those that are NaN."""
        there = ~np.isnan(values)
        self.time += seconds[there].tolist()
        self.values += values[there].tolist()

    def forget(self, before: float) -> None:
        """Forget all readings before a moment but the last."""
        last = max(0, int(np.searchsorted(self.time, before)) - 1)
        del self.time[:last], self.values[:last]

    @property
    def period(self) -> float:
        """Usual step, s; NaN of few readings."""
        few = len(self.time) < LEAST_READINGS
        return math.nan if few else float(np.median(np.diff(np.unique(self.time))))

    def rows(self, begin: float, end: float) -> np.ndarray | None:
        """Rows of time and value around a span; None where there is a gap."""
        time, order = np.unique(self.time, return_index=True)
        first = np.searchsorted(time, begin, side="right") - 1
        last = np.searchsorted(time, end) + 1
        if first < 0 or last > len(time):
            return None
        if np.diff(time[first:last]).max() > max(GAP, GAP_STEPS * self.period):
            return None
        return np.column_stack((time, np.array(self.values)[order]))[first:last]


class LagLearner:
    """Lag of speed to battery, from readings of a drive in the order they come.

    Attributes:
        lag: as it is now, None before the first.
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
        self._zero_ns: int | None = None
        self._start = 0.0  # s, from which the next block needs speed
        self._due = 0.0  # s, when it is complete

    @property
    def gap(self) -> float:
        """Seconds without the battery that are a dropout."""
        return max(GAP, GAP_STEPS * self._smooth)

    @property
    def known(self) -> bool:
        """True if the lag is known well enough to rely on."""
        if self.lag is None or (self._smooth > SMOOTH and len(self._blocks) < LEAST_POLLED):
            return False
        return self.lag.sigma <= max(KNOWN, KNOWN_SHARE * self._smooth)

    def is_due(self, stamps: np.ndarray) -> np.ndarray:
        """Whether speeds complete a block, or begin the first, by their stamps, ns."""
        return np.asarray((self._zero_ns is None) | (self._seconds(stamps) >= self._due))

    def extend(self, speeds: Rows, battery: Rows) -> None:
        """Take readings of which no speed is due."""
        if self._zero_ns is None:
            return
        seconds = self._seconds(battery.stamps)
        driven = seconds < self._due + LONGEST  # else the car is parked
        self._voltage.extend(seconds[driven], battery.values[0][driven])
        self._current.extend(seconds[driven], battery.values[1][driven])
        self._speed.extend(self._seconds(speeds.stamps), speeds.values[0])

    def add_due(self, stamp_ns: int, speed: float) -> None:
        """Take a speed that is due."""
        stamps, speeds = np.array([stamp_ns]), np.array([speed])
        if self._zero_ns is not None and self._seconds(stamps)[0] > self._due + LONGEST:
            self.begin_stretch()
        if self._zero_ns is None:
            self._zero_ns = stamp_ns
            self._begin_block(0.0)
        seconds = self._seconds(stamps)
        self._speed.extend(seconds, speeds)
        if seconds[0] >= self._due:
            self._end_block()

    def _seconds(self, stamps: np.ndarray) -> np.ndarray:
        return np.asarray((stamps - (self._zero_ns or 0)) / NANOSECONDS)

    def _begin_block(self, start: float) -> None:
        self._start = start
        reach = MOST * self._step + self._smooth
        self._due = start + BLOCK * self._step + 2.0 * reach + GAP
        for signal in (self._speed, self._voltage, self._current):
            signal.forget(start)

    def _end_block(self) -> None:
        period = max(self._speed.period, self._current.period)
        smooth = max(SMOOTH, period)
        if math.isfinite(period) and not 0.5 < smooth / self._smooth < 2.0:
            # Signals of another rate, as those of a polled log are known to be now.
            self._smooth, self._step = smooth, max(STEP, round(period / STEPS_A_READING, 2))
            self.lag = None
            self._blocks.clear()
            self._begin_block(self._start)
            return
        block = self._block() if math.isfinite(period) else None
        self._begin_block(self._start + BLOCK * self._step)
        if block is not None:
            self._blocks.append(block)
            lag = lag_of(self._blocks, self._step)
            if lag is not None:
                self.lag = replace(lag, least=LEAST_SHARE * self._smooth)

    def _block(self) -> LagBlock | None:
        """The block that is complete; None where it has gaps or tells nothing."""
        smooth, length = self._smooth, BLOCK * self._step
        start = self._start + MOST * self._step + smooth
        end = start + length
        speed = self._speed.rows(self._start, end + start - self._start)
        current = self._current.rows(start - smooth, end + smooth)
        voltage = self._voltage.rows(start - smooth, end + smooth)
        if speed is None or current is None or voltage is None:
            return None
        volts = np.interp(current[:, 0], voltage[:, 0], voltage[:, 1])
        power = np.column_stack((current[:, 0], drawn_power(volts, current[:, 1])))
        return lag_block(speed, power, start, self._step, smooth)


class AlignedBy(NamedTuple):
    """An alignment at one moment: its lag and shift, and whether a large lag is left."""

    lag: Lag | None
    shift_ns: int
    doubtful: bool

    @classmethod
    def of(cls, lag: Lag | None, of_drive: Lag | None, shift_ns: int) -> AlignedBy:
        """By the lag that is known, and the one that this drive shows or began with."""
        left = None if of_drive is None else of_drive.less(shift_ns / NANOSECONDS)
        return cls(lag, shift_ns, left is not None and left.large)


class Aligned(NamedTuple):
    """Readings by the clock of speed.

    Attributes:
        block: of them.
        lag: as far as it is known.
        of_drive: that this drive shows, or began with.
        before_ns: shift before the first battery reading, ns.
        shifts: of each battery reading, ns, shape (n,).
        jumps: whether the shift jumps behind them.
    """

    block: Block
    lag: Lag | None
    of_drive: Lag | None
    before_ns: int
    shifts: np.ndarray
    jumps: bool

    def shift_ns(self, places: np.ndarray) -> np.ndarray:
        """Shift at places of the block, ns."""
        orders = self.block.of_kind(BatteryReading).order
        index = np.searchsorted(orders, places, side="right")
        return np.concatenate(([self.before_ns], self.shifts))[index]

    def by(self, place: int) -> AlignedBy:
        """The alignment at a place."""
        return AlignedBy.of(self.lag, self.of_drive, int(self.shift_ns(np.array(place))))


class Alignment:
    """Shift of the battery's stamps to the clock of speed, by the lag that is learned.

    It moves slowly, and never within a dropout. It jumps once at most, when the lag of a drive
    becomes known and the shift is far from it; the drive so far must then be learned anew.

    Attributes:
        shift_ns: added to the stamps of the battery.
    """

    def __init__(self, saved: Lag | None = None) -> None:
        """Start with the lag that earlier drives showed."""
        self._learner, self._saved = LagLearner(), saved
        self._battery_ns: int | None = None
        self._jumped = False  # at the battery reading that comes next, which is taken already
        self._settled = False
        self.shift_ns = int(self._target * NANOSECONDS)

    def begin_stretch(self) -> None:
        """Join nothing to the readings before; what was learned is kept."""
        self._learner.begin_stretch()
        self._battery_ns, self._jumped = None, False

    def next_drive(self) -> Alignment:
        """The alignment of another drive, perhaps recorded by another logger."""
        return Alignment(self.saved)

    @property
    def saved(self) -> Lag | None:
        """The lag that is known, of this drive or of one before."""
        return self._learner.lag if self._learner.known else self._saved

    @property
    def lag(self) -> Lag | None:
        """The lag as far as it is known."""
        return self.saved or self._learner.lag

    @property
    def now(self) -> AlignedBy:
        """The lag, the shift, and whether the lag is surely large and not taken out."""
        return AlignedBy.of(self.lag, self._learner.lag or self._saved, self.shift_ns)

    @property
    def _target(self) -> float:
        """Shift that is right by what is known, s."""
        lag = self.saved
        if lag is None or not lag.matters:
            return 0.0
        return min(max(lag.seconds, FURTHEST[0]), FURTHEST[1])

    def add_part(self, block: Block) -> Aligned:
        """Take the first readings of a block: until a block of the lag is complete, or it jumps.

        Where the shift jumps, what was before shall be learned anew.
        """
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        if not (len(speeds.order) or len(battery.order)):
            return self.aligned(block)
        if len(speeds.order) and speeds.order[0] == 0 and self._learner.is_due(speeds.stamps[0]):
            self._learner.add_due(int(speeds.stamps[0]), float(speeds.values[0, 0]))
            speeds = speeds.where(slice(1, None))
        due = self._learner.is_due(speeds.stamps)
        end = int(speeds.order[due.argmax()]) if due.any() else block.length
        before_ns, known = self.shift_ns, self._jumped
        battery = battery.where(battery.order < end)
        shifts, self._jumped = self._moved(battery.stamps)
        taken = battery.where(slice(int(known), len(shifts)))
        if self._jumped:
            end = int(taken.order[-1])
        self._learner.extend(speeds.where(speeds.order < end), taken)
        part = block.part(0, end)
        shifts = shifts[: len(part.of_kind(BatteryReading).order)]
        lags = self.lag, self._learner.lag or self._saved
        return Aligned(_shifted(part, shifts), *lags, before_ns, shifts, self._jumped)

    def _moved(self, stamps: np.ndarray) -> tuple[np.ndarray, bool]:
        """Shifts after battery readings, ns, up to the one at which it jumps; if it does."""
        shifts = np.full(len(stamps), self.shift_ns)
        if not len(stamps):
            return shifts, False
        before_ns, self._battery_ns = self._battery_ns, int(stamps[-1])
        away = self._target - self.shift_ns / NANOSECONDS
        is_right = not round(away * NANOSECONDS)
        if is_right and (self._settled or not self._learner.known):
            return shifts, False
        passed = np.diff(stamps, prepend=stamps[0] if before_ns is None else before_ns)
        passed = passed / NANOSECONDS
        joined = np.flatnonzero((passed > 0.0) & (passed <= self._learner.gap))
        if is_right:
            self._settled |= self._learner.known and len(joined) > 0
            return shifts, False
        for index in joined.tolist():
            jumped = self._move(float(passed[index]))
            shifts[index:] = self.shift_ns
            if jumped:
                self._battery_ns = int(stamps[index])
                return shifts[: index + 1], True
        return shifts, False

    def _move(self, passed: float) -> bool:
        """Let the shift follow the lag for some seconds; True if it jumped."""
        away = self._target - self.shift_ns / NANOSECONDS
        first, self._settled = not self._settled, self._settled or self._learner.known
        jumps = first and self._settled and abs(away) > LEAST_SHARE * SMOOTH
        step = away if jumps else min(max(away, -SLEW * passed), SLEW * passed)
        self.shift_ns += round(step * NANOSECONDS)
        return jumps

    @property
    def settled(self) -> bool:
        """True once the lag of this drive is known: nothing will be learned anew."""
        return self._settled

    def aligned(self, block: Block) -> Aligned:
        """Readings by the clock of speed, with the shift that is right now."""
        shifts = np.full(len(block.of_kind(BatteryReading).order), self.shift_ns)
        lags = self.lag, self._learner.lag or self._saved
        return Aligned(_shifted(block, shifts), *lags, self.shift_ns, shifts, jumps=False)


def _shifted(block: Block, shifts: np.ndarray) -> Block:
    """Readings with the battery's stamps later by shifts, ns."""
    if not shifts.any():
        return block
    rows = block.of_kind(BatteryReading)
    return block.with_rows(BatteryReading, rows._replace(stamps=rows.stamps + shifts))
