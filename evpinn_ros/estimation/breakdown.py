"""Breakdown of the energy of a drive by where it went, with what is not known of it.

Sums of the parts (`energy_parts`) over the intervals so far are linear in the states, so they are
smoothed with them: each sum keeps its covariance with the states of every hypothesis, and what
later intervals teach of a car or of the slope of a road moves the sums of before. That is exact
for a linear model, and no interval is kept.

The parts need not add up to what was measured: what is left is shown as unexplained. Parts that
the data tell apart worse than they tell their sum are to be read together (`together`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
import math

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.estimation.car_state import SIZE, State
from evpinn_ros.estimation.energy_parts import COUNT, WHOLE, Part, parts
from evpinn_ros.estimation.gaussian import Gaussian, Innovation, mixture
from evpinn_ros.estimation.weak_form import Constants, Spent, Warmth
from evpinn_ros.signals.interval import Interval
from evpinn_ros.vehicle.physics import GRAVITY

FAST = slice(State.AUX, State.ENERGY)  # states that pass
NOW = slice(-COUNT, None)  # the sums of the drive that goes on
LOST = [Part.BRAKES, Part.DRIVETRAIN, Part.REGAINED]  # what noise of losses is of
UNEXPLAINED, REGAINED = "unexplained", "regained"
# Hills longer than the filter's own look like tyres. A road whose slope wanders gains height by
# the root of its length; this much of it, for long hills are less steep.
LONG_HILLS, HILL_LENGTH = 0.15, 600.0
# A measured height strays too, and over more than the 100 m of the filter's error: wind and doors
# move a barometer by half a metre, for a minute. Of a whole drive it counts at both ends.
HEIGHT_STRAYS = 0.5  # m, 1-sigma
REGAINED_SHARE = 0.015  # of it, 1-sigma: a step of half a second may hold driving and braking
DISTANCE = 1e5  # m that a difference of drives is of
EDGE_SPEED = 0.15  # m/s, 1-sigma of the speed at the ends of what is counted
LONG_HILL = np.eye(COUNT)[Part.SLOPE] - np.eye(COUNT)[Part.TYRES]
# Between drives: efficiency changes by this much for each e-fold of power, and a constant one
# has air, the part that grows with speed most, account for it.
MAP_SHARE, MAP_ERROR = 0.03, np.eye(COUNT)[Part.AIR] - np.eye(COUNT)[Part.DRIVETRAIN]
TOGETHER = 0.5  # a sum this much surer than its less sure part is known, its parts are not
LEAST_DISTANCE = 100.0  # m; over less no consumption is known
LEAST_SHARE = 0.02  # of what went in and out: a part less unsure than that is known well enough


@dataclass(frozen=True, slots=True)
class Amount:
    """An energy: kWh, 1-sigma, kWh/100 km (None over no distance), share (None of nothing)."""

    kwh: float
    sigma_kwh: float
    kwh_per_100km: float | None
    share: float | None


@dataclass(frozen=True, slots=True)
class Breakdown:
    """The energy of a drive, by part.

    Attributes:
        energy: of each `Part`, J, shape (COUNT,).
        covariance: of these, J^2, shape (COUNT, COUNT).
        measured: at the battery, over the same intervals, J.
        measured_variance: of that, due to the rate of its readings, J^2.
        distance: m.
        seconds: s.
    """

    energy: np.ndarray
    covariance: np.ndarray
    measured: float
    measured_variance: float
    distance: float
    seconds: float

    def amounts(self) -> dict[str, Amount]:
        """The parts, what they leave unexplained, and what braking brought back beside them."""
        found = {part.name.lower(): self.of(part) for part in list(Part)[WHOLE]}
        explained = float(self.energy[WHOLE].sum())
        unsure = float(self.covariance[WHOLE, WHOLE].sum()) + self.measured_variance
        found[UNEXPLAINED] = self._amount(self.measured - explained, unsure)
        found[REGAINED] = self.of(Part.REGAINED)
        return found

    def of(self, *chosen: Part) -> Amount:
        """Some parts together."""
        index = list(chosen)
        variance = float(self.covariance[np.ix_(index, index)].sum())
        return self._amount(float(self.energy[index].sum()), variance)

    def total(self) -> Amount:
        """Energy measured over the same intervals."""
        return self._amount(self.measured, self.measured_variance)

    def together(self) -> list[tuple[Part, ...]]:
        """Groups of parts that the data do not tell apart: their sum is much surer than they."""
        scale = LEAST_SHARE * float(np.abs(self.energy[WHOLE]).sum())
        groups: list[tuple[Part, ...]] = [(part,) for part in list(Part)[WHOLE]]
        while True:
            joined = [
                (self._sigma(a + b) / max(self._sigma(a), self._sigma(b)), a, b)
                for i, a in enumerate(groups)
                for b in groups[i + 1 :]
                if min(self._sigma(a), self._sigma(b)) > scale
            ]
            if not joined or min(joined)[0] > TOGETHER:
                return [group for group in groups if len(group) > 1]
            _, a, b = min(joined)
            groups = [tuple(sorted(a + b)), *(g for g in groups if g not in (a, b))]

    def _sigma(self, group: tuple[Part, ...]) -> float:
        return self.of(*group).sigma_kwh * JOULES_PER_KWH

    def _amount(self, energy: float, variance: float) -> Amount:
        known = self.distance >= LEAST_DISTANCE
        kwh = energy / JOULES_PER_KWH
        return Amount(
            kwh=kwh,
            sigma_kwh=math.sqrt(max(0.0, variance)) / JOULES_PER_KWH,
            kwh_per_100km=kwh / self.distance * 1e5 if known else None,
            share=energy / self.measured if self.measured > 0.0 else None,
        )


@dataclass(frozen=True, slots=True)
class Totals:
    """Energy, distance and time that the sums of a drive are of.

    Attributes:
        measured: J of the battery.
        measured_variance: due to the rate of its readings, J^2.
        distance: m.
        seconds: s.
        unseen: m of it where no height was known.
    """

    measured: float = 0.0
    measured_variance: float = 0.0
    distance: float = 0.0
    seconds: float = 0.0
    unseen: float = 0.0

    def plus(self, interval: Interval) -> Totals:
        """With one more interval."""
        distance = abs(interval.distance)
        return Totals(
            measured=self.measured + interval.energy,
            measured_variance=self.measured_variance + max(0.0, interval.sampling_variance),
            distance=self.distance + distance,
            seconds=self.seconds + interval.duration,
            unseen=self.unseen + (0.0 if interval.height_known else distance),
        )


@dataclass(frozen=True, slots=True)
class Breakdowns:
    """Breakdowns of D drives of one car, and how their errors go together.

    Attributes:
        energy: of each part of each drive, J, shape (D, COUNT).
        covariance: of these, J^2, shape (D, COUNT, D, COUNT).
        drives: what they are of.
    """

    energy: np.ndarray
    covariance: np.ndarray
    drives: tuple[Totals, ...]

    def of(self, drive: int) -> Breakdown | None:
        """Breakdown of one drive, None of no interval."""
        whole = self.drives[drive]
        if whole.seconds == 0.0:
            return None
        counts = whole.measured, whole.measured_variance, whole.distance, whole.seconds
        return Breakdown(self.energy[drive], self.covariance[drive, :, drive], *counts)

    def difference(self, drive: int, base: int) -> Breakdown:
        """Energy that a drive took more than another, of 100 km each.

        What is not known of the car is the same in both, and mostly gone from the difference. What
        stays is that its efficiency is a map: the more the power of the drives differs, the more.
        Both must be longer than `LEAST_DISTANCE`.
        """
        pair = [drive, base]
        more, less = (self.drives[each] for each in pair)
        scale = np.array([DISTANCE / more.distance, -DISTANCE / less.distance])
        covariance = np.einsum("a,aibj,b->ij", scale, self.covariance[pair][:, :, pair], scale)
        drawn = [self.drives[each].measured + self.energy[each, Part.REGAINED] for each in pair]
        lasted = more.seconds, less.seconds
        efolds = math.log(max(drawn[0] / lasted[0], 1.0) / max(drawn[1] / lasted[1], 1.0))
        map_error = MAP_SHARE * efolds * float(np.abs(scale) @ drawn) / 2.0
        covariance += map_error**2 * np.outer(MAP_ERROR, MAP_ERROR)
        return Breakdown(
            energy=scale @ self.energy[pair],
            covariance=covariance,
            measured=float(scale @ [more.measured, less.measured]),
            measured_variance=float(scale**2 @ [more.measured_variance, less.measured_variance]),
            distance=DISTANCE,
            seconds=0.0,
        )

    def joined(self, owners: Sequence[int]) -> Breakdowns:
        """The same where some belong together, as those before and after a long stop.

        Args:
            owners: number of the whole that each belongs to; all from 0 on.
        """
        which = (np.arange(max(owners) + 1)[:, None] == np.array(owners)).astype(float)
        covariance = np.einsum("ad,dier,be->aibr", which, self.covariance, which)
        whole = which @ [astuple(each) for each in self.drives]
        return Breakdowns(which @ self.energy, covariance, tuple(Totals(*row) for row in whole))


@dataclass(frozen=True, slots=True)
class PartSums:
    """Sums of the parts over intervals, for each of K hypotheses; a value that is replaced.

    Of the drive that goes on, and where they are kept (`next_drive`) of those before it: D drives,
    COUNT sums each, N in all, those of the drive that goes on last.

    Attributes:
        mean: J, shape (K, N).
        covariance: J^2, shape (K, N, N).
        cross: covariance with the states, shape (K, N, SIZE).
        drives: what the sums of each drive are of.
    """

    mean: np.ndarray
    covariance: np.ndarray
    cross: np.ndarray
    drives: tuple[Totals, ...] = (Totals(),)

    @classmethod
    def none(cls, hypotheses: int) -> PartSums:
        """Of no interval."""
        count = hypotheses, COUNT
        return cls(np.zeros(count), np.zeros((*count, COUNT)), np.zeros((*count, SIZE)))

    def next_drive(self, kept: np.ndarray) -> PartSums:
        """With another drive, of no interval yet.

        Args:
            kept: share of each state that is kept between drives, shape (SIZE,).
        """
        if not self.drives[-1].seconds:
            return self.offset(kept)
        cross = self.cross * kept
        all_, more = (0, 0), (0, COUNT)
        return PartSums(
            np.pad(self.mean, (all_, more)),
            np.pad(self.covariance, (all_, more, more)),
            np.pad(cross, (all_, more, all_)),
            (*self.drives, Totals()),
        )

    def offset(self, kept: np.ndarray) -> PartSums:
        """With states of which a share, shape (SIZE,), is as it was: the drive goes on."""
        return replace(self, cross=self.cross * kept)

    def passed(self, transition: np.ndarray) -> PartSums:
        """After a step of the states, of which all but `FAST` stay."""
        cross = self.cross.copy()
        cross[:, :, FAST] = cross[:, :, FAST] @ transition[FAST, FAST].T
        return replace(self, cross=cross)

    def without(self, states: slice) -> PartSums:
        """After these states were forgotten."""
        cross = self.cross.copy()
        cross[:, :, states] = 0.0
        return replace(self, cross=cross)

    def given(
        self, seen: Innovation, gradient: np.ndarray, extra: np.ndarray, lost: np.ndarray
    ) -> PartSums:
        """After the states were conditioned on a measured energy.

        Args:
            seen: the innovation.
            gradient: of the energy by the states, shape (K, SIZE).
            extra: variance added to the measurement's, shape (K,).
            lost: how much of the noise is of each part, J^2, shape (K, COUNT).
        """
        variance = (seen.variance + extra)[:, None]
        along = np.matmul(self.cross, gradient[:, :, None])[:, :, 0]
        along[:, NOW] += lost
        gain = along / variance
        covariance = self.covariance - gain[:, :, None] * along[:, None, :]
        own = covariance[:, NOW, NOW]
        own[:, LOST, LOST] += np.abs(lost[:, LOST])
        own[:, Part.BRAKES, Part.REGAINED] -= lost[:, Part.BRAKES]
        own[:, Part.REGAINED, Part.BRAKES] -= lost[:, Part.BRAKES]
        return replace(
            self,
            mean=self.mean + gain * seen.residual[:, None],
            covariance=covariance,
            cross=self.cross - gain[:, :, None] * seen.along[:, None, :],
        )

    def moved(self, state: int, share: np.ndarray) -> PartSums:
        """After a state was moved by `share` of its variance, shape (K,)."""
        return replace(self, mean=self.mean + share[:, None] * self.cross[:, :, state])

    def plus(
        self,
        interval: Interval,
        state: Gaussian,
        weights: np.ndarray,
        warmth: Warmth,
        car: Constants,
    ) -> PartSums:
        """With one more interval, whose battery was measured and learned from.

        Args:
            interval: to add.
            state: given this interval.
            weights: of the hypotheses; the parts are linear about their mean.
            warmth: of tyres and cabin.
            car: constants.
        """
        about = weights @ state.mean
        energy, gradient = parts(about, interval.steps, interval.conditions, warmth, car)
        mean, covariance, cross = self.mean.copy(), self.covariance.copy(), self.cross.copy()
        own = gradient @ state.covariance
        shared = self.cross @ gradient.T
        mean[:, NOW] += energy + (state.mean - about) @ gradient.T
        covariance[:, NOW, NOW] += own @ gradient.T
        covariance[:, :, NOW] += shared
        covariance[:, NOW, :] += np.swapaxes(shared, 1, 2)
        cross[:, NOW] += own
        drives = *self.drives[:-1], self.drives[-1].plus(interval)
        return PartSums(mean, covariance, cross, drives)

    def breakdowns(self, weights: np.ndarray, weight: float, hilliness: float) -> Breakdowns:
        """The sums over all hypotheses, of every drive.

        Args:
            weights: of the hypotheses, shape (K,).
            weight: of the car, N.
            hilliness: 1-sigma of the unseen slope.
        """
        mean, covariance = mixture(weights, Gaussian(self.mean, self.covariance))
        for drive, totals in enumerate(self.drives):
            span = slice(drive * COUNT, (drive + 1) * COUNT)
            own, energy = covariance[span, span], mean[span]
            height = (LONG_HILLS * hilliness) ** 2 * HILL_LENGTH * totals.unseen
            if totals.unseen < totals.distance:
                height += 2.0 * HEIGHT_STRAYS**2
            own += weight**2 * height * np.outer(LONG_HILL, LONG_HILL)
            own[Part.REGAINED, Part.REGAINED] += (REGAINED_SHARE * energy[Part.REGAINED]) ** 2
            edges = 2.0 * weight / GRAVITY * EDGE_SPEED**2 * abs(energy[Part.SPEED])  # (m v dv)^2
            own[Part.SPEED, Part.SPEED] += edges
        shape = len(self.drives), COUNT
        return Breakdowns(mean.reshape(shape), covariance.reshape(shape + shape), self.drives)


def loss_shares(found: Spent) -> np.ndarray:
    """Share of an interval's losses by part, those of `LOST`, shape (K, COUNT).

    What braking loses it does not bring back.
    """
    shares = np.zeros((len(found.energy), COUNT))
    braked = found.wheel_brake / np.maximum(found.wheel_drive + found.wheel_brake, 1.0)
    shares[:, Part.BRAKES], shares[:, Part.REGAINED] = braked, -braked
    shares[:, Part.DRIVETRAIN] = 1.0 - braked
    return shares
