"""Energy consumed since reset: measured, predicted, integrated by the Runge-Kutta network.

The measured integral stops during a battery dropout; the predicted ones go on from speed alone and
bridge it. If speed drops out too, or the process was away for minutes, the energy of that time is
unknown and not interpolated: the meter counts the time, and adds the energy that may have been
taken to sigma (`energy.hole`).

Predictions and measurements come in blocks, in order of stamps; how they are cut changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import starmap
import math
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.energy.dropout import LEAST_DROPOUT, Bridge, Dropout
from evpinn_ros.core.energy.hole import RecentPower, away_since, recent_powers, taken_variance
from evpinn_ros.core.energy.plausible import ROUNDING, Joules, Seconds, Sigma
from evpinn_ros.core.energy.quadrature import (
    MAX_GAP,
    EnergyIntegral,
    IntegralCourse,
    SavedIntegral,
    counted,
)
from evpinn_ros.core.energy.rknn import STEP_LIMIT, Rknn
from evpinn_ros.core.energy.uncertainty import LASTING_SHARE, CorrelatedError, sampled
from evpinn_ros.core.estimation.outputs import PowerRows
from evpinn_ros.core.signals.admission import MAX_POWER
from evpinn_ros.core.signals.readings import NANOSECONDS

BATCH = 4000  # steps computed at once by the network
LAST_NS = np.iinfo(np.int64).max
NO_STAMPS, UNKNOWN = np.zeros(1, np.int64), np.array([math.nan])


class Integrator(str, Enum):
    """Integrator of the predicted power that stands in for the battery."""

    RKNN = "rknn"
    TRAPEZOID = "trapezoid"


Number: TypeAlias = Any  # or, of n states, an array of shape (n,)


class Flow(NamedTuple):
    """Energy since reset, J, present power, W, and 1-sigma of the energy, J; NaN if unknown."""

    energy: Number
    power: Number
    sigma: Number


@dataclass(frozen=True, slots=True)
class EnergyState:
    """State of the meter at one moment, or at n moments. Drawn energy is positive.

    Attributes:
        stamp_ns: newest stamp counted, 0 before the first.
        measured: integral of measured power, sigma from the sensor's; power NaN while silent.
        predicted: quadrature of predicted power; its sigma (`energy.uncertainty`) includes the
            lasting error of dropouts.
        rknn: the Runge-Kutta network on the same power; its power is the last step's mean.
        regenerated: as positive J and W; of measured power, in dropouts of predicted power. Its
            sigma is that of the net energy.
        consumed: net energy, J: measured, in dropouts predicted. At their borders one sample may
            count twice or not at all.
        consumed_sigma: its 1-sigma, J.
        gaps: steps too long to integrate, of measured and predicted power together.
        dropped: samples dropped (out of order or not finite), of both together.
        unmeasured_s: time since reset without measured power, s.
        unknown_s: the part of it without predicted power either, s; its energy is not counted,
            but is in `consumed_sigma`.
        measuring: False during a battery dropout.
    """

    stamp_ns: Number
    measured: Flow
    predicted: Flow
    rknn: Flow
    regenerated: Flow
    consumed: Number
    consumed_sigma: Number
    gaps: Number
    dropped: Number
    unmeasured_s: Number
    unknown_s: Number
    measuring: Number

    def rows(self) -> Iterator[EnergyState]:
        """The n states one by one."""
        fields = [getattr(self, name) for name in self.__slots__]
        columns: list[Iterable[Any]] = [
            map(Flow, *[column.tolist() for column in values])
            if isinstance(values, Flow)
            else values.tolist()
            for values in fields
        ]
        return starmap(EnergyState, zip(*columns, strict=True))


NO_ROWS = np.empty(0)
NO_STATES = EnergyState(NO_ROWS, *(Flow(NO_ROWS, NO_ROWS, NO_ROWS),) * 4, *(NO_ROWS,) * 7)


class Counts(NamedTuple):
    """Numbers of predictions and measurements of a block up to k moments, shape (k,) each."""

    predicted: np.ndarray
    measured: np.ndarray


@dataclass(frozen=True, slots=True)
class SavedMeter:
    """Integrals of a meter, their 1-sigma, J, and the present dropout; see `EnergyState`.

    Attributes:
        until_ns: stamp up to which energy is counted, 0 if later power does not continue it.
        recent: power measured in the last minutes.
    """

    measured: SavedIntegral = field(default_factory=SavedIntegral)
    predicted: SavedIntegral = field(default_factory=SavedIntegral)
    rknn: Joules = 0.0
    measured_sigma: Sigma = 0.0
    predicted_sigma: Sigma = 0.0
    bridged: Bridge = field(default_factory=Bridge)
    bridged_sigma: Sigma = 0.0
    lasting_sigma: Sigma = 0.0
    unmeasured_s: Seconds = 0.0
    until_ns: Annotated[int, Range(0, LAST_NS)] = 0
    recent: RecentPower = field(default_factory=RecentPower)

    def __post_init__(self) -> None:
        """Refuse impossible energies."""
        self.measured.refuse_above(MAX_POWER)
        self.predicted.refuse_above(MAX_POWER)
        if abs(self.rknn) > MAX_POWER * self.predicted.covered_s * ROUNDING:
            raise ValueError(f"rknn is more than {MAX_POWER:g} W all the time")


class PowerCourse(NamedTuple):
    """Totals of one stream of power along a block of n samples.

    Attributes:
        stamp_ns: of the samples, shape (n,).
        integral: of their power.
        newest_ns: the newest stamp after 0 to n samples, shape (n + 1,) like all below.
        power: of the last sample used, W.
        variance: of the energy, J^2.
    """

    stamp_ns: np.ndarray
    integral: IntegralCourse
    newest_ns: np.ndarray
    power: np.ndarray
    variance: np.ndarray

    def then(
        self, stamp_ns: np.ndarray, integral: IntegralCourse, variance: np.ndarray
    ) -> PowerCourse:
        """The course of the block that follows."""
        newest_ns = np.maximum.accumulate(np.concatenate((self.newest_ns[-1:], stamp_ns)))
        power = np.concatenate((self.power[-1:], integral.end))[integral.used]
        return PowerCourse(stamp_ns, integral, newest_ns, power, variance)

    def net(self, counts: np.ndarray) -> np.ndarray:
        """Drawn less regenerated energy after k counts of samples, J, shape (k,)."""
        used = self.integral.used[counts]
        net: np.ndarray = self.integral.drawn[used] - self.integral.regenerated[used]
        return net


@dataclass(frozen=True, slots=True)
class MeterCourse:
    """Totals of a meter along a block of n predictions and m measurements.

    The rows of arrays of shape (n + 1, ...) are after 0 to n predictions, those of (m + 1, ...)
    after 0 to m measurements; `Counts` index both.

    Attributes:
        predicted: course of predicted power, integrated by trapezoids.
        measured: course of measured power.
        rknn: predicted energy by the network, J, and its power, W, shape (n + 1, 2).
        totals: of predictions: columns of `Bridge` and the variance, shape (n + 1, 5).
        estimated: energy of a dropout by the estimator, and its 1-sigma, J, shape (n + 1, 2).
        first_ns: stamp of the first prediction, 0 before any, shape (n + 1,).
        used_ns: stamp of the last prediction that was used, shape (1,).
        since_ns: stamp of the last battery reading, 0 before any, shape (m + 1,).
        heard: whether there was a battery reading, shape (m + 1,).
        anchors: `totals` at the last battery reading, shape (m + 1, 5).
        recent: columns of `RecentPower` of measured power, shape (m + 1, 3).
        dropouts: sums over ended dropouts: `Bridge`, variance of energy, its lasting part, and
            seconds, shape (m + 1, 7).
        ended: dropouts that ended in this block.
        dropped: samples dropped before the block.
    """

    predicted: PowerCourse
    measured: PowerCourse
    rknn: np.ndarray
    totals: np.ndarray
    estimated: np.ndarray
    first_ns: np.ndarray
    used_ns: np.ndarray
    since_ns: np.ndarray
    heard: np.ndarray
    anchors: np.ndarray
    recent: np.ndarray
    dropouts: np.ndarray
    ended: tuple[Dropout, ...]
    dropped: int

    @property
    def end(self) -> Counts:
        """Counts at the end of the block."""
        powers = self.predicted, self.measured
        return Counts(*(np.array([len(block.stamp_ns)]) for block in powers))

    def before(self, stamps: np.ndarray) -> Counts:
        """Counts of powers before stamps, ns, shape (k,)."""
        powers = self.predicted, self.measured
        return Counts(*(block.stamp_ns.searchsorted(stamps) for block in powers))

    def up_to(self, stamps: np.ndarray) -> Counts:
        """Counts of powers at or before stamps, ns, shape (k,)."""
        powers = self.predicted, self.measured
        return Counts(*(block.stamp_ns.searchsorted(stamps, side="right") for block in powers))

    def newest(self, at: Counts) -> np.ndarray:
        """The newest stamp, ns, shape (k,)."""
        predicted_ns, measured_ns = self.predicted.newest_ns, self.measured.newest_ns
        newest_ns: np.ndarray = np.maximum(predicted_ns[at.predicted], measured_ns[at.measured])
        return newest_ns

    def silent_s(self, at: Counts, stamp_ns: np.ndarray) -> np.ndarray:
        """Time from the last battery reading, or the first stamp, to stamps, s."""
        since_ns = self.since_ns[at.measured]
        since_ns = np.where(since_ns == 0, self.first_ns[at.predicted], since_ns)
        return np.where(since_ns == 0, 0, np.maximum(stamp_ns - since_ns, 0)) / NANOSECONDS

    def silent(self, at: Counts, seconds: np.ndarray) -> np.ndarray:
        """True where the battery, silent for these seconds, has dropped out, shape (k,)."""
        silent: np.ndarray = ~self.heard[at.measured]
        late = seconds > MAX_GAP
        if late.any():
            integral = self.measured.integral
            counts, which = np.unique(integral.used[at.measured[late]], return_inverse=True)
            longest = np.array([integral.longest(count) for count in counts.tolist()])
            late[late] = seconds[late] > longest[which]
        return silent | late

    def bridges(
        self, at: Counts, seconds: np.ndarray, until: np.ndarray, *, in_turn: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bridges since the last battery reading, their 1-sigma without lasting errors, and whole.

        In a dropout longer than `LEAST_DROPOUT`, its energy by the estimator counts, before that
        the integral of its powers. The integral also counts after a restart until the next battery
        reading, because a part of that dropout may have been counted before.

        Args:
            at: k counts.
            seconds: since the last battery reading, shape (k,).
            until: `totals` at the ends, shape (k, 5).
            in_turn: True if the k are successive dropouts.

        Returns:
            Columns of `Bridge`, shape (k, 4), and both 1-sigma, J, shape (k,).
        """
        anchors, estimated = self.anchors[at.measured], self.estimated[at.predicted]
        bridge = until[:, :4] - anchors[:, :4]
        whole = self.heard[at.measured] | (self.since_ns[at.measured] == 0)
        by_estimator = whole & np.isfinite(estimated[:, 0]) & (seconds >= LEAST_DROPOUT)
        bridge[:, 0] = np.where(by_estimator, estimated[:, 0], bridge[:, 0])
        guessed = np.sqrt(np.maximum(until[:, 4] - anchors[:, 4], 0.0))
        is_estimated = np.isfinite(estimated[:, 1])
        short = np.where(is_estimated, estimated[:, 1], guessed)
        lasting = np.hypot(guessed, LASTING_SHARE * bridge[:, 2])
        unknown_s, ended = seconds - bridge[:, 3], self.dropouts[at.measured]
        before = ended[:, 6] - ended[:, 3]
        if in_turn:
            before = before + np.cumsum(unknown_s) - unknown_s
        recent, holes = self.recent[at.measured], (unknown_s, before)
        hole = taken_variance(recent, *(np.maximum(length, 0.0) for length in holes))
        sigma = np.where(is_estimated, estimated[:, 1], lasting)
        return bridge, short, np.hypot(sigma, np.sqrt(hole))

    def until_now(self, at: Counts) -> tuple[np.ndarray, np.ndarray]:
        """`dropouts` with the present one, shape (k, 7), and whether there is one, shape (k,)."""
        seconds = self.silent_s(at, self.newest(at))
        silent, dropouts = self.silent(at, seconds), self.dropouts[at.measured]
        open_step = silent | (seconds > MAX_GAP)
        if not open_step.any():
            return dropouts, silent
        bridge, short, sigma = self.bridges(at, seconds, self.totals[at.predicted])
        variance = sigma**2
        unmeasured_s = np.where(silent, seconds, 0.0)  # a slow battery may still measure it
        present = np.column_stack((bridge, variance, variance - short**2, unmeasured_s))
        return dropouts + np.where(open_step[:, None], present, 0.0), silent

    def counted_until(self, at: Counts) -> np.ndarray:
        """Stamps up to which `consumed` counts energy, ns, shape (k,)."""
        newest_ns = self.newest(at)
        seconds = self.silent_s(at, newest_ns)
        bridged = self.silent(at, seconds) | (seconds > MAX_GAP)
        since_ns = self.since_ns[at.measured]
        until_ns: np.ndarray = np.where(bridged, np.maximum(newest_ns, since_ns), since_ns)
        return until_ns

    def consumed(self, at: Counts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Net energy, J, its variance, J^2, and time without the battery, s, shape (k,) each."""
        now, _ = self.until_now(at)
        energy = self.measured.net(at.measured) + now[:, 0]
        return energy, self.measured.variance[at.measured] + now[:, 4], now[:, 6]

    def states(self, at: Counts) -> EnergyState:
        """States after k counts of powers."""
        now, silent = self.until_now(at)
        predicted_power = self.predicted.power[at.predicted]
        measured_power = self.measured.power[at.measured]
        power = np.where(silent, predicted_power, measured_power)
        integrals = self.predicted.integral, self.measured.integral
        used = [integral.used[counts] for integral, counts in zip(integrals, at, strict=True)]
        gaps = sum(integral.gaps[row] for integral, row in zip(integrals, used, strict=True))
        measured, regenerated = self.measured.net(at.measured), integrals[1].regenerated[used[1]]
        rknn, rknn_power = self.rknn[at.predicted].T
        braking = np.where(np.isnan(power), power, np.maximum(-power, 0.0))
        of_measured = self.measured.variance[at.measured]
        of_predicted = np.sqrt(self.predicted.variance[at.predicted] + now[:, 5])
        sigma = np.sqrt(np.maximum(of_measured + now[:, 4], 0.0))
        measured_power = np.where(silent, math.nan, measured_power)
        return EnergyState(
            stamp_ns=self.newest(at),
            measured=Flow(measured, measured_power, np.sqrt(of_measured)),
            predicted=Flow(self.predicted.net(at.predicted), predicted_power, of_predicted),
            rknn=Flow(rknn, rknn_power, of_predicted),
            regenerated=Flow(regenerated + now[:, 1], braking, sigma),
            consumed=measured + now[:, 0],
            consumed_sigma=sigma,
            gaps=gaps.astype(np.int64),
            dropped=self.dropped + sum(at) - sum(used),
            unmeasured_s=now[:, 6],
            unknown_s=np.maximum(now[:, 6] - now[:, 3], 0.0),
            measuring=~silent,
        )


class EnergyMeter(Saveable[SavedMeter]):
    """Integrates measured and predicted power side by side.

    Samples whose time goes back are dropped and counted; a caller that knows that a bag started
    over calls `reset`.

    Attributes:
        course: of the last block.
    """

    def __init__(
        self,
        rknn: Rknn,
        *,
        integrator: Integrator = Integrator.RKNN,
        max_gap: float = MAX_GAP,
    ) -> None:
        """A meter at zero.

        Args:
            rknn: the Runge-Kutta network.
            integrator: of predicted power in dropouts; the state has both integrals.
            max_gap: longest step of predicted power that is integrated, s.

        Raises:
            InputError: `max_gap` is beyond what the network is trained for.
        """
        if not 0 < max_gap <= STEP_LIMIT:
            raise InputError(
                f"max_gap = {max_gap:g} s: must be above 0 and at most {STEP_LIMIT:g}"
            )
        self._network, self._integrator = rknn, integrator
        self._max_gap = max_gap
        self.reset()

    def reset(self) -> None:
        """Set all totals to zero."""
        self.take(SavedMeter())

    def take(self, saved: SavedMeter) -> None:
        """Go on from saved totals; the next sample starts a new step, not a gap."""
        self._measured = EnergyIntegral(MAX_GAP, saved.measured)
        self._predicted = EnergyIntegral(self._max_gap, saved.predicted)
        self._errors = (
            CorrelatedError(saved.predicted_sigma),
            CorrelatedError(saved.measured_sigma),
        )
        nothing = NO_STAMPS[:0]
        predicted, measured = (
            PowerCourse(nothing, integral, NO_STAMPS, UNKNOWN, np.array([sigma**2]))
            for integral, sigma in (
                (self._predicted.extend(nothing, nothing), saved.predicted_sigma),
                (self._measured.extend(nothing, nothing), saved.measured_sigma),
            )
        )
        rknn = np.array([[saved.rknn, math.nan]])
        totals = self._totals(predicted, rknn)
        dropouts = [*saved.bridged, saved.bridged_sigma**2, saved.lasting_sigma**2]
        self.course = MeterCourse(
            predicted,
            measured,
            rknn=rknn,
            totals=totals,
            estimated=np.full((1, 2), math.nan),
            first_ns=NO_STAMPS,
            used_ns=NO_STAMPS,
            since_ns=np.array([saved.until_ns], np.int64),
            heard=np.zeros(1, dtype=bool),
            anchors=totals,
            recent=np.array([saved.recent]),
            dropouts=np.array([[*dropouts, saved.unmeasured_s]]),
            ended=(),
            dropped=self._predicted.dropped + self._measured.dropped,
        )

    def add(self, predicted: PowerRows, measured: PowerRows) -> MeterCourse:
        """Add the powers that follow; returns the course of this block.

        Measurements of a time that predictions have bridged are dropped, or it would count twice.
        """
        last = _joined_to_before(self.course, predicted, measured)
        late = measured.stamp_ns <= last.counted_until(last.end)
        dropped = self._predicted.dropped + self._measured.dropped
        predicts = self._predicted.extend(predicted.stamp_ns, predicted.power)
        measures = self._measured.extend(
            measured.stamp_ns, np.where(late, math.nan, measured.power)
        )
        variance = _variances(self._errors[0], predicts, predicted.sigma)
        predictions = last.predicted.then(predicted.stamp_ns, predicts, variance)
        variance = _variances(self._errors[1], measures, measured.sigma, sampled)
        measurements = last.measured.then(measured.stamp_ns, measures, variance)
        rknn = self._by_network(predicts, last.rknn[-1])[predicts.used]
        totals = self._totals(predictions, rknn)
        used_ns = np.append(last.used_ns, predicts.stamps)
        series = np.concatenate((last.totals[-1:], totals[predicts.places + 1]))
        anchors = np.concatenate((last.anchors[-1:], _at(measures.stamps, used_ns, series)))
        since_ns = np.concatenate((last.since_ns[-1:], measures.stamps))
        first_ns = last.first_ns[-1] or int(predicted.stamp_ns[:1].sum())  # 0 without any
        estimated = np.stack((predicted.energy, predicted.energy_sigma), axis=-1)
        course = MeterCourse(
            predictions,
            measurements,
            rknn=rknn,
            totals=totals,
            estimated=np.concatenate((last.estimated[-1:], estimated)),
            first_ns=np.repeat((last.first_ns[-1], first_ns), (1, len(predicted.stamp_ns))),
            used_ns=used_ns[-1:],
            since_ns=since_ns[measures.used],
            heard=last.heard[-1] | (measures.used > 0),
            anchors=anchors[measures.used],
            recent=recent_powers(last.recent[-1], measures)[measures.used],
            dropouts=np.repeat(last.dropouts[-1:], len(measured.stamp_ns) + 1, axis=0),
            ended=(),
            dropped=dropped,
        )
        ends = (~measures.joined).nonzero()[0]  # a measurement after a gap ends a dropout
        stamps = measures.stamps[ends]
        at = Counts(predicted.stamp_ns.searchsorted(stamps), measures.places[ends])
        self.course = _with_ended(course, at, stamps)
        return self.course

    def _totals(self, predicted: PowerCourse, rknn: np.ndarray) -> np.ndarray:
        """Rows of `MeterCourse.totals`, by rows of `MeterCourse.rknn`."""
        integral = predicted.integral
        columns = integral.drawn, integral.regenerated, integral.covered_s
        drawn, regenerated, covered_s = (column[integral.used] for column in columns)
        energy = rknn[:, 0] if self._integrator is Integrator.RKNN else drawn - regenerated
        rows = energy, regenerated, drawn + regenerated, covered_s, predicted.variance
        return np.stack(rows, axis=-1)

    def _by_network(self, course: IntegralCourse, last: np.ndarray) -> np.ndarray:
        """Energy by the network, J, and its last mean power, W, after 0 to n used samples."""
        energies = np.zeros(len(course.steps))
        joined = course.joined.nonzero()[0]
        for batch in np.split(joined, range(BATCH, len(joined), BATCH)) if len(joined) else ():
            energies[batch] = self._network.step(
                course.begin[batch], course.end[batch], course.steps[batch]
            )
        means = np.concatenate((last[1:], energies[joined] / course.steps[joined]))
        running = np.concatenate((last[:1], energies)).cumsum()
        return np.stack((running, means[counted(course.joined)]), axis=-1)

    @property
    def measuring(self) -> bool:
        """True if the battery was measured within its timeout."""
        return not self.course.until_now(self.course.end)[1][0]

    def saved(self) -> SavedMeter:
        """State to save, with the present dropout."""
        course, end = self.course, self.course.end
        now = course.until_now(end)[0][0].tolist()
        return SavedMeter(
            measured=self._measured.total,
            predicted=self._predicted.total,
            rknn=float(course.rknn[-1, 0]),
            measured_sigma=self._errors[1].sigma,
            predicted_sigma=self._errors[0].sigma,
            bridged=Bridge(*now[:4]),
            bridged_sigma=math.sqrt(now[4]),
            lasting_sigma=math.sqrt(now[5]),
            unmeasured_s=now[6],
            until_ns=int(course.counted_until(end)[0]),
            recent=RecentPower(*course.recent[-1].tolist()),
        )


def _joined_to_before(
    course: MeterCourse, predicted: PowerRows, measured: PowerRows
) -> MeterCourse:
    """The course before a block; without `since_ns` if it was saved too long before the block."""
    firsts = np.concatenate((predicted.stamp_ns[:1], measured.stamp_ns[:1]))
    begun = course.heard[-1] or course.first_ns[-1] or not course.since_ns[-1]
    if begun or not len(firsts):
        return course
    since_ns = away_since(int(course.since_ns[-1]), int(firsts.min()))
    return replace(course, since_ns=np.array([since_ns], np.int64))


def _variances(
    error: CorrelatedError,
    course: IntegralCourse,
    sigmas: np.ndarray,
    besides: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Variance of an integral after 0 to n samples of a block, J^2, shape (n + 1,).

    `besides` gives the variance to add for steps, s, and rises of power, W.
    """
    joined, steps = course.joined, course.steps[course.joined]
    used, rises = sigmas[course.places][joined], (course.end - course.begin)[joined]
    variances = error.integrate(used, steps, besides and besides(steps, rises))
    after: np.ndarray = variances[counted(joined)[course.used]]
    return after


def _at(stamps: np.ndarray, series_ns: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Rows of a series at stamps, linear between its stamps, constant beyond its ends."""
    after = series_ns.searchsorted(stamps, side="right")
    rows: np.ndarray = series[np.maximum(after - 1, 0)]
    inside = np.flatnonzero((after > 0) & (after < len(series_ns)))
    begin_ns = series_ns[after[inside] - 1]
    share = (stamps[inside] - begin_ns) / (series_ns[after[inside]] - begin_ns)
    rows[inside] += share[:, None] * (series[after[inside]] - rows[inside])
    return rows


def _with_ended(course: MeterCourse, at: Counts, stamps: np.ndarray) -> MeterCourse:
    """The course with dropouts ended by the measurements at these places and stamps."""
    if not len(stamps):
        return course
    seconds = course.silent_s(at, stamps)
    bridges, short, sigma = course.bridges(
        at, seconds, course.anchors[at.measured + 1], in_turn=True
    )
    columns = np.column_stack((bridges, sigma**2, sigma**2 - short**2, seconds))
    added = np.zeros_like(course.dropouts)
    added[at.measured + 1] = columns
    measured = course.measured.integral
    limits = [measured.longest(count) for count in measured.used[at.measured + 1].tolist()]
    long = seconds > np.maximum(MAX_GAP, limits)
    ended = tuple(
        Dropout(
            int(stamps[index]),
            float(seconds[index]),
            Bridge(*bridges[index].tolist()),
            float(sigma[index]),
        )
        for index in np.flatnonzero(long).tolist()
    )
    return replace(course, dropouts=course.dropouts + np.cumsum(added, axis=0), ended=ended)
