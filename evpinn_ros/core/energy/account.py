"""One car's account of energy: since reset and since ever, per kilometre, and what is left.

It joins the meter to distance and to the state of charge, and is what outlives a restart. What
arrives is kept until somebody asks, and then counted at once, as a block; how it is cut into
blocks changes nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
import math
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from evpinn_ros.common.saved_fields import Range, Saveable
from evpinn_ros.core.energy.battery_model import BatteryModel, SavedBattery
from evpinn_ros.core.energy.charge import UNKNOWN, ChargeGauge, SavedGauge, Uncertain
from evpinn_ros.core.energy.dropout import Dropout, Reconciled, Verdict, reconcile
from evpinn_ros.core.energy.forecast import Forecast
from evpinn_ros.core.energy.meter import (
    NO_STATES,
    NOTHING,
    EnergyMeter,
    EnergyState,
    MeterCourse,
    PowerBlock,
    SavedMeter,
)
from evpinn_ros.core.energy.plan import Plan
from evpinn_ros.core.energy.plausible import MOST_ENERGY, Joules, Metres, Seconds
from evpinn_ros.core.energy.remaining import (
    SHORTEST,
    Cost,
    Remaining,
    Route,
    cost_spread,
    remaining,
)
from evpinn_ros.core.energy.trip import WINDOWS, SavedTrip, Stretch, TripLog
from evpinn_ros.core.signals.admission import ANY_CAR, MAX_POWER, Admission, CarLimits
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

STATE_VERSION = 1
LEAST_DISTANCE = 1e3  # m; what a kilometre costs is not known before one
SUMMARY_NS = NANOSECONDS  # between two summaries


class EnergyTotals(NamedTuple):
    """Totals counted over some time.

    Attributes:
        drawn: J.
        regenerated: as positive J.
        variance: of the net energy, J^2.
        distance: m.
        driven: net energy of the time in which distance is known, J.
        unmeasured_s: time that the battery was silent, s.
        unknown_s: the part of it that speed was silent too, s.
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
        """Both together."""
        return EnergyTotals(*(a + b for a, b in zip(self, other, strict=True)))

    def not_below(self, before: EnergyTotals) -> EnergyTotals:
        """Give totals of this net energy, with at least as much drawn and regenerated as before.

        What a prediction counted between two words of the battery is put right by the second:
        for some seconds less may have been drawn than was shown.
        """
        more = max(before.drawn - self.drawn, before.regenerated - self.regenerated, 0.0)
        return self._replace(drawn=self.drawn + more, regenerated=self.regenerated + more)


class TripCorrection(NamedTuple):
    """Energy that reconciling added to a trip, J, and what it took of its variance, J^2."""

    energy: Joules = 0.0
    variance: Annotated[float, Range(-(MOST_ENERGY**2), MOST_ENERGY**2)] = 0.0


@dataclass(frozen=True, slots=True)
class SavedAccount:
    """State that outlives a restart: this trip, and what was counted `before_reset`.

    Attributes:
        charge_before: the last state of charge received while the battery was measured.
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
        since_reset: what was counted since the last reset.
        lifetime: what was counted since ever; what it drew and regenerated never falls.
        consumption: energy per distance, J/m, by `1`, `10`, `100` (the last so many km), `trip`
            and `lifetime`; what is not known yet is not among them.
        charge: state of charge, 0..1; its value NaN while unknown, and so below.
        projected: whether that is no reading but follows from the energy taken since.
        capacity: energy of the full battery, J.
        usable: energy left in it, J.
        remaining: distance to empty, None while it is unknown.
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


PowerColumns: TypeAlias = Sequence[np.ndarray]


class _Kind(IntEnum):
    """Kind of what arrives."""

    PREDICTED = 0
    MEASURED = 1
    SPEED = 2
    BATTERY = 3


_POWERS = _Kind.PREDICTED, _Kind.MEASURED


class _Correction(NamedTuple):
    """A correction, and the place in the order of arrival from which it counts."""

    order: int
    found: TripCorrection


class _Arrived:
    """What has arrived and is not counted yet, by kind, in one order."""

    def __init__(self) -> None:
        self._columns: list[list[tuple[np.ndarray, ...]]] = [[] for _ in _Kind]
        self._next = 0

    def __len__(self) -> int:
        return self._next

    def extend(
        self, kind: _Kind, orders: np.ndarray, stamps: np.ndarray, rows: np.ndarray
    ) -> None:
        """Take n of a kind at their places behind what came before; rows: shape (width, n)."""
        if len(orders):
            self._columns[kind].append((orders + self._next, stamps, rows))

    def move_on(self, count: int) -> None:
        """Let what comes stand behind so many places more."""
        self._next += count

    def add(self, kind: _Kind, stamp_ns: int, row: tuple[float, ...]) -> None:
        """Take one."""
        stamps = np.array([stamp_ns], np.int64)
        self.extend(kind, np.zeros(1, np.int64), stamps, np.array(row)[:, None])
        self.move_on(1)

    @property
    def first_ns(self) -> int:
        """The first stamp of a power that came."""
        firsts = [self._columns[kind][0] for kind in _POWERS if self._columns[kind]]
        return int(min(firsts, key=lambda column: column[0][0])[1][0])

    def columns(self, kind: _Kind, width: int) -> Iterator[np.ndarray]:
        """Order, stamps and the columns of rows of a kind, shape (n,) each."""
        if not self._columns[kind]:
            yield from (np.empty(0, np.int64), np.empty(0, np.int64), *np.empty((width, 0)))
            return
        orders, stamps, rows = zip(*self._columns[kind], strict=True)
        yield np.concatenate(orders)
        yield np.concatenate(stamps)
        yield from np.concatenate(rows, axis=1)


AT_ONCE = 1000  # places of a block from which on its readings do not wait
PLACES = 4  # for each reading: itself, what it measures, and what is predicted with it


class EnergyAccount(Saveable[SavedAccount]):
    """Counts the energy of one car; knows no ROS.

    Attributes:
        meter: integrates power, since the last reset.
        gauge: state of charge and capacity.
        reconciled: of the last battery dropout that ended, None before.
        usual: `remaining.usual_cost`, J/m, NaN if unknown; who learns the car sets it.
        route: of the last plan (`follow`), None before any.
        admission: admits readings, and counts those that it refuses.
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
            meter: to be used here alone.
            vehicle: whose account this is; that of another car is refused.
            capacity: energy of the full battery in the vehicle file, J, NaN if unknown.
            limits: of the car.
        """
        self.meter, self.gauge = meter, ChargeGauge(capacity)
        self._battery = BatteryModel(capacity)
        # What the trip and the battery are extended by once somebody asks for them.
        self._driven: list[tuple[np.ndarray, ...]] = []
        self._told: list[tuple[np.ndarray, ...]] = []
        self.usual = math.nan
        self._vehicle = vehicle
        self.admission = Admission(limits)
        self.reset()

    @property
    def refused(self) -> Counter[str]:
        """Readings and powers of what the car cannot do, by reason, since the process began."""
        return self.admission.refused

    def reset(self) -> None:
        """Forget all, as if nothing had ever been counted."""
        self._shown = EnergyTotals()  # of the lifetime, last published
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
        self.reconciled: Reconciled | None = None
        self._arrived = _Arrived()
        self._awaits_charge: tuple[Dropout, float] | None = None
        self._charge_before = math.nan  # the last one received while the battery was measured

    def reset_trip(self) -> None:
        """Count from zero; the lifetime, what was learned and the last kilometres stay."""
        lifetime, newest_ns = self.lifetime(), self._newest_ns
        self.meter.reset()
        self.trip.reset_trip()
        self._begin(lifetime, TripCorrection())
        self._newest_ns = newest_ns

    def begin_after_jump(self) -> None:
        """Keep all that was counted, and join nothing to what comes: time jumped."""
        self.admission.begin_anew()
        saved = self.saved()
        meter = replace(saved.meter, until_ns=0)
        self.take(replace(saved, meter=meter, charge_before=math.nan))

    def begin_readings_anew(self) -> None:
        """Join no speed and no battery reading to those before: their time jumped."""
        self._count()
        self.admission.begin_anew()
        self.trip.begin_anew()
        self.battery.begin_anew()
        self.gauge.begin_anew()

    def begin_next_trip(self) -> None:
        """Begin as after a jump of time, and count the trip from zero; the lifetime goes on."""
        self.begin_after_jump()
        self.route = None
        self.reset_trip()

    def add_measured(self, stamp_ns: int, power: float, sigma: float) -> None:
        """Take one measurement of power and its 1-sigma, W, NaN if unknown."""
        if not _is_possible(power, sigma, self.admission.limits.power):
            self.refused["power_out_of_range"] += 1
            return
        self._arrived.add(_Kind.MEASURED, stamp_ns, (power, sigma, math.nan, math.nan))

    def add_predicted(
        self,
        stamp_ns: int,
        power: float,
        sigma: float,
        energy_sigma: float = math.nan,
        energy: float = math.nan,
    ) -> bool:
        """Take one prediction of power (see `PowerBlock`); gives whether it can be one."""
        if not _is_possible(power, sigma, MAX_POWER):
            self.refused["power_out_of_range"] += 1
            return False
        self._arrived.add(_Kind.PREDICTED, stamp_ns, (power, sigma, energy_sigma, energy))
        return True

    def add_block(
        self, block: Block, measured: PowerColumns, predicted: PowerColumns
    ) -> np.ndarray:
        """Take admitted readings, and the powers that the estimator has of them.

        Gives the places of the predictions that count.

        Args:
            block: of the readings.
            measured: places, stamps, power and 1-sigma, W.
            predicted: the same, and 1-sigma and energy of a dropout (see `PowerBlock`), J.
        """
        speeds, battery = block.of_kind(SpeedReading), block.of_kind(BatteryReading)
        arrived, limit = self._arrived, self.admission.limits.power
        arrived.extend(_Kind.SPEED, PLACES * speeds.order, speeds.stamps, speeds.values[:1])
        arrived.extend(_Kind.BATTERY, PLACES * battery.order, battery.stamps, battery.values[:3])
        given = ((_Kind.MEASURED, 1, measured, limit), (_Kind.PREDICTED, 2, predicted, MAX_POWER))
        for kind, turn, (orders, stamps, *columns), most in given:
            rows = np.full((4, len(orders)), np.nan)
            rows[: len(columns)] = columns
            possible = _is_possible(rows[0], rows[1], most)
            if refused := len(orders) - int(np.count_nonzero(possible)):
                self.refused["power_out_of_range"] += refused
            orders = PLACES * orders[possible] + turn
            arrived.extend(kind, orders, stamps[possible], rows[:, possible])
        arrived.move_on(PLACES * block.length)
        return np.asarray(predicted[0][possible])

    def add_speed(self, stamp_ns: int, speed: float) -> None:
        """Take a speed, m/s, of an admitted reading."""
        self._arrived.add(_Kind.SPEED, stamp_ns, (speed,))

    def add_reading(self, reading: Reading) -> None:
        """Take an admitted speed, or what the battery tells of itself; others count nothing."""
        if isinstance(reading, SpeedReading):
            self.add_speed(reading.stamp_ns, reading.speed)
        elif isinstance(reading, BatteryReading):
            values = reading.voltage, reading.current, reading.state_of_charge
            self._arrived.add(_Kind.BATTERY, reading.stamp_ns, values)

    def count(self) -> EnergyState:
        """Count what has arrived; gives the states at each prediction of it."""
        if not self._arrived:
            return NO_STATES
        corrections, course = self._count(), self.meter.course
        states = course.states(course.at_predictions())
        return self._corrected(states, course.predicted, corrections)

    def _count(self) -> list[_Correction]:
        """Count what has arrived; gives what was corrected."""
        if not self._arrived:
            return []
        arrived, self._arrived = self._arrived, _Arrived()
        predicted, measured = (PowerBlock(*arrived.columns(kind, 4)) for kind in _POWERS)
        course = self.meter.add(predicted, measured)
        if len(predicted.order) or len(measured.order):
            self._newest_ns = max(self._newest_ns, int(course.newest(course.end)[0]))
            if self.route is not None:
                self.route.see(arrived.first_ns)
        order, stamps, speeds = arrived.columns(_Kind.SPEED, 1)
        if len(order):
            energies, _, _ = course.consumed(course.before(order))
            self._driven.append((stamps, speeds, energies))
        corrections = self._charged(course, *arrived.columns(_Kind.BATTERY, 3))
        if len(arrived) >= AT_ONCE:
            self._extend()
        return corrections

    def _extend(self) -> None:
        """Let trip and battery take what waits, which costs as much as a row of it."""
        for log, waiting in ((self._trip, self._driven), (self._battery, self._told)):
            if waiting:
                log.extend(*map(np.concatenate, zip(*waiting, strict=True)))
                waiting.clear()

    @property
    def trip(self) -> TripLog:
        """Distance and consumption."""
        self._extend()
        return self._trip

    @property
    def battery(self) -> BatteryModel:
        """The battery's charge and voltage, for the end of a plan."""
        self._extend()
        return self._battery

    def _corrected(
        self, states: EnergyState, predicted: PowerBlock, later: Sequence[_Correction]
    ) -> EnergyState:
        """States with what reconciling had added by then."""
        energy = np.full(len(states.stamp_ns), self._correction.energy)
        variance = np.full(len(states.stamp_ns), self._correction.variance)
        for order, correction in later:
            before = predicted.order < order
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
        order: np.ndarray,
        stamps: np.ndarray,
        voltage: np.ndarray,
        current: np.ndarray,
        charge: np.ndarray,
    ) -> list[_Correction]:
        """Take battery readings; gives what dropouts were corrected by, and when."""
        if not (len(order) or course.ended):
            return []
        self._told.append((stamps, voltage, current, charge))
        told = np.flatnonzero((charge >= 0.0) & (charge <= 1.0))
        if not (len(told) or course.ended):
            return []
        order, stamps, charge = order[told], stamps[told], charge[told]
        at = course.before(order)
        consumed, variances, unmeasured_s = course.consumed(at)
        silent = course.silent(at, course.silent_s(at, stamps))
        heard = np.append(self._charge_before, charge[~silent])
        told = np.searchsorted(order[~silent], [place for place, _ in course.ended])
        ends = list(zip(course.ended, heard[told].tolist(), strict=True))
        corrections: list[_Correction] = []
        before = self._before_reset
        for row, place in enumerate(order.tolist()):
            while ends and ends[0][0][0] < place:
                (_, ended), before_it = ends.pop(0)
                self._end(ended, before_it)
            level, stamp_ns = float(charge[row]), int(stamps[row])
            if self._awaits_charge is not None and stamp_ns >= self._awaits_charge[0].end_ns:
                added = self._reconcile(*self._awaits_charge, level)
                corrections.append(_Correction(place, added))
                self._awaits_charge = None
            seconds = None if silent[row] else before.unmeasured_s + float(unmeasured_s[row])
            if row + 1 < len(order) and not self.gauge.is_new(level, seconds):
                continue
            net = before.net.value + float(consumed[row]) + self._correction.energy
            variance = max(float(variances[row]) - self._correction.variance, 0.0)
            sigma = math.sqrt(before.variance + variance)
            self.gauge.update(stamp_ns, level, Uncertain(net, sigma), seconds)
        for (_, ended), before_it in ends:
            self._end(ended, before_it)
        self._charge_before = float(heard[-1])
        return corrections

    def _end(self, dropout: Dropout, charge: float) -> None:
        """A dropout ended, before which the state of charge was this."""
        self.reconciled = reconcile(dropout, UNKNOWN)
        self._awaits_charge = dropout, charge

    def _reconcile(self, dropout: Dropout, before: float, after: float) -> TripCorrection:
        """Join a dropout with its states of charge, unless no car can do what they say."""
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
        """The meter's, with what reconciling added."""
        self._count()
        course = self.meter.course
        return next(self._corrected(course.states(course.end), NOTHING, ()).rows())

    @property
    def measuring(self) -> bool:
        """True if the battery was measured within its timeout."""
        self._count()
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
        self._count()
        return self._before_reset.distance + self.trip.total.distance

    def follow(self, plan: Plan, forecast: Forecast) -> None:
        """Take a plan for the route that the car follows from here on.

        A plan shorter than `SHORTEST` is the horizon of a controller and changes nothing.
        """
        self._count()
        if plan.distance[-1] - plan.distance[0] >= SHORTEST:
            self.route = Route.from_here(plan, forecast, self.odometer, self._newest_ns)

    def lifetime(self) -> EnergyTotals:
        """Totals since the first start."""
        return self._before_reset.plus(self.since_reset())

    def charge(self) -> Uncertain:
        """State of charge now, 0..1, its value NaN while unknown."""
        self._count()
        return self.gauge.charge(self._newest_ns, self.lifetime().net)

    def tick(self) -> AccountSummary | None:
        """The summary, when the last is a second of stamps old."""
        self._count()
        if self._newest_ns - self._summary_ns < SUMMARY_NS:
            return None
        self._summary_ns = self._newest_ns
        return self.show()

    def summaries(self, measured: PowerColumns, predicted: PowerColumns) -> list[int]:
        """Places of a block at whose predictions a summary is due; the columns of `add_block`."""
        orders = np.concatenate((measured[0], predicted[0]))
        sequence = np.argsort(orders, kind="stable")
        stamps = np.concatenate((measured[1], predicted[1]))[sequence]
        newest = np.maximum.accumulate(np.append(self._newest_ns, stamps))[1:]
        shows = (sequence >= len(measured[0])) & np.append(np.diff(orders[sequence]) > 0, True)
        newest, places = newest[shows], orders[sequence][shows]
        due, last_ns, index = [], self._summary_ns, 0
        while (index := int(np.searchsorted(newest, last_ns + SUMMARY_NS))) < len(newest):
            due.append(int(places[index]))
            last_ns = int(newest[index])
        return due

    def show(self) -> AccountSummary:
        """The account now, to be published: no later lifetime draws or regenerates less."""
        summary = self.summary()
        self._shown = summary.lifetime
        return summary

    def summary(self) -> AccountSummary:
        """The account now, for a look at it."""
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
        """It needs what the last 10 km cost; the long run is 100 km, or all so far.

        On a route before that, the usual legs say what the road beyond it costs; while none are
        known, a route of 10 km does.
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
        """The route that the car follows, unless it is over."""
        route = self.route
        over = route is None or route.left(self.odometer, self._newest_ns) <= 0.0
        return None if over else route

    def saved(self) -> SavedAccount:
        """State to save."""
        self._count()
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
        """Go on from a saved account; after a ValueError it is not to be used before `reset`."""
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
    """Whether power and its 1-sigma, W, may be counted; a sigma may be NaN, unknown."""
    unknown = np.isnan(sigma)
    return (np.abs(power) <= most) & (unknown | ((sigma >= 0.0) & (sigma <= MAX_POWER)))
