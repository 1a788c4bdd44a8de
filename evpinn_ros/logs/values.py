"""Units, signs, repeated cells and contradictions, as the values of columns tell them.

A logger that writes a row whenever anything is new, and fills the other cells with what was last
known (the Vehicle Energy Dataset), makes steps of a speed: the change of a second seems to happen
within a tenth. Where rows come unevenly, a fine signal that repeats to the last digit was not
measured again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evpinn_ros.common.errors import InputError
from evpinn_ros.logs.column import SIGNED, Column, column_of
from evpinn_ros.logs.quantities import QUANTITIES, Unit, score

FASTEST = 45.0  # m/s: what is larger is hardly a speed of a car in m/s
STRONGEST = 4.0  # m/s^2: what changes faster in one second of a hundred is no speed in m/s
LEAST_EVENTS = 20  # moments of accelerating, and of braking, that tell a sign
EVENT = 0.3  # m/s^2 from which on it is accelerating or braking
LONGEST_STEP = 10.0  # s between two speeds that still tell an acceleration
CRUISING = 5.0  # m/s: a car that goes faster takes from its battery in the mean
LEAST_CRUISE = 30  # readings of such a mean
SAME_ROAD = 0.2  # logarithm of ways by speed and by odometer; mph is 0.48 from km/h
LEAST_SEGMENTS = 3  # from one step of the odometer to the next
SAG = 0.3  # correlation of current and voltage from which on the battery's resistance is seen
LEAST_SAGS = 30  # steps of both
STANDING = 1000.0  # m by the odometer that a speed of zero throughout contradicts
LIKE = 0.4  # correlation of power with speed times acceleration from which on it tells the mass
USUAL_MASS = 2000.0  # kg
WEAKEST = 1000.0  # W: a car that takes no more than this in its whole drive does not drive
HOTTEST = 38.0  # degrees C: no drive is warmer in the median, so it is F
LOADS = ("heating", "aircon", "auxiliary")
ALIKE = 0.5  # correlation of two powers from which on they are one, up to sign and size
SAME_SIZE = (0.5, 2.0)  # of the ratio of two powers that are one
MAY_BE_HELD = ("speed", "current", "power")
UNEVEN = 0.5  # of the usual step between rows: one step in twenty is shorter
LEAST_REPEATS = 0.1  # of the steps
FINE = 10.0  # resolutions that a signal usually changes by
LEAST_ROWS = 100

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Signal:
    """Sample of a column: times, s, and values in the file's unit; shape (n,)."""

    time: FloatArray
    value: FloatArray

    def points(self) -> tuple[FloatArray, FloatArray]:
        """Times and values where both are finite."""
        known = np.isfinite(self.time) & np.isfinite(self.value)
        return self.time[known], self.value[known]

    @property
    def known(self) -> FloatArray:
        """The values that are finite."""
        return self.value[np.isfinite(self.value)]


def with_units(columns: Mapping[str, Column], cells: Mapping[str, Signal]) -> dict[str, Column]:
    """The columns, each with a unit and a sign."""
    done = dict(columns)
    if "odometer" in done and not done["odometer"].unit:
        done["odometer"] = done["odometer"].in_unit("km", "assumed")
    for name, decide in _BY_VALUES.items():  # the speed's needs the unit of power
        if name in done and not _is_known(done[name]):
            done[name] = decide(done[name], done, cells)
    for name in SIGNED:
        if name in done and done[name].why != "as given" and not done[name].is_ours:
            positive, shows = _sign(cells[name], done["speed"], cells)
            done[name] = _say_sign(done[name], positive, shows)
    for name, column in done.items():
        if not _is_known(column):
            done[name] = column.in_unit(next(iter(QUANTITIES[name].units)), "assumed")
    return done


def _is_known(column: Column) -> bool:
    return bool(column.unit) or column.is_ours


def _road(columns: Mapping[str, Column], cells: Mapping[str, Signal]) -> float:
    """Metres by the odometer over the integral of speed in the file's unit; NaN if not known.

    A low quantile over the ways from one step of the odometer to the next: where a phone has lost
    its GPS the speed is zero for a while, so a way is too short or right.
    """
    if "odometer" not in columns:
        return np.nan
    counted, speed = cells["odometer"], cells["speed"]
    known = np.isfinite(counted.time) & (counted.value > 0)
    time, value = counted.time[known], counted.value[known]
    steps = np.flatnonzero(np.diff(value) > 0) + 1
    times, speeds = speed.points()
    if steps.size <= LEAST_SEGMENTS or times.size < LEAST_EVENTS:
        return np.nan
    span = np.diff(times)
    middle = 0.5 * np.abs(speeds[1:] + speeds[:-1])
    way = np.concatenate(([0.0], np.cumsum(middle * span)))
    gaps = np.concatenate(([0.0], np.cumsum(span > LONGEST_STEP)))
    ways = np.diff(np.interp(time[steps], times, way))
    whole = (np.diff(np.interp(time[steps], times, gaps)) == 0) & (ways > 0)
    if whole.sum() < LEAST_SEGMENTS:
        return np.nan
    ratios = np.diff(value[steps])[whole] * columns["odometer"].factor / ways[whole]
    return float(np.quantile(ratios, 0.25))


def pull(speed: Signal, power: Signal) -> float:
    """Power over speed times acceleration in these units; NaN where they are not alike.

    The change of kinetic energy is most of a car's power, so this is its mass, kg, where speed is
    in m/s, a thirteenth of it where it is in km/h, and below zero for a power of the other sign.
    """
    times, change = accelerations(speed)
    with np.errstate(over="ignore"):  # damaged cells, left out below
        kinetic = change * at_times(speed, times)
    drawn = at_times(power, times)
    known = np.isfinite(kinetic) & np.isfinite(drawn)
    if known.sum() < LEAST_EVENTS or not kinetic[known].any() or not np.ptp(drawn[known]):
        return np.nan
    spread = np.cov(kinetic[known], drawn[known])
    if abs(spread[0, 1]) < LIKE * np.sqrt(spread[0, 0] * spread[1, 1]):
        return np.nan
    return float(spread[0, 1] / spread[0, 0])


def _power_of(columns: Mapping[str, Column], cells: Mapping[str, Signal]) -> Signal | None:
    """Power of the battery, W, its sign unknown."""
    if {"voltage", "current"} <= cells.keys():
        current = cells["current"]
        scale = columns["voltage"].factor * columns["current"].factor
        volts = at_times(cells["voltage"], current.time)
        return Signal(current.time, scale * current.value * volts)
    if "power" in cells:
        return Signal(cells["power"].time, cells["power"].value * columns["power"].factor)
    return None


def _speed_unit(
    column: Column, columns: Mapping[str, Column], cells: Mapping[str, Signal]
) -> Column:
    signal, odometer = cells["speed"], columns.get("odometer")
    units = QUANTITIES["speed"].units
    road = _road(columns, cells)
    if road > 0:
        ratios = {text: abs(np.log(units[text].factor / road)) for text in ("km/h", "mph", "m/s")}
        text = min(ratios, key=lambda unit: ratios[unit])
        if ratios[text] < SAME_ROAD:
            return column.in_unit(text, "by the odometer")
    if odometer is not None and odometer.why == "by its name":
        text = "mph" if odometer.unit.startswith("mi") else "km/h"
        return column.in_unit(text, "as the odometer")
    power = _power_of(columns, cells)
    mass = abs(pull(signal, power)) if power is not None else np.nan
    if mass > 0:
        masses = {text: mass / units[text].factor ** 2 for text in ("km/h", "m/s")}
        text = min(masses, key=lambda unit: abs(np.log(masses[unit] / USUAL_MASS)))
        if abs(np.log(masses[text] / USUAL_MASS)) < np.log(3.0):
            return column.in_unit(text, "by the power that accelerating takes")
    value = signal.known
    fastest = float(np.abs(value).max(initial=0.0))
    changes = np.sort(np.abs(accelerations(signal)[1]))
    strongest = changes[int(0.99 * changes.size)] if changes.size else 0.0
    if fastest > FASTEST or strongest > STRONGEST:
        why = "by its values" if fastest > FASTEST else "by how fast it changes"
        return column.in_unit("km/h", why)
    if fastest > 1 and value.size > LEAST_EVENTS and not (value % 1).any():
        return column.in_unit("km/h", "by its whole numbers")
    return column.in_unit("m/s", f"by its values, up to {fastest:.3g}")


def stands_still(columns: Mapping[str, Column], cells: Mapping[str, Signal]) -> bool:
    """True if speed is zero throughout while the odometer goes on: a phone without GPS."""
    if "odometer" not in columns or "speed" not in cells:
        return False
    speed, odometer = cells["speed"].value, cells["odometer"].value
    odometer = odometer[odometer > 0]
    way = float(np.ptp(odometer)) * columns["odometer"].factor if odometer.size else 0.0
    return way >= STANDING and not np.nan_to_num(speed).any()


def accelerations(speed: Signal) -> tuple[FloatArray, FloatArray]:
    """Change of speed over about a second or one step, and the middle of it, s.

    Returns:
        times, and unit of the speed per second; shape (n,) each.
    """
    time, value = speed.points()
    if time.size < 3:
        return np.empty(0), np.empty(0)
    steps = np.diff(time)
    typical = np.median(steps[steps > 0]) if (steps > 0).any() else 1.0
    stride = int(np.clip(round(1.0 / typical), 1, 1000)) if typical > 0 else 1
    span = time[stride:] - time[:-stride]
    near = (span > 0.2) & (span <= LONGEST_STEP)
    change = (value[stride:] - value[:-stride])[near] / span[near]
    return 0.5 * (time[stride:] + time[:-stride])[near], change


def at_times(signal: Signal, times: FloatArray) -> FloatArray:
    """The signal at other times by interpolation; NaN within a gap of its own."""
    time, value = signal.points()
    if time.size < 2:
        return np.full(times.shape, np.nan)
    order = np.argsort(time, kind="stable")
    time, value = time[order], value[order]
    interpolated = np.interp(times, time, value)
    after = np.clip(np.searchsorted(time, times), 1, time.size - 1)
    inside = (times > time[after - 1]) & (times < time[after])
    far = inside & (time[after] - time[after - 1] > LONGEST_STEP)
    far |= (times < time[0]) | (times > time[-1])
    interpolated[far] = np.nan
    return interpolated


def _sign(drawn: Signal, speed: Column, cells: Mapping[str, Signal]) -> tuple[bool, str]:
    """Sign of a current or power while the battery discharges, and what shows it."""
    if "voltage" in cells and (sag := _sag(drawn, cells["voltage"])) != 0.0:
        return sag < 0, "as the voltage shows"
    times, change = accelerations(cells["speed"])
    at, change = at_times(drawn, times), change * speed.factor
    taken = at[(change > EVENT) & np.isfinite(at)]
    given = at[(change < -EVENT) & np.isfinite(at)]
    if min(taken.size, given.size) >= LEAST_EVENTS:
        return bool(taken.mean() > given.mean()), "as accelerating shows"
    fast = at_times(cells["speed"], drawn.time) * speed.factor > CRUISING
    cruise = drawn.value[fast & np.isfinite(drawn.value)]
    if cruise.size < LEAST_CRUISE or cruise.mean() == 0:
        return True, "assumed"
    return bool(cruise.mean() > 0), "as driving shows"


def _sag(current: Signal, voltage: Signal) -> float:
    """Correlation of the steps of current and voltage, which falls under load; 0 if not clear."""
    at = at_times(voltage, current.time)
    known = np.isfinite(at) & np.isfinite(current.value)
    amps, volts = np.diff(current.value[known]), np.diff(at[known])
    near = np.diff(current.time[known]) <= LONGEST_STEP
    amps, volts = amps[near], volts[near]
    if amps.size < LEAST_SAGS or not amps.any() or not volts.any():
        return 0.0
    correlation = float(np.corrcoef(amps, volts)[0, 1])
    return correlation if abs(correlation) > SAG else 0.0


def _say_sign(column: Column, positive: bool, shows: str) -> Column:
    text = column.unit or next(iter(QUANTITIES[column.quantity].units))
    column = column if column.unit else column.in_unit(text, "")
    why = f"{'positive' if positive else 'negative'} while it discharges, {shows}"
    return replace(column if positive else column.turned(), why=why)


def _power_unit(column: Column, _: Mapping[str, Column], cells: Mapping[str, Signal]) -> Column:
    """Watts, or kilowatts where they would not move a car."""
    known = np.abs(cells["power"].known)
    largest = float(np.quantile(known, 0.99)) if known.size else 0.0
    text = "kw" if 0 < largest < WEAKEST else "w"
    return column.in_unit(text, f"by its values, up to {largest:.3g}")


def _charge_unit(column: Column, _: Mapping[str, Column], cells: Mapping[str, Signal]) -> Column:
    known = cells["charge"].known
    highest = float(known.max(initial=0.0))
    if 0 < highest <= 1.0:
        return column.in_unit("fraction", "by its values")
    if np.median(known) > 100.0 if known.size else False:
        # LeafSpy counts 1/10000 of a percent.
        factor = 10.0 ** -np.ceil(np.log10(highest / 101.0))
        return column.measured_in(f"{factor:g} %", Unit(float(factor)), "by its values")
    return column.in_unit("%", "by its values")


def _temperature_unit(
    column: Column, _: Mapping[str, Column], cells: Mapping[str, Signal]
) -> Column:
    known = cells["ambient"].known
    middle = float(np.median(known)) if known.size else 0.0
    if middle > HOTTEST:
        return column.in_unit("f", f"its median of {middle:.3g} is too hot for °C")
    return column.in_unit("c", f"assumed, as its median is {middle:.3g}")


_BY_VALUES = {
    "power": _power_unit,
    "speed": _speed_unit,
    "charge": _charge_unit,
    "ambient": _temperature_unit,
}
"""Rules for the unit of a quantity that has none, by its values; in this order."""


def held_columns(signals: Mapping[str, Signal]) -> frozenset[str]:
    """Quantities whose cells repeat the last value where nothing was measured."""
    return frozenset(name for name in MAY_BE_HELD if name in signals and _is_held(signals[name]))


def _is_held(signal: Signal) -> bool:
    time, value = signal.points()
    steps = np.diff(time)
    if len(steps) < LEAST_ROWS or np.quantile(steps, 0.05) > UNEVEN * np.median(steps):
        return False
    changes = np.abs(np.diff(value))
    changed = changes[changes > 0.0]
    if not changed.size or np.mean((changes == 0.0) & (value[1:] != 0.0)) < LEAST_REPEATS:
        return False
    resolution = np.quantile(np.diff(np.unique(value)), 0.05)
    return bool(np.median(changed) > FINE * resolution)


def power_beside(header: Sequence[str], used: Sequence[Column]) -> Column | None:
    """A column of the battery's power that is not needed, for voltage and current are there."""
    taken = {column.quantity: column.place for column in used}
    if not {"voltage", "current"} <= taken.keys() or "power" in taken:
        return None
    scores = {place: score("power", name) for place, name in enumerate(header)}
    for place, name in enumerate(header):
        if place in taken.values() or any(score(load, name) > 0.0 for load in LOADS):
            scores[place] = 0.0
    place = max(scores, key=lambda i: scores[i])
    if scores[place] <= 0.0:
        return None
    with suppress(InputError):  # of a unit that is not known it tells nothing
        return column_of("power", header, place)
    return None


def contradictions(used: Mapping[str, Column], cells: Mapping[str, Signal]) -> Iterator[str]:
    """Sentences on columns that contradict each other, or the car.

    Args:
        used: columns with units and signs, by quantity; with voltage and current, `power` is
            compared with them.
        cells: their signals in the file's units.
    """
    signals = {name: _in_si(cells[name], column) for name, column in used.items()}
    drawn = signals.get("power")
    if {"voltage", "current"} <= signals.keys():
        current = signals["current"]
        drawn = Signal(current.time, current.value * at_times(signals["voltage"], current.time))
        if "power" in signals:
            yield from _compared(used["power"].name, signals["power"], drawn)
    if drawn is not None and pull(signals["speed"], drawn) < 0.0:
        column = used["current" if "current" in used else "power"]
        unit = column.unit.lstrip("-") or next(iter(QUANTITIES[column.quantity].units))
        turned = unit if column.unit.startswith("-") else f"-{unit}"
        yield (
            f"the car speeds up while its battery is charged: the sign of {column.name!r} is "
            f"probably wrong; --column '{column.quantity}={column.name}:{turned}' turns it"
        )


def _in_si(signal: Signal, column: Column) -> Signal:
    return Signal(signal.time, signal.value * column.factor + column.offset)


def _compared(name: str, power: Signal, drawn: Signal) -> Iterator[str]:
    """Sentences on a column of power beside voltage times current, W."""
    at = at_times(power, drawn.time)
    known = np.isfinite(at) & np.isfinite(drawn.value)
    beside, other = at[known], drawn.value[known]
    if beside.size < LEAST_EVENTS or not np.ptp(beside) or not np.ptp(other):
        return
    alike = float(np.corrcoef(beside, other)[0, 1])
    if abs(alike) < ALIKE:
        yield f"{name!r} has little in common with voltage times current, which are used"
        return
    ratio = float(np.std(beside) / np.std(other))
    if alike < 0.0:
        yield f"{name!r} has the other sign than voltage times current, which are used"
    if not SAME_SIZE[0] < ratio < SAME_SIZE[1]:
        yield f"{name!r} is {ratio:.2g} times voltage times current, which are used"
