"""One car's account: energy since reset and of the lifetime, per kilometre, and left to drive.

It joins the meter to distance and to the state of charge, and survives a restart. Readings wait
for the predictions of their time, and are then counted in order of stamps; how they are cut into
blocks changes nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.energy.battery_model import BatteryModel, SavedBattery
from evpinn_ros.core.energy.charge import UNKNOWN, ChargeGauge, SavedGauge, Uncertain
from evpinn_ros.core.energy.dropout import Dropout, Reconciled, Verdict, reconcile
from evpinn_ros.core.energy.forecast import EnergyCurve
from evpinn_ros.core.energy.meter import (
    NO_STATES,
    EnergyMeter,
    EnergyState,
    MeterCourse,
    SavedMeter,
)
from evpinn_ros.core.energy.plausible import MOST_ENERGY, Joules, Metres, Seconds
from evpinn_ros.core.energy.quadrature import MAX_GAP
from evpinn_ros.core.energy.remaining import (
    SHORTEST,
    Cost,
    Remaining,
    Route,
    cost_spread,
    remaining,
)
from evpinn_ros.core.energy.trip import WINDOWS, SavedTrip, Stretch, TripLog
from evpinn_ros.core.estimation.estimate import PowerEstimate, PowerKind
from evpinn_ros.core.estimation.outputs import PowerRows
from evpinn_ros.core.signals.admission import ANY_CAR, MAX_POWER, Admission, CarLimits
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    Reading,
    SpeedReading,
)
from evpinn_ros.core.signals.track import LATER, NEVER

STATE_VERSION = 1
NO_STAMPS = np.empty(0, np.int64)
LEAST_DISTANCE = 1e3  # m; over less, consumption is unknown
SUMMARY_NS = NANOSECONDS  # between two summaries


class EnergyTotals(NamedTuple):
    """Totals of a trip or of the lifetime.

    Attributes:
        drawn: J.
        regenerated: as positive J.
        variance: of the net energy, J^2.
        distance: m.
        driven: net energy while distance was known, J.
        unmeasured_s: time in which the battery was silent, s.
        unknown_s: the part of it in which speed was silent too, s.
    """

    drawn: Joules = 0.0
    regenerated: Joules = 0.0
    variance: Annotated[float, Range(0.0, MOST_ENERGY**2, unknown=True)] = 0.0
    distance: Metres = 0.0
    driven: Joules = 0.0
    unmeasured_s: Seconds = 0.0
    unknown_s: Seconds = 0.0

    @property
    def net(self) -> Uncertain:
        """Drawn less regenerated energy, J."""
        return Uncertain(self.drawn - self.regenerated, math.sqrt(self.variance))

    def plus(self, other: EnergyTotals) -> EnergyTotals:
        """The sum of both, field by field."""
        return EnergyTotals(*(a + b for a, b in zip(self, other, strict=True)))

    def not_below(self, before: EnergyTotals) -> EnergyTotals:
        """Totals of this net energy that draw and regenerate at least as much as `before`.

        A late measurement can lower the total that was predicted for the same time.
        """
        more = max(before.drawn - self.drawn, before.regenerated - self.regenerated, 0.0)
        return self._replace(drawn=self.drawn + more, regenerated=self.regenerated + more)


class TripCorrection(NamedTuple):
    """Energy that reconciled dropouts added to a trip, J, and variance that they removed, J^2."""

    energy: Joules = 0.0
    variance: Annotated[float, Range(-(MOST_ENERGY**2), MOST_ENERGY**2)] = 0.0


@dataclass(frozen=True, slots=True)
class SavedAccount:
    """State that outlives a restart: this trip, and the totals `before_reset`.

    Attributes:
        charge_before: last state of charge received while the battery was measured.
    """

    SAME = ("version", "vehicle")

    version: int
    vehicle: str
    meter: SavedMeter
    trip: SavedTrip
    charge: SavedGauge
    correction: TripCorrection
    before_reset: EnergyTotals
    battery: SavedBattery | None = None
    shown: EnergyTotals | None = None
    route: Route | None = None
    charge_before: Annotated[float, Range(0.0, 1.0, unknown=True)] = math.nan


@dataclass(frozen=True, slots=True)
class AccountSummary:
    """The account at one moment.

    Attributes:
        stamp_ns: newest stamp of power.
        since_reset: totals since the last reset.
        lifetime: totals since the first start; drawn and regenerated energy never falls.
        consumption: energy per distance, J/m, by `1`, `10`, `100` (the last so many km), `trip`
            and `lifetime`; unknown ones are left out.
        charge: state of charge, 0..1; the value is NaN while unknown, as those below.
        projected: True if `charge` follows from the energy taken since its last reading.
        capacity: energy of the full battery, J.
        usable: energy left in the battery, J.
        remaining: distance to empty, None while unknown.
    """

    stamp_ns: int
    since_reset: EnergyTotals
    lifetime: EnergyTotals
    consumption: Mapping[str, float]
    charge: Uncertain
    projected: bool
    capacity: Uncertain
    usable: Uncertain
    remaining: Remaining | None


class _Kind(IntEnum):
    """Kind of a counted row."""

    PREDICTED = 0
    MEASURED = 1
    SPEED = 2
    BATTERY = 3


WIDTHS = {_Kind.PREDICTED: 4, _Kind.MEASURED: 4, _Kind.SPEED: 1, _Kind.BATTERY: 3}
AHEAD_NS = 3 * NANOSECONDS  # by which readings may be ahead of predictions and wait for them
EXTENDED_AT = 1000  # speeds and battery readings that trip and battery model take at once


class _Correction(NamedTuple):
    """A correction, and the first stamp at which it counts."""

    stamp_ns: int
    added: TripCorrection


class _Columns(NamedTuple):
    """Stamps, ns, shape (n,), and values, shape (width, n)."""

    stamps: np.ndarray
    values: np.ndarray


class _Waiting:
    """Readings and powers that are not counted yet, by kind."""

    def __init__(self) -> None:
        self._new: dict[_Kind, list[_Columns]] = {kind: [] for kind in _Kind}
        # Stamp and values of rows that came one by one; many at once become arrays.
        self._rows: dict[_Kind, list[tuple[float, ...]]] = {kind: [] for kind in _Kind}
        self.newest_ns = dict.fromkeys(_Kind, NEVER)

    def add(self, kind: _Kind, stamps: np.ndarray, values: np.ndarray) -> None:
        """Add n rows of a kind; values: shape (width, n)."""
        if len(stamps):
            self._new[kind].append(_Columns(stamps, values))
            self.newest_ns[kind] = max(self.newest_ns[kind], int(stamps.max()))

    def __bool__(self) -> bool:
        return any(self._new.values()) or any(self._rows.values())

    def add_row(self, kind: _Kind, stamp_ns: int, *values: float) -> None:
        """Add one row of a kind."""
        self._rows[kind].append((stamp_ns, *values))
        if stamp_ns > self.newest_ns[kind]:
            self.newest_ns[kind] = stamp_ns

    def sorted(self, kind: _Kind) -> _Columns:
        """All rows of a kind, in order of stamps."""
        new = self._new[kind]
        if rows := self._rows[kind]:
            moments, *columns = zip(*rows, strict=True)
            new.append(_Columns(np.array(moments, np.int64), np.array(columns)))
            rows.clear()
        if not new:
            return _Columns(np.empty(0, np.int64), np.empty((WIDTHS[kind], 0)))
        if len(new) > 1:
            stamps, values = zip(*new, strict=True)
            new[:] = [_Columns(np.concatenate(stamps), np.concatenate(values, axis=1))]
        stamps, values = new[0]
        if not (stamps[1:] > stamps[:-1]).all():
            order = stamps.argsort(kind="stable")
            new[0] = _Columns(stamps[order], values[:, order])
        return new[0]

    def taken(self, kind: _Kind, until_ns: int) -> _Columns:
        """Remove and return the rows of a kind up to a stamp."""
        stamps, values = self.sorted(kind)
        count = int(stamps.searchsorted(until_ns, side="right"))
        if count:
            rest = _Columns(stamps[count:], values[:, count:])
            self._new[kind] = [rest] if len(rest.stamps) else []
        return _Columns(stamps[:count], values[:, :count])


class EnergyAccount(Saveable[SavedAccount]):
    """Counts the energy of one car; knows no ROS.

    Attributes:
        meter: integrates power, since the last reset.
        gauge: state of charge and capacity.
        reconciled: outcome of the last battery dropout that ended, None before.
        usual: `remaining.usual_cost`, J/m, NaN if unknown; the owner sets it.
        route: of the last plan (`follow`), None before any.
        admission: admits readings, and counts refused ones.
    """

    def __init__(
        self,
        meter: EnergyMeter,
        vehicle: str,
        capacity: float,
        limits: CarLimits = ANY_CAR,
    ) -> None:
        """Start at zero.

        Args:
            meter: not shared with others.
            vehicle: key of the car; a saved account of another car is refused.
            capacity: energy of the full battery in the vehicle file, J, NaN if unknown.
            limits: of the car.
        """
        self.meter, self.gauge = meter, ChargeGauge(capacity)
        self._battery = BatteryModel(capacity)
        # Readings that trip and battery have not taken yet.
        self._driven: list[tuple[np.ndarray, ...]] = []
        self._charges: list[tuple[np.ndarray, ...]] = []
        self.usual = math.nan
        self._vehicle = vehicle
        self.admission = Admission(limits)
        self.reset()

    @property
    def refused(self) -> Counter[str]:
        """Counts of refused readings and powers, by reason, since the process began."""
        return self.admission.refused

    def reset(self) -> None:
        """Forget everything, lifetime included."""
        self._shown = EnergyTotals()  # lifetime as last published
        self.meter.reset()
        self._trip = TripLog()
        self._driven.clear()
        self.gauge.reset()
        self.battery.reset()
        self.route: Route | None = None
        self._begin(EnergyTotals(), TripCorrection())

    def _begin(self, before: EnergyTotals, correction: TripCorrection) -> None:
        self._before_reset, self._correction = before, correction
        self._newest_ns = self._summary_ns = 0
        self._speed = NEVER, 0.0  # newest stamp and speed, m/s
        self.reconciled: Reconciled | None = None
        self._waiting = _Waiting()
        self._awaits_charge: tuple[Dropout, float] | None = None
        self._charge_before = math.nan  # see `SavedAccount`

    def reset_trip(self) -> None:
        """Count the trip from zero; lifetime, capacity and the last kilometres stay."""
        self.flush()
        lifetime, newest_ns = self.lifetime(), self._newest_ns
        self.meter.reset()
        self.trip.reset_trip()
        self._begin(lifetime, TripCorrection())
        self._newest_ns = newest_ns

    def begin_after_jump(self) -> None:
        """After a jump of time: keep the totals; join no later reading to earlier ones."""
        self.flush()
        self.admission.begin_anew()
        saved = self.saved()
        meter = replace(saved.meter, until_ns=0)
        self.take(replace(saved, meter=meter, charge_before=math.nan))

    def begin_readings_anew(self) -> None:
        """After a jump of the readings' time: join no speed or battery reading to earlier ones."""
        self._count_readings(replace(self.meter.course, ended=()), LATER)
        self._waiting.newest_ns |= {_Kind.SPEED: NEVER, _Kind.BATTERY: NEVER}
        self.admission.begin_anew()
        self.trip.begin_anew()
        self.battery.begin_anew()
        self.gauge.begin_anew()

    def begin_next_trip(self) -> None:
        """Count the trip from zero, without a route; join no later reading to earlier ones."""
        self.begin_after_jump()
        self.route = None
        self.reset_trip()

    def add_measured(self, stamps: np.ndarray, power: np.ndarray, sigma: np.ndarray) -> None:
        """Add n measurements: stamps, ns, power and its 1-sigma, W, NaN if unknown."""
        self._add_powers(_Kind.MEASURED, self.admission.limits.power, stamps, power, sigma)

    def add_predicted(
        self,
        stamps: np.ndarray,
        power: np.ndarray,
        sigma: np.ndarray,
        energy_sigma: np.ndarray,
        energy: np.ndarray,
    ) -> None:
        """Add n predictions (see `PowerRows`)."""
        columns = power, sigma, energy, energy_sigma
        self._add_powers(_Kind.PREDICTED, MAX_POWER, stamps, *columns)

    def add_power(self, estimate: PowerEstimate) -> None:
        """Add one power of the estimator."""
        power, sigma = estimate.power, estimate.sigma
        values = power, sigma, estimate.energy, estimate.energy_sigma
        is_measured = estimate.kind is PowerKind.MEASURED
        if _is_possible(power, sigma, self.admission.limits.power if is_measured else MAX_POWER):
            kind = _Kind.MEASURED if is_measured else _Kind.PREDICTED
            self._waiting.add_row(kind, estimate.stamp_ns, *values)
        else:
            self.refused["power_out_of_range"] += 1

    def _add_powers(
        self, kind: _Kind, most: float, stamps: np.ndarray, *columns: np.ndarray
    ) -> None:
        """Add the powers, W, that are possible; count the others."""
        values = np.full((WIDTHS[kind], len(stamps)), np.nan)
        values[: len(columns)] = columns
        possible = _is_possible(values[0], values[1], most)
        if not possible.all():
            self.refused["power_out_of_range"] += int(np.count_nonzero(~possible))
            stamps, values = stamps[possible], values[:, possible]
        self._waiting.add(kind, stamps, values)

    def add_block(self, block: Block) -> None:
        """Add the speed and battery readings of a block; all were admitted."""
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        self._waiting.add(_Kind.SPEED, speeds.stamps, speeds.values[:1])
        self._waiting.add(_Kind.BATTERY, battery.stamps, battery.values[:3])

    def add_reading(self, reading: Reading) -> None:
        """Add one admitted reading."""
        if isinstance(reading, SpeedReading):
            self._waiting.add_row(_Kind.SPEED, reading.stamp_ns, reading.speed)
        elif isinstance(reading, BatteryReading):
            values = reading.voltage, reading.current, reading.state_of_charge
            self._waiting.add_row(_Kind.BATTERY, reading.stamp_ns, *values)

    @property
    def _until_ns(self) -> int:
        """Stamp up to which rows are counted: newest prediction, or newest row less `AHEAD_NS`."""
        newest_ns = self._waiting.newest_ns
        return max(newest_ns[_Kind.PREDICTED], max(newest_ns.values()) - AHEAD_NS)

    def summary_due_ns(self) -> int:
        """Stamp of the first waiting prediction at which a summary is due, or `LATER`."""
        stamps = self._waiting.sorted(_Kind.PREDICTED).stamps
        place = int(stamps.searchsorted(self._summary_ns + SUMMARY_NS))
        return int(stamps[place]) if place < len(stamps) else LATER

    def count(self, until_ns: int = LATER) -> EnergyState:
        """Count waiting rows up to a stamp; returns the states at each prediction."""
        if not self._waiting:
            return NO_STATES
        corrections, course = self._count(min(until_ns, self._until_ns)), self.meter.course
        if not len(course.predicted.stamp_ns):
            return NO_STATES
        states = course.states(course.up_to(course.predicted.stamp_ns))
        return self._corrected(states, course.predicted.stamp_ns, corrections)

    def flush(self) -> EnergyState:
        """Count all waiting rows, at the end of a drive or before saving."""
        self._waiting.newest_ns[_Kind.PREDICTED] = max(self._waiting.newest_ns.values())
        return self.count()

    def _count(self, until_ns: int) -> list[_Correction]:
        """Count waiting rows up to a stamp; returns the corrections."""
        predicted, measured = (
            PowerRows(stamps, stamps, *values)
            for stamps, values in (
                self._waiting.taken(kind, until_ns) for kind in (_Kind.PREDICTED, _Kind.MEASURED)
            )
        )
        course = self.meter.add(predicted, measured)
        newest = [block.stamp_ns[-1] for block in (predicted, measured) if len(block.stamp_ns)]
        if newest:
            self._newest_ns = max(self._newest_ns, *map(int, newest))
            if self.route is not None:
                self.route.see(min(int(b.stamp_ns[0]) for b in (predicted, measured) if len(b[0])))
        return self._count_readings(course, until_ns)

    def _count_readings(self, course: MeterCourse, until_ns: int) -> list[_Correction]:
        """Count the readings up to a stamp, by the course of the meter; returns corrections."""
        stamps, (speeds,) = self._waiting.taken(_Kind.SPEED, until_ns)
        if len(stamps):
            energies, _, _ = course.consumed(course.up_to(stamps))
            self._driven.append((stamps, speeds, energies))
            self._speed = int(stamps[-1]), abs(float(speeds[-1]))
        battery = self._waiting.taken(_Kind.BATTERY, until_ns)
        corrections = self._charged(course, battery.stamps, *battery.values)
        if len(stamps) + len(battery.stamps) >= EXTENDED_AT:
            self._extend()
        return corrections

    def _extend(self) -> None:
        """Give trip and battery their waiting readings: many cost as much as one."""
        for log, waiting in ((self._trip, self._driven), (self._battery, self._charges)):
            if waiting:
                log.extend(*map(np.concatenate, zip(*waiting, strict=True)))
                waiting.clear()

    @property
    def speed(self) -> float:
        """Newest speed, m/s; 0 if it is silent."""
        stamp_ns, speed = self._speed
        return speed if self._newest_ns - stamp_ns <= MAX_GAP * NANOSECONDS else 0.0

    @property
    def trip(self) -> TripLog:
        """Distance and consumption of the trip, up to the newest reading."""
        self._extend()
        return self._trip

    @property
    def battery(self) -> BatteryModel:
        """The battery's charge and voltage, for the end of a plan."""
        self._extend()
        return self._battery

    def _corrected(
        self, states: EnergyState, stamps: np.ndarray, later: Sequence[_Correction]
    ) -> EnergyState:
        """States with the corrections up to their stamps; `later` ones were made in this block."""
        energy = np.full(len(states.stamp_ns), self._correction.energy)
        variance = np.full(len(states.stamp_ns), self._correction.variance)
        for stamp_ns, correction in later:
            before = stamps < stamp_ns
            energy[before] -= correction.energy
            variance[before] -= correction.variance
        sigma = np.sqrt(np.maximum(states.consumed_sigma**2 - variance, 0.0))
        return replace(
            states,
            consumed=states.consumed + energy,
            consumed_sigma=sigma,
            regenerated=states.regenerated._replace(sigma=sigma),
        )

    def _charged(
        self,
        course: MeterCourse,
        stamps: np.ndarray,
        voltage: np.ndarray,
        current: np.ndarray,
        charge: np.ndarray,
    ) -> list[_Correction]:
        """Count battery readings; returns the corrections of dropouts."""
        if len(stamps):
            self._charges.append((stamps, voltage, current, charge))
        possible = (charge >= 0.0) & (charge <= 1.0)
        stamps, charge = stamps[possible], charge[possible]
        if not (len(stamps) or course.ended):
            return []
        at = course.before(stamps)
        columns = course.consumed(at)
        silent = course.silent(at, course.silent_s(at, stamps))
        # A dropout began at the last charge that came while the battery was measured.
        heard_ns, heard = stamps[~silent], np.append(self._charge_before, charge[~silent])
        begun = heard[heard_ns.searchsorted([dropout.end_ns for dropout in course.ended])]
        self._charge_before = float(heard[-1])
        ends = [*zip(course.ended, begun.tolist(), strict=True)]
        corrections: list[_Correction] = []
        before = self._before_reset
        lists = (column.tolist() for column in (stamps, charge, silent, *columns))
        for number, row in enumerate(zip(*lists, strict=True), start=1):
            stamp_ns, level, is_silent, consumed, variance, unmeasured_s = row
            while ends and ends[0][0].end_ns < stamp_ns:
                self._end(*ends.pop(0))
            if self._awaits_charge is not None and stamp_ns >= self._awaits_charge[0].end_ns:
                added = self._reconcile(*self._awaits_charge, level)
                corrections.append(_Correction(stamp_ns, added))
                self._awaits_charge = None
            seconds = None if is_silent else before.unmeasured_s + unmeasured_s
            # The last reading always counts, because of its stamp.
            if number < len(stamps) and not self.gauge.is_new(level, seconds):
                continue
            net = before.net.value + consumed + self._correction.energy
            variance = max(variance - self._correction.variance, 0.0)
            sigma = math.sqrt(before.variance + variance)
            self.gauge.update(stamp_ns, level, Uncertain(net, sigma), seconds)
        for end in ends:
            self._end(*end)
        return corrections

    def _end(self, dropout: Dropout, charge: float) -> None:
        """End a dropout that began at this state of charge."""
        self.reconciled = reconcile(dropout, UNKNOWN)
        self._awaits_charge = dropout, charge

    def _reconcile(self, dropout: Dropout, before: float, after: float) -> TripCorrection:
        """Reconcile a dropout with the states of charge around it, unless they are impossible."""
        by_charge = self.gauge.energy_between(before, after)
        if not abs(by_charge.value) <= MAX_POWER * dropout.duration:
            by_charge = UNKNOWN
        reconciled = self.reconciled = reconcile(dropout, by_charge)
        if reconciled.verdict is Verdict.JOINED:
            self.trip.correct(reconciled.correction)
        added = TripCorrection(reconciled.correction, reconciled.variance_taken)
        energy, variance = self._correction
        self._correction = TripCorrection(energy + added.energy, variance + added.variance)
        return added

    @property
    def state(self) -> EnergyState:
        """State of the meter with all corrections."""
        course = self.meter.course
        return next(self._corrected(course.states(course.end), NO_STAMPS, ()).rows())

    @property
    def measuring(self) -> bool:
        """True if the battery was measured within its timeout."""
        return self.meter.measuring

    def since_reset(self) -> EnergyTotals:
        """Totals since the last reset."""
        state, stretch = self.state, self.trip.total
        return EnergyTotals(
            drawn=state.consumed + state.regenerated.energy,
            regenerated=state.regenerated.energy,
            variance=state.consumed_sigma**2,
            distance=stretch.distance,
            driven=stretch.energy,
            unmeasured_s=state.unmeasured_s,
            unknown_s=state.unknown_s,
        )

    @property
    def odometer(self) -> float:
        """Distance since the first start, m."""
        return self._before_reset.distance + self.trip.total.distance

    def follow(self, curve: EnergyCurve | None) -> None:
        """Follow the plan of a forecast as the route from here on.

        A plan shorter than `SHORTEST` is the horizon of a controller and changes nothing.
        """
        if curve is not None and curve.distance[-1] >= SHORTEST:
            self.route = Route.from_here(curve, self.odometer, self._newest_ns)

    def lifetime(self) -> EnergyTotals:
        """Totals since the first start."""
        return self._before_reset.plus(self.since_reset())

    def charge(self) -> Uncertain:
        """State of charge now, 0..1, its value NaN while unknown."""
        charge = self._waiting.sorted(_Kind.BATTERY).values[2]
        readings = charge[(charge >= 0.0) & (charge <= 1.0)]
        if len(readings):
            return Uncertain(float(readings[-1]), self.gauge.rounding)
        return self.gauge.charge(self._newest_ns, self.lifetime().net)

    def tick(self) -> AccountSummary | None:
        """The summary if the last one is `SUMMARY_NS` old, else None."""
        return self.show() if self._newest_ns - self._summary_ns >= SUMMARY_NS else None

    def show(self) -> AccountSummary:
        """The summary, to be published: later lifetimes draw and regenerate no less."""
        self._summary_ns = self._newest_ns
        summary = self.summary()
        self._shown = summary.lifetime
        return summary

    def summary(self) -> AccountSummary:
        """The account now; unlike `show`, it changes nothing."""
        since_reset, lifetime = self.since_reset(), self.lifetime().not_below(self._shown)
        charge = self.gauge.charge(self._newest_ns, lifetime.net)
        usable = self.gauge.usable(charge)
        consumption = self._consumption(since_reset, lifetime)
        return AccountSummary(
            self._newest_ns,
            since_reset,
            lifetime,
            consumption,
            charge,
            self.gauge.projected(self._newest_ns),
            self.gauge.capacity,
            usable,
            self._remaining(usable, consumption),
        )

    def _consumption(self, since_reset: EnergyTotals, lifetime: EnergyTotals) -> dict[str, float]:
        stretches = {f"{w.length / 1e3:g}": w.total for w in self.trip.windows if w.known}
        for name, totals in (("trip", since_reset), ("lifetime", lifetime)):
            if totals.distance >= LEAST_DISTANCE:
                stretches[name] = Stretch(totals.distance, totals.driven)
        return {name: stretch.energy / stretch.distance for name, stretch in stretches.items()}

    def _remaining(self, usable: Uncertain, consumption: Mapping[str, float]) -> Remaining | None:
        """Distance to empty, by the cost of the last 10 km and, in the long run, 100 km or all.

        Before 10 km, on a route, the usual legs give the cost beyond it; while these are unknown,
        a route of at least 10 km does.
        """
        route = self._route_ahead()
        recent = consumption.get("10", math.nan if route is None else self.usual)
        if math.isnan(recent) and route is not None and route.distance[-1] >= WINDOWS[1]:
            recent = route.cost
        if math.isnan(recent):
            return None
        long = consumption.get("100", consumption.get("lifetime", recent))
        spread = cost_spread(self.trip.windows[-1].whole)
        cost = Cost.ahead(recent, long, self.usual, spread)
        return remaining(usable, cost if route is None else route.ahead(self.odometer, cost))

    def _route_ahead(self) -> Route | None:
        """The route that the car follows; None once it is over."""
        route = self.route
        over = route is None or route.left(self.odometer, self._newest_ns) <= 0.0
        return None if over else route

    def saved(self) -> SavedAccount:
        """State to save, of the counted rows."""
        return SavedAccount(
            version=STATE_VERSION,
            vehicle=self._vehicle,
            meter=self.meter.saved(),
            trip=self.trip.saved(),
            charge=self.gauge.saved(),
            battery=self.battery.saved(),
            correction=self._correction,
            before_reset=self._before_reset,
            shown=self._shown,
            route=self._route_ahead(),
            charge_before=self._charge_before,
        )

    def take(self, saved: SavedAccount) -> None:
        """Go on from a saved account; after a ValueError call `reset` before any other use."""
        self.meter.take(saved.meter)
        self.trip.take(saved.trip)
        self.gauge.take(saved.charge)
        self._shown, self.route = saved.shown or EnergyTotals(), saved.route
        if saved.battery is None:
            self.battery.reset()
        else:
            self.battery.take(saved.battery)
        self._begin(saved.before_reset, saved.correction)
        self._charge_before = saved.charge_before


def _is_possible(power: Any, sigma: Any, most: float) -> Any:
    """True where power and its 1-sigma, W, are possible; sigma may be NaN."""
    possible = (sigma >= 0.0) & (sigma <= MAX_POWER)
    return (abs(power) <= most) & (possible | (sigma != sigma))
