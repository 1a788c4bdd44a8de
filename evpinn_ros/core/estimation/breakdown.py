"""Breakdown of the energy of a drive by where it went, with its covariance.

The parts of a drive (`Equation.split`, summed over its intervals) are linear in the states. So
later intervals, which teach more of the car, of this drive or of its heights, also correct earlier
parts, and nothing is added up twice. When a drive ends, its own states (offsets, wandered loads,
unseen climb) are kept as functions of the states of the car, so that drives can be compared by all
that was learned (a smoother of Rauch, Tung and Striebel).

The parts need not add up to the measured energy: the rest is shown as unexplained, with the sigma
of the noise on the way, outliers (braking by friction, say) included. Parts whose sum the data
determine better than the parts are to be read together (`together`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from itertools import combinations
import math
from typing import Annotated

import numpy as np

from evpinn_ros.common.saved_fields import Figure
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.estimation.gaussian import Gaussian, at_least_zero
from evpinn_ros.core.estimation.journey import unseen_of
from evpinn_ros.core.estimation.posterior import CarState
from evpinn_ros.core.estimation.states import LASTING, OFFSETS, PHYSICS, SIZE, State
from evpinn_ros.core.estimation.terms import COUNT, LOSSES, WHOLE, Equation, Part
from evpinn_ros.core.signals.interval import Interval
from evpinn_ros.core.vehicle.physics import GRAVITY

UNEXPLAINED, REGAINED = "unexplained", "regained"
# States of a single drive.
OF_DRIVE = [*OFFSETS, State.WANDERED, State.LOAD_ENERGY, State.CLIMBED, State.CLIMB]
# A measured height strays: wind and doors move a barometer by half a metre for a minute. In a
# whole drive this counts at both ends.
HEIGHT_STRAYS = 0.5  # m, 1-sigma
DIFFERENCE_METRES = 1e5  # m to which differences of drives refer
EDGE_SPEED = 0.15  # m/s, 1-sigma of the speed at both ends of the counted intervals
STRAYED_HILL = np.eye(COUNT)[Part.SLOPE] - np.eye(COUNT)[Part.TYRES]
# 1-sigma of energy that looks like tyres, as a share of the air's and of the standing energy: by
# wind and rolling resistance that grows with speed, and by loads that are on while the car drives.
# By likelihood of 60 simulated drives that no benchmark scores.
AS_TYRES = 0.05
# 1-sigma of regained energy that was lost in the brakes, and not in the drivetrain, because the
# sum is known; as a share. A step of half a second may hold driving and braking. Without torque,
# the share of the brakes differs from drive to drive: by the likelihood of 24 recorded drives of
# an i3 and a Leaf, each learned alone, against all of that car (`evpinn bench breakdown --alone`).
NOT_REGAINED, NOT_REGAINED_UNSEEN = 0.015, 0.08
# Where no height is known, the net climb of a drive has this 1-sigma, m, once the drive is longer
# than `HILL`, m. In drives of an i3 and a Leaf without their heights (`evpinn bench breakdown
# --heights`), the energy of a climb appears as braking and losses of the drivetrain on a steep
# short drive, as tyres and air on a long one. Where heights begin late, the unknown ends are
# short: no road climbs more than `STEEP` there.
NET_CLIMB, HILL, STEEP = 122.0, 1000.0, 0.05
CLIMB_AS_BRAKES, CLIMB_AS_STANDING = 0.43, 0.04  # of the climb
CLIMB_AS_FRICTION, MOST_AS_FRICTION = 1.4e-5, 0.5  # tyres and air, by the distance in m; at most
MOSTLY_UNSEEN = 0.5  # share of the way without heights from which on a note says so
# Between drives, efficiency changes by this share for each e-fold of power; a constant efficiency
# counts the change as air, the part that grows most with speed.
MAP_SHARE, MAP_ERROR = 0.03, np.eye(COUNT)[Part.AIR] - np.eye(COUNT)[Part.DRIVETRAIN]
TOGETHER = 0.5  # sigma of a sum over that of its less sure part, below which parts are joined
_TERMS = [LASTING.index(state) for state in PHYSICS]  # columns of `EndedDrive.rows`
CONSUMPTION_METRES = 100.0  # m; shorter drives have no consumption
KNOWN_SHARE = 0.02  # of gross energy: a part with a smaller sigma is known well enough


@dataclass(frozen=True, slots=True)
class Amount:
    """Energy of a part of a drive, and per distance."""

    kwh: Annotated[
        float,
        Figure("kWh", "energy of this part of the drive; see the guide to replays for the parts"),
    ]
    sigma_kwh: Annotated[float, Figure("kWh", "its 1-sigma")]
    kwh_per_100km: Annotated[
        float | None, Figure("kWh/100 km", "the same over distance, null below 100 m")
    ]
    share: Annotated[
        float | None, Figure("", "of the measured energy, null where that is not above 0")
    ]


@dataclass(frozen=True, slots=True)
class Totals:
    """Sums over the intervals of a drive.

    Attributes:
        measured: J at the battery.
        measured_variance: due to the rate of its readings, J^2.
        distance: m.
        seconds: s.
        unseen: m of the distance where no height was known.
        noise: learned variance of the energy that no state of the car explains, J^2.
    """

    measured: float = 0.0
    measured_variance: float = 0.0
    distance: float = 0.0
    seconds: float = 0.0
    unseen: float = 0.0
    noise: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Breakdown(Totals):
    """The energy of a drive, by part.

    Attributes:
        energy: of each `Part`, J, shape (COUNT,).
        covariance: of these, J^2, shape (COUNT, COUNT).
    """

    energy: np.ndarray
    covariance: np.ndarray

    def amounts(self) -> dict[str, Amount]:
        """The parts and the unexplained rest, which add up, and the energy regained by braking."""
        amounts = {part.name.lower(): self.of(part) for part in list(Part)[WHOLE]}
        explained = float(self.energy[WHOLE].sum())
        unsure = float(self.covariance[WHOLE, WHOLE].sum()) + self.measured_variance + self.noise
        amounts[UNEXPLAINED] = self._amount(self.measured - explained, unsure)
        amounts[REGAINED] = self.of(Part.REGAINED)
        return amounts

    def of(self, *chosen: Part) -> Amount:
        """Energy of these parts together, with the sigma of their sum."""
        index = list(chosen)
        return self._amount(float(self.energy[index].sum()), self._variance(chosen))

    def total(self) -> Amount:
        """Energy measured over the same intervals."""
        return self._amount(self.measured, self.measured_variance)

    def together(self) -> list[tuple[Part, ...]]:
        """Groups of parts that the data do not separate: their sum has a much smaller sigma."""
        scale = KNOWN_SHARE * float(np.abs(self.energy[WHOLE]).sum())
        groups: list[tuple[Part, ...]] = [(part,) for part in list(Part)[WHOLE]]
        while True:
            unsure = [group for group in groups if self._sigma(group) > scale]
            joined = [
                (self._sigma(a + b) / max(self._sigma(a), self._sigma(b)), a, b)
                for a, b in combinations(unsure, 2)
            ]
            if not joined or min(joined)[0] > TOGETHER:
                return [group for group in groups if len(group) > 1]
            _, a, b = min(joined)
            groups = [tuple(sorted(a + b)), *(g for g in groups if g not in (a, b))]

    def _variance(self, group: tuple[Part, ...]) -> float:
        index = list(group)
        return float(self.covariance[index][:, index].sum())

    def _sigma(self, group: tuple[Part, ...]) -> float:
        return math.sqrt(max(0.0, self._variance(group)))

    def _amount(self, energy: float, variance: float) -> Amount:
        has_consumption = self.distance >= CONSUMPTION_METRES
        kwh = energy / JOULES_PER_KWH
        return Amount(
            kwh=kwh,
            sigma_kwh=math.sqrt(max(0.0, variance)) / JOULES_PER_KWH,
            kwh_per_100km=kwh / self.distance * DIFFERENCE_METRES if has_consumption else None,
            share=energy / self.measured if self.measured > 0.0 else None,
        )


@dataclass(frozen=True, slots=True)
class Breakdowns:
    """Breakdowns of D drives of one car, with their joint covariance.

    Attributes:
        energy: of each part of each drive, J, shape (D, COUNT).
        covariance: of these, J^2, shape (D, COUNT, D, COUNT).
        drives: totals of each drive.
    """

    energy: np.ndarray
    covariance: np.ndarray
    drives: tuple[Totals, ...]

    def of(self, drive: int) -> Breakdown | None:
        """Breakdown of one drive; None if it has no interval."""
        totals = self.drives[drive]
        if totals.seconds == 0.0:
            return None
        covariance = self.covariance[drive, :, drive]
        return Breakdown(*astuple(totals), energy=self.energy[drive], covariance=covariance)

    def possible(self) -> Breakdowns:
        """The likeliest energies without a negative loss; the covariance stays."""
        energy = np.array([
            at_least_zero(Gaussian(parts, self.covariance[drive, :, drive]), LOSSES)
            for drive, parts in enumerate(self.energy)
        ])  # fmt: skip
        return replace(self, energy=energy)

    def difference(self, drive: int, base: int) -> Breakdown:
        """Energy that a drive took more than another, each scaled to 100 km.

        Errors about the car are the same in both and mostly cancel. The efficiency map remains:
        the more the powers of the drives differ, the larger its error. Both drives must be longer
        than `CONSUMPTION_METRES`.
        """
        pair = [drive, base]
        more, less = (self.drives[drive] for drive in pair)
        scale = np.array([DIFFERENCE_METRES / more.distance, -DIFFERENCE_METRES / less.distance])
        covariance = np.einsum("a,aibj,b->ij", scale, self.covariance[pair][:, :, pair], scale)
        drawn = [self.drives[drive].measured + self.energy[drive, Part.REGAINED] for drive in pair]
        lasted = more.seconds, less.seconds
        efolds = math.log(max(drawn[0] / lasted[0], 1.0) / max(drawn[1] / lasted[1], 1.0))
        map_error = MAP_SHARE * efolds * float(np.abs(scale) @ drawn) / 2.0
        covariance += map_error**2 * np.outer(MAP_ERROR, MAP_ERROR)
        return Breakdown(
            energy=scale @ self.energy[pair],
            covariance=covariance,
            measured=float(scale @ [more.measured, less.measured]),
            measured_variance=float(scale**2 @ [more.measured_variance, less.measured_variance]),
            distance=DIFFERENCE_METRES,
            unseen=DIFFERENCE_METRES
            * max(parts.unseen / parts.distance for parts in (more, less)),
            noise=float(scale**2 @ [more.noise, less.noise]),
        )

    def joined(self, owners: Sequence[int]) -> Breakdowns:
        """Breakdowns summed by owner, such as those before and after a long stop of a drive.

        Args:
            owners: number of the sum that each drive is part of, from 0 on without gaps.
        """
        which = (np.arange(max(owners) + 1)[:, None] == np.array(owners)).astype(float)
        covariance = np.einsum("ad,dier,be->aibr", which, self.covariance, which)
        whole = which @ [astuple(parts) for parts in self.drives]
        return Breakdowns(which @ self.energy, covariance, tuple(Totals(*row) for row in whole))


@dataclass(frozen=True, slots=True, eq=False)
class DriveParts:
    """The parts of a drive in progress, by part and state, J per unit, shape (COUNT, SIZE)."""

    rows: np.ndarray
    totals: Totals = Totals()

    @classmethod
    def none(cls) -> DriveParts:
        """Parts of a drive before its first interval: only its fast states have energy."""
        rows = np.zeros((COUNT, SIZE))
        rows[Part.STANDING, [State.WANDERED, State.LOAD_ENERGY]] = 1.0
        rows[Part.SLOPE, [State.CLIMBED, State.CLIMB]] = 1.0
        return cls(rows)

    def plus(self, interval: Interval, parts: np.ndarray, noise: float) -> DriveParts:
        """The parts with one more interval, of these `Equation.split` parts and noise, J^2."""
        without_load = parts.copy()
        without_load[:, State.LOAD] = 0.0  # WANDERED and LOAD_ENERGY hold its energy
        more = (
            interval.energy,
            max(0.0, interval.sampling_variance),
            abs(interval.distance),
            interval.duration,
            unseen_of(interval),
            noise,
        )
        sums = (before + added for before, added in zip(astuple(self.totals), more, strict=True))
        return DriveParts(self.rows + without_load, Totals(*sums))

    def ended(self, state: CarState) -> EndedDrive:
        """Parts as functions of the states of the car alone."""
        mean, covariance = state.mixture()
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-12))[LASTING]
        car = covariance[np.ix_(LASTING, LASTING)] / np.outer(scale, scale)
        shared = covariance[np.ix_(LASTING, OF_DRIVE)]
        gain = (np.linalg.lstsq(car, shared / scale[:, None], rcond=1e-9)[0] / scale[:, None]).T
        left = covariance[np.ix_(OF_DRIVE, OF_DRIVE)] - gain @ shared
        of_drive = self.rows[:, OF_DRIVE]
        return EndedDrive(
            self.rows[:, LASTING] + of_drive @ gain,
            of_drive @ (mean[OF_DRIVE] - gain @ mean[LASTING]),
            of_drive @ left @ of_drive.T,
            self.totals,
        )


@dataclass(frozen=True, slots=True, eq=False)
class EndedDrive:
    """The parts of a drive as a function of the states of the car.

    Attributes:
        rows: energy by part and state of `LASTING`, J per unit, shape (COUNT, len(LASTING)).
        offset: J, shape (COUNT,).
        own: covariance by the states of the drive alone, J^2, shape (COUNT, COUNT).
        totals: of the drive.
    """

    rows: np.ndarray
    offset: np.ndarray
    own: np.ndarray
    totals: Totals


def breakdowns(
    ended: Sequence[EndedDrive], now: DriveParts, state: CarState, equation: Equation
) -> Breakdowns:
    """Breakdowns of ended drives and of the one in progress, by all that was learned."""
    drives = (*ended, now.ended(state))
    mean, covariance = state.mixture()
    rows = np.concatenate([drive.rows for drive in drives])
    # By eq. 21; the offset has the energy of the drive's load.
    regained = [
        float(drive.rows[Part.REGAINED, _TERMS] @ mean[PHYSICS] + drive.offset[Part.REGAINED])
        for drive in drives
    ]
    energy = rows @ mean[LASTING] + np.concatenate([drive.offset for drive in drives])
    whole = rows @ covariance[np.ix_(LASTING, LASTING)] @ rows.T
    weight = GRAVITY * equation.eta * float(mean[State.MASS_OVER_ETA])
    growth = math.nan if equation.vehicle.in_traffic else state.bands.growth
    shape = len(drives), COUNT
    energy, whole = energy.reshape(shape), whole.reshape(shape + shape)
    for number, drive in enumerate(drives):
        beside = _beside(energy[number], regained[number], drive.totals, weight, growth)
        whole[number, :, number] += drive.own + beside
    return Breakdowns(energy, whole, tuple(drive.totals for drive in drives))


def _beside(
    energy: np.ndarray, regained: float, totals: Totals, weight: float, growth: float
) -> np.ndarray:
    """Covariance beside that of the states, J^2: by errors of heights, edges, wind and losses.

    Args:
        energy: of each part, J, shape (COUNT,).
        regained: by the terms of eq. 21, J; zero where torque shows braking.
        totals: of the drive.
        weight: over eta, N.
        growth: variance of the unseen climb per length of floors, m, NaN for roads.
    """
    covariance = np.zeros((COUNT, COUNT))
    if totals.unseen < totals.distance:
        covariance += 2.0 * (weight * HEIGHT_STRAYS) ** 2 * np.outer(STRAYED_HILL, STRAYED_HILL)
    if totals.unseen > 0.0:
        climbed = _unseen_climb(energy, totals.unseen)
        on_roads = math.isnan(growth)
        climb = net_climb(totals.unseen) ** 2 if on_roads else growth * totals.unseen
        covariance += weight**2 * climb * np.outer(climbed, climbed)
    unit = np.eye(COUNT)
    braking = unit[Part.REGAINED] - unit[Part.BRAKES] + unit[Part.DRIVETRAIN]
    mistaken = (
        AS_TYRES * energy[Part.AIR] * (unit[Part.AIR] - unit[Part.TYRES]),
        AS_TYRES * energy[Part.STANDING] * (unit[Part.STANDING] - unit[Part.TYRES]),
        NOT_REGAINED * energy[Part.REGAINED] * braking,
        NOT_REGAINED_UNSEEN * regained * braking,
    )
    covariance += sum(np.outer(direction, direction) for direction in mistaken)
    ends = 2.0 * weight / GRAVITY * EDGE_SPEED**2 * abs(energy[Part.SPEED])  # (m v dv)^2 at both
    covariance[Part.SPEED, Part.SPEED] += ends
    return covariance


def climb_as_rolling(unseen: float) -> float:
    """1-sigma of C_rr by an unseen net climb over a distance, m."""
    if unseen <= 0.0:
        return 0.0
    return net_climb(unseen) * _as_friction(unseen) / unseen


def _as_friction(unseen: float) -> float:
    return min(MOST_AS_FRICTION, CLIMB_AS_FRICTION * unseen)


def net_climb(unseen: float) -> float:
    """1-sigma of the net climb, m, of a road of unknown height and this length, m."""
    return min(STEEP * unseen, NET_CLIMB * math.sqrt(1.0 - math.exp(-unseen / HILL)))


def _unseen_climb(energy: np.ndarray, unseen: float) -> np.ndarray:
    """Share of an unseen net climb that appears in each part, shape (COUNT,), sum 0."""
    friction = _as_friction(unseen)
    air, tyres = np.maximum(energy[[Part.AIR, Part.TYRES]], 0.0) + 1.0
    shares = np.zeros(COUNT)
    shares[Part.SLOPE] = 1.0
    shares[[Part.AIR, Part.TYRES]] = -friction * np.array([air, tyres]) / (air + tyres)
    shares[[Part.BRAKES, Part.STANDING]] = -CLIMB_AS_BRAKES, -CLIMB_AS_STANDING
    shares[Part.DRIVETRAIN] = -shares[WHOLE].sum()
    return shares
