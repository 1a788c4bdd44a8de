"""Removes values that freeze while the car moves, and zeros in place of measurements.

A frozen value is contradicted by the other signal, by the mass that both show elsewhere, and by
the distance between positions or on the odometer. Where neither speed nor battery was measured
(`unmeasured`), all values are removed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.core.signals.readings import MAX_CURRENT, MAX_SPEED, MAX_VOLTAGE, NANOSECONDS
from evpinn_ros.logs.quantities import PLACES
from evpinn_ros.logs.signal import (
    LEAST_EVENTS,
    LONGEST_STEP,
    FloatArray,
    Signal,
    accelerations,
    at_times,
    battery_power,
    leaps,
    pull,
    speeds_up_and_down,
    steps_of_places,
)
from evpinn_ros.logs.speed_unit import road_of_odometer, road_of_places
from evpinn_ros.logs.unmeasured import (
    LEAST_REPEATS,
    Stand,
    measured_on,
    standing_together,
    straight_together,
)

DRAWN = ("current", "power")
MOST = {"speed": MAX_SPEED, "voltage": MAX_VOLTAGE, "current": MAX_CURRENT}
LARGEST = 1e9  # of any other quantity
SHOWN = {"speed": (3.6, "km/h"), "current": (1.0, "A"), "power": (1.0, "W")}
UNMEASURED = {
    "stand still": standing_together,
    "lie on straight lines": straight_together,
}
LEAST_STAND = 10.0  # s
WINDOW = 15.0  # s; over longer windows a hill looks like speeding up
UNSEEN = 1.0  # m/s^2: swing of power over mass in most windows while the speed is frozen
LONG, UNSEEN_LONG = 60.0, 0.4  # s, m/s^2: no driver or cruise control keeps a speed so constant
DRIVING, STANDING = 8.0, 5.0  # m/s for the threshold of power: least, and for a speed frozen at 0
LEAST_CYCLES, LEAST_RISES = 4, 2  # changes between giving and taking, and to a large power
LEAST_WORK, NO_STANDING_LOAD = 50.0, 15_000.0  # W: above an offset; above any heater
LEAST_TURNS = 2  # changes from giving to taking or back
LEAST_RISE = 10.0  # m/s, or the highest speed if lower: a rise that takes power
FINER = 5.0  # least change of a current, in resolutions
WRONG_WAY, APART = 0.15, 50.0  # share of a distance, and m between positions
LEAST_WAY = 200.0  # m: positions drift while a car stands
OTHER_WAY = 0.3  # logarithm of a ratio of distances that no odometer error explains
OTHER_UNIT = 0.4  # the same for positions, nearer by bends; mph and km/h are 0.48 apart
SLOWEST_UNIT = 1.0 / 3.6  # m/s: of km/h; knots and mph are larger
MOST_ASKED = 1000  # values used to find a resolution
LEAST_ZEROS, ZEROS = 10, 0.25  # stretches of zeros, and their share of the moments of most power
LEAST_LEAPS, MOST_LEAPS = 6, 0.1  # leaps to zero and back, and their share of all steps

Signals = dict[str, Signal]


class FrozenValues:
    """Removes values that were not measured from a drive, block by block; notes them."""

    def __init__(self, dropped: Counter[str]) -> None:
        self._dropped = dropped
        self._zero_ns: int | None = None
        self._filled: set[str] = set()
        self._stands: dict[str, list[tuple[Stand, str]]] = {}
        self._readings, self._zeros = Counter[str](), Counter[str]()
        self._ways: list[float] = []  # distance by the odometer over that by the speed
        self._roads: list[float] = []  # the same of the positions
        self._steps = self._leaps = 0
        self._lost: dict[str, list[Stand]] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on the removed values; complete after the last block."""
        return tuple(self._sentences())

    def drop(
        self, stamps: NDArray[np.int64], values: Mapping[str, FloatArray], rows: NDArray[np.intp]
    ) -> None:
        """Set values of a block that were not measured to NaN.

        Args:
            stamps: of all rows of the block, ns, shape (n,).
            values: of these rows, SI, by quantity, shape (n,) each; modified in place.
            rows: indices of the rows in use, in order of time.
        """
        if "speed" not in values or not rows.size:
            return
        self._zero_ns = int(stamps[rows[0]]) if self._zero_ns is None else self._zero_ns
        time = (stamps[rows] - self._zero_ns) / NANOSECONDS
        signals = _signals(time, values, rows)
        self._filled |= filled(signals)
        for name in ("speed", *DRAWN):
            if name not in signals:
                continue
            self._readings[name] += signals[name].known.size
            if name in self._filled:
                zeros = signals[name].value == 0.0
                values[name][rows[zeros]] = np.nan
                self._zeros[name] += int(zeros.sum())
                self._dropped[f"{name}_sentinel_0"] += int(zeros.sum())
        for how, unmeasured in UNMEASURED.items():
            signals = _signals(time, values, rows)
            for stand in unmeasured(signals):
                inside = (time > stand.begin) & (time <= stand.begin + stand.seconds)
                for name in values.keys() - measured_on(signals, stand):
                    values[name][rows[inside]] = np.nan
                self._dropped[f"both_{how.replace(' ', '_')}"] += int(inside.sum())
                self._lost.setdefault(how, []).append(stand)
        signals = _signals(time, values, rows)
        leapt = leaps(*signals["speed"].points())
        self._steps, self._leaps = self._steps + leapt.size, self._leaps + int(leapt.sum())
        for name, stand, why in _contradicted(signals):
            inside = (time >= stand.begin) & (time <= stand.begin + stand.seconds)
            inside &= np.isfinite(signals[name].value)
            values[name][rows[inside]] = np.nan
            self._dropped[f"{name}_stands_still"] += int(inside.sum())
            self._stands.setdefault(name, []).append((stand, why))
        signals = _signals(time, values, rows)
        for ways, way in (
            (self._ways, road_of_odometer(signals)),
            (self._roads, road_of_places(signals)),
        ):
            ways += [way] if way > 0.0 else []

    def _sentences(self) -> Iterator[str]:
        way = float(np.median(self._ways)) if self._ways else 1.0
        if abs(np.log(way)) > OTHER_WAY:
            yield (
                f"the odometer counts {way:.2g} times the distance that the speed gives, so one "
                "unit is probably wrong; --column speed=NAME:UNIT or odometer=NAME:UNIT sets it"
            )
        road = float(np.median(self._roads)) if self._roads else 1.0
        if abs(np.log(road)) > OTHER_UNIT:
            yield (
                f"the positions are {road:.2g} times as far apart as the speed gives, so its unit "
                "is probably wrong; --column speed=NAME:UNIT sets it"
            )
        if self._leaps > max(LEAST_LEAPS, MOST_LEAPS * self._steps):
            yield (
                f"the speed leaps in {100.0 * self._leaps / self._steps:.0f} % of its steps as no "
                "car does, so doubt all totals: are there rows of several cars, or is its unit "
                "wrong?"
            )
        for how, (lost, *again) in self._lost.items():
            yield (
                f"speed and battery {how} from {lost.begin:.0f} s on for {lost.seconds:.0f} s"
                f"{_more(again)} while the car moves, so nothing is measured there"
            )
        for name, zeros in self._zeros.items():
            share = 100.0 * zeros / self._readings[name]
            yield (
                f"{name}: {share:.0f} % of its values are 0, also while the car accelerates "
                "hardest, so zeros are not used"
            )
        for name, stands in self._stands.items():
            (stand, why), *others = stands
            count = sum(stand.last + 1 - stand.first for stand, _ in stands)
            factor, unit = SHOWN[name]
            value = f"{factor * abs(stand.value):.4g} {unit}"
            if count == self._readings[name] and not others:
                yield f"{name} is always {value} while {why}, so it is not used"
                continue
            yield (
                f"{name} stands still at {value} from {stand.begin:.0f} s on for "
                f"{stand.seconds:.0f} s{_more(others)} while {why}, so it is not used there"
            )


def _more(others: Sequence[object]) -> str:
    return f", and {len(others)} times more" if others else ""


def _signals(
    time: FloatArray, values: Mapping[str, FloatArray], rows: NDArray[np.intp]
) -> Signals:
    signals = {}
    for name, column in values.items():
        value = column[rows]
        possible = np.abs(value) <= MOST.get(name, LARGEST)
        signals[name] = Signal(time, np.where(possible, value, np.nan))
    return signals


def measured_alone(signals: Mapping[str, Signal]) -> Signals:
    """Signals, in the file's units, without zeros that fill cells or mean a sensor that is off."""
    measured = dict(signals)
    if "voltage" in signals:
        off = signals["voltage"].value == 0.0  # the sensor is off, and so is its current
        for name in ("voltage", *DRAWN):
            if name in signals:
                value = np.where(off, np.nan, signals[name].value)
                measured[name] = Signal(signals[name].time, value)
    if "speed" in measured:
        for name in filled(measured, least_unit=SLOWEST_UNIT):
            measured[name] = without_zeros(measured[name])
    return measured


def filled(signals: Mapping[str, Signal], least_unit: float = 1.0) -> set[str]:
    """Names of signals whose zeros only fill cells; speed has a unit of >= `least_unit` m/s."""
    speed, names = signals["speed"], set()
    if _leaps_to_zero(speed, least_unit):
        names.add("speed")
        speed = without_zeros(speed)
    times, change = accelerations(speed)
    kinetic = change * at_times(speed, times)
    gained = kinetic[kinetic > 0.0]
    hardest = times[kinetic > np.median(gained)] if gained.size else gained
    for name in DRAWN:
        if name not in signals or hardest.size < LEAST_EVENTS:
            continue
        time, value = signals[name].points()
        if not value.all() and value.any() and _is_fill(time, value, hardest):
            names.add(name)
    return names


def without_zeros(signal: Signal) -> Signal:
    """The signal where it is not zero."""
    return Signal(signal.time, np.where(signal.value == 0.0, np.nan, signal.value))


def _is_fill(time: FloatArray, value: FloatArray, hardest: FloatArray) -> bool:
    """True if a signal of fine resolution is often 0 at the `hardest` moments, s, in stretches."""
    at = np.clip(np.searchsorted(time, hardest), 0, time.size - 1)
    zero = value[at] == 0.0
    stretch = np.cumsum(np.diff(value == 0.0, prepend=False))[at[zero]]
    there = np.abs(value[at[~zero]])
    fine = there.size and np.median(there) > FINER * _resolution(value)
    return bool(fine and zero.mean() > ZEROS and np.unique(stretch).size >= LEAST_ZEROS)


def _leaps_to_zero(speed: Signal, least_unit: float) -> bool:
    """True if the speed leaps to most of its zeros and back faster than a car can stop."""
    time, value = speed.points()
    to_zero = (value[1:] == 0.0) != (value[:-1] == 0.0)
    changes = np.flatnonzero(to_zero)
    if changes.size < LEAST_LEAPS:
        return False
    return bool(leaps(time, least_unit * value)[changes].mean() > 0.5)


def _resolution(values: FloatArray) -> float:
    """Largest power of ten that divides all values."""
    some = values[:MOST_ASKED]
    units = 10.0 ** np.arange(6, -7, -1)
    return next((unit for unit in units if np.allclose(some / unit, np.rint(some / unit))), 0.0)


def _contradicted(signals: Signals) -> Iterator[tuple[str, Stand, str]]:
    speed = signals["speed"]
    stands = list(_stands(speed))
    seen = _without(speed, [stand for stand in stands if stand.value])
    drawn = battery_power(signals)
    mass = np.nan if drawn is None else abs(pull(_without(speed, stands), drawn))
    for stand in stands:
        if why := _other_way(stand, seen, signals):
            yield "speed", stand, why
        elif drawn is not None and _shows_driving(drawn, stand, seen, mass):
            yield "speed", stand, "the battery shows that the car drives"
    volts = signals["voltage"].known if "voltage" in signals else np.empty(0)
    units = {"current": np.median(volts) if volts.size else np.nan, "power": 1.0}
    for name, unit in units.items():
        if name in signals and drawn is not None and drawn.known.size:
            for stand in _stands(signals[name]):
                if _needs_power(stand, seen, signals[name], mass / unit):
                    yield name, stand, "the car speeds up and slows down"


def _stands(signal: Signal) -> Iterator[Stand]:
    """Stretches of one value, of `LEAST_STAND` and `LEAST_REPEATS` or more, without a gap."""
    time, value = signal.points()
    ends = np.flatnonzero((np.diff(value) != 0.0) | (np.diff(time) > LONGEST_STEP))
    firsts = np.concatenate(([0], ends + 1))
    lasts = np.concatenate((ends, [time.size - 1]))
    if not time.size:
        return
    long = (time[lasts] - time[firsts] >= LEAST_STAND) & (lasts - firsts >= LEAST_REPEATS - 1)
    for first, last in zip(firsts[long].tolist(), lasts[long].tolist(), strict=True):
        begin = float(time[first])
        yield Stand(first, last, begin, float(time[last]) - begin, float(value[first]))


def _without(signal: Signal, stands: list[Stand]) -> Signal:
    value = signal.value.copy()
    for stand in stands:
        value[(signal.time >= stand.begin) & (signal.time <= stand.begin + stand.seconds)] = np.nan
    return Signal(signal.time, value)


def _other_way(stand: Stand, seen: Signal, signals: Signals) -> str:
    """Evidence, for people, of a distance other than that at the frozen speed; "" for none."""
    expected = abs(stand.value) * stand.seconds
    if signals.keys() >= set(PLACES):
        _, steps = steps_of_places({name: stand.holds(signals[name]) for name in PLACES}, APART)
        if steps.sum() > (1.0 + WRONG_WAY) * expected + LEAST_WAY:
            return "the position moves"
    if "odometer" not in signals:
        return ""
    steps = np.diff(signals["odometer"].points()[1])
    if not (steps > 0.0).any():
        return ""
    least = 2.5 * max(float(np.quantile(steps[steps > 0.0], 0.05)), APART)
    counted = stand.holds(signals["odometer"]).known
    way = float(np.ptp(counted)) if counted.size else 0.0
    if not stand.value:
        return "the odometer counts up" if way > least else ""
    agree = abs(road_of_odometer({**signals, "speed": seen}) - 1.0) < WRONG_WAY
    is_other = abs(way - expected) > WRONG_WAY * expected + least
    return "the odometer counts another way" if agree and is_other else ""


def _shows_driving(drawn: Signal, stand: Stand, speed: Signal, mass: float) -> bool:
    """True if the battery works like that of a moving car while its speed is frozen."""
    if mass > 0.0:
        return _is_driven(stand, drawn, mass)
    return not stand.value and not speed.known.any() and _gives_and_takes(stand.holds(drawn))


def _gives_and_takes(drawn: Signal) -> bool:
    """True if power, W, changes as no charger, heater or standing load does."""
    power = drawn.known
    most = float(np.quantile(np.abs(power), 0.95)) if power.size else 0.0
    # Hysteresis: a large power sets a state, which lasts until the next other state.
    high, low, back = (power > 0.7 * most), (np.abs(power) < 0.3 * most), (power < -0.1 * most)
    rises, turns = _changes(high, low), _changes(high, back)
    return (turns >= LEAST_CYCLES and most > LEAST_WORK) or (
        rises >= LEAST_RISES and most > NO_STANDING_LOAD
    )


def _changes(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> int:
    """Number of changes from one of two states to the other."""
    states = first[first | second]
    return int(np.count_nonzero(states[1:] != states[:-1]))


def _is_driven(stand: Stand, drawn: Signal, mass: float) -> bool:
    """True if power swings during a frozen speed as it does when the speed changes."""
    time, power = stand.holds(drawn).points()
    if not stand.value:
        large = power[np.abs(power) > mass * UNSEEN * STANDING]
        return int((np.diff(np.sign(large)) != 0.0).sum()) >= LEAST_TURNS
    windows = np.flatnonzero(np.diff((time - stand.begin) // WINDOW)) + 1
    swings = [float(np.ptp(part)) for part in np.split(power, windows) if part.size > 1]
    unseen = UNSEEN_LONG if stand.seconds >= LONG else UNSEEN
    least = mass * unseen * max(abs(stand.value), DRIVING)
    return bool(swings) and float(np.median(swings)) > least


def _needs_power(stand: Stand, speed: Signal, drawn: Signal, mass: float) -> bool:
    """True if speed rises and falls while current or power is frozen."""
    inside, resolution = stand.holds(speed), FINER * _resolution(drawn.known)
    if not mass > 0.0 or not np.ptp(drawn.known):
        others = np.abs(drawn.known[drawn.known != stand.value])
        fine = not others.size or np.median(others) > resolution
        return bool(fine) and speeds_up_and_down(inside)
    if inside.known.size < LEAST_REPEATS:
        return False
    steps = np.diff(inside.points()[1])
    least = min(LEAST_RISE, float(np.quantile(np.abs(speed.known), 0.95)))
    rise, fall = float(steps[steps > 0.0].sum()), -float(steps[steps < 0.0].sum())
    if rise < 1.5 * least or (stand.value and fall < least):
        return False
    times, change = accelerations(inside)
    kinetic = np.abs(mass * change * at_times(inside, times))
    return bool(np.nanquantile(kinetic, 0.9) > resolution)
