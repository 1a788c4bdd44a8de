"""Which columns of a stranger's CSV file are what, in which unit: guessed, told, and settable.

The names of `evpinn_ros.bags.csv_drive` are taken as they are. Of others the words of the name
decide, then the unit in it (`Velocity [km/h]`, `pack_current_a`), then the size of the values, and
of current and power the sign: accelerating takes more of the battery than braking.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from itertools import pairwise
import math
import re
from statistics import fmean, median
from typing import NamedTuple

from evpinn_ros.errors import InputError

FASTEST = 62.0  # m/s: what is larger is no speed of a car in m/s
STRONGEST = 4.0  # m/s^2: what changes faster in one second of a hundred is no speed in m/s
SLOWEST_STEP = 5.0  # s: rows farther apart would be useless, so the unit is smaller
LEAST_EVENTS = 20  # rows of accelerating, and of braking, that tell a sign
EVENT = 0.3  # m/s^2 from which on it is accelerating or braking

_SPEED = {"m/s": 1.0, "mps": 1.0, "ms": 1.0, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6}
_SPEED |= {"kmph": 1 / 3.6, "mph": 0.44704, "mi/h": 0.44704}
_TIME = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_TIME |= {"min": 60.0, "h": 3600.0}
_POWER = {"w": 1.0, "kw": 1e3}
_CELSIUS = {"c": 1.0, "°c": 1.0, "degc": 1.0, "celsius": 1.0}


class Quantity(NamedTuple):
    """What a column may hold.

    Attributes:
        column: the name that says it all.
        words: any of which a name must have.
        better: that speak for a name.
        worse: that speak against it.
        units: the factors to SI; the first is taken when nothing tells.
    """

    column: str
    words: frozenset[str]
    better: frozenset[str]
    worse: frozenset[str]
    units: Mapping[str, float]


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_BATTERY = _words("battery batt bat pack hv traction dc total")
_OTHERS = _words(
    "motor engine cell min max limit charger aux auxiliary lv 12v phase target set heating heater "
    "aircon ac regen available fan accuracy acc wind rear gps2 temp temperature"
)
QUANTITIES: Mapping[str, Quantity] = {
    "time": Quantity(
        "t_s",
        _words("t time timestamp datetime date zeit seconds elapsed stamp"),
        _words("time timestamp elapsed"),
        _words("charging remaining left to full"),
        _TIME,
    ),
    "speed": Quantity(
        "speed_mps",
        _words(
            "speed velocity spd geschwindigkeit fahrzeuggeschwindigkeit vehiclespeed kmh kph mph"
        ),
        _words("vehicle car ground"),
        _OTHERS | _words("wheel shaft rpm angular air"),
        _SPEED,
    ),
    "voltage": Quantity(
        "voltage_v",
        _words("voltage volt volts spannung batteriespannung"),
        _BATTERY,
        _OTHERS,
        {"v": 1.0, "mv": 1e-3},
    ),
    "current": Quantity(
        "current_a",
        _words("current amps ampere amperage strom batteriestrom"),
        _BATTERY,
        _OTHERS,
        {"a": 1.0, "ma": 1e-3},
    ),
    "power": Quantity(
        "power_w", _words("power leistung kw"), _BATTERY, _OTHERS | _words("steering"), _POWER
    ),
    "elevation": Quantity(
        "elevation_m",
        _words("elevation altitude alt height"),
        frozenset(),
        _words("accuracy error"),
        {"m": 1.0, "ft": 0.3048},
    ),
    "ambient": Quantity(
        "ambient_c",
        _words("ambient outside outdoor"),
        _words("temperature temp air"),
        _words("pressure humidity light"),
        _CELSIUS,
    ),
    "heating": Quantity(
        "heating_w",
        _words("heating heater"),
        _words("power"),
        _words("can temperature temp current voltage signal request coolant inlet outlet"),
        _POWER,
    ),
    "aircon": Quantity(
        "aircon_w",
        _words("aircon airconditioning"),
        _words("power"),
        _words("temperature temp current voltage signal request"),
        _POWER,
    ),
    "charge": Quantity(
        "soc_pct",
        _words("soc stateofcharge"),
        _words("battery displayed"),
        _words("min max target limit"),
        {"%": 1.0, "pct": 1.0, "percent": 1.0, "fraction": 100.0},
    ),
    # Taken by these names, or named with --column, alone: torque of foreign logs may be a request,
    # that of an axle, or a percentage.
    "motor_torque": Quantity(
        "motor_torque_nm", frozenset(), frozenset(), frozenset(), {"nm": 1.0, "n m": 1.0}
    ),
    "motor_speed": Quantity(
        "motor_speed_rad_s",
        frozenset(),
        frozenset(),
        frozenset(),
        {"rad/s": 1.0, "rpm": 2 * math.pi / 60},
    ),
}
BY_COLUMN = {quantity.column: name for name, quantity in QUANTITIES.items()}
SIGNED = ("current", "power")


@dataclass(frozen=True, slots=True)
class Column:
    """A column that is used.

    Attributes:
        quantity: of `QUANTITIES`.
        name: in the file.
        factor: to SI.
        unit: that of the file, with a minus where the sign is turned.
        why: the unit is believed; empty when the name is one of ours.
    """

    quantity: str
    name: str
    factor: float = 1.0
    unit: str = ""
    why: str = ""

    def value(self, cell: str) -> float:
        """The number in a cell in SI; NaN when there is none."""
        number = _number(cell)
        if math.isnan(number) and self.quantity == "time":
            return _clock(cell)
        return number * self.factor


def columns_of(
    header: Sequence[str], rows: Iterable[Sequence[str]], chosen: Sequence[str] = ()
) -> tuple[Column, ...]:
    """The columns that are used of a file, in its order.

    Args:
        header: names of the columns.
        rows: the first of the file, which tell units and signs; not read when nothing is guessed.
        chosen: `speed=NAME` or `speed=NAME:UNIT`; a minus before the unit turns the sign.

    Raises:
        InputError: a choice that names no quantity, no column or no unit.
    """
    found = {
        BY_COLUMN[name]: Column(BY_COLUMN[name], name) for name in header if name in BY_COLUMN
    }
    fixed = set(found)
    for text in chosen:
        column = _chosen(text, header)
        found[column.quantity] = column
        fixed.add(column.quantity)
    for quantity in () if _is_ours(found) else QUANTITIES:
        taken = {column.name for column in found.values()}
        name = _likeliest(quantity, [each for each in header if each not in taken])
        # Power is voltage times current: of a stranger's file it is not needed then.
        known = quantity == "power" and {"voltage", "current"} <= found.keys()
        if quantity not in found and name is not None and not known:
            found[quantity] = _with_unit(quantity, name)
    if fixed.issuperset(found):
        return tuple(sorted(found.values(), key=lambda column: header.index(column.name)))
    places = {column.name: header.index(column.name) for column in found.values()}
    _guess_units(found, [*rows], places, fixed)
    return tuple(sorted(found.values(), key=lambda column: places[column.name]))


def _is_ours(found: Mapping[str, Column]) -> bool:
    """Whether all that is needed is there: other columns of such a file are not guessed at."""
    battery = "power" in found or {"voltage", "current"} <= found.keys()
    return battery and {"time", "speed"} <= found.keys()


def _chosen(text: str, header: Sequence[str]) -> Column:
    quantity, _, rest = text.partition("=")
    if quantity not in QUANTITIES or not rest:
        known = ", ".join(QUANTITIES)
        raise InputError(f"--column {text}: say QUANTITY=NAME or QUANTITY=NAME:UNIT, with {known}")
    name, unit = (rest, "") if rest in header else (*rest.rpartition(":")[::2],)
    if name not in header:
        raise InputError(f"--column {text}: no such column; there are {', '.join(header)}")
    if not unit:
        return replace(_with_unit(quantity, name), why="as told")
    units = QUANTITIES[quantity].units
    factor = units.get(unit.lower().lstrip("-"))
    if factor is None:
        raise InputError(f"--column {text}: the unit is one of {', '.join(units)}")
    return Column(quantity, name, -factor if unit.startswith("-") else factor, unit, "as told")


def _split(name: str) -> tuple[list[str], str]:
    """The words of a name and what it has in brackets."""
    bracket = re.search(r"[\[(]([^\])]*)[\])]", name)
    bare = re.sub(r"[\[(].*", "", name)
    bare = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare)
    return re.findall(r"[^\W_]+", bare.lower()), bracket[1].strip().lower() if bracket else ""


def _likeliest(quantity: str, header: Sequence[str]) -> str | None:
    """The name that speaks most for a quantity, the first of equals; None when none does."""
    best, best_score = None, 0
    for name in header:
        words, _ = _split(name)
        known = QUANTITIES[quantity]
        if not known.words & {*words} or known.worse & {*words}:
            continue
        score = 1 + len(known.better & {*words})
        if score > best_score:
            best, best_score = name, score
    return best


def _with_unit(quantity: str, name: str) -> Column:
    """A column with the unit that its name tells, or none."""
    words, bracket = _split(name)
    units = QUANTITIES[quantity].units
    for unit in (bracket, "/".join(words[-2:]), words[-1] if words else ""):
        if unit in units:
            return Column(quantity, name, units[unit], unit, "by its name")
    return Column(quantity, name)


def _guess_units(
    found: dict[str, Column],
    rows: Sequence[Sequence[str]],
    places: Mapping[str, int],
    fixed: set[str],
) -> None:
    """Complete the columns by what is in them."""

    def values(quantity: str) -> list[float]:
        column = found[quantity]
        return [column.value(row[places[column.name]]) for row in rows]

    if "time" in found and not found["time"].unit and "time" not in fixed:
        found["time"] = _time_unit(found["time"], values("time"))
    if "speed" in found and "time" in found:
        times, speeds = values("time"), values("speed")
        if not found["speed"].unit and "speed" not in fixed:
            found["speed"] = _speed_unit(found["speed"], times, speeds)
            speeds = values("speed")
        for quantity in {*SIGNED} & found.keys() - fixed:
            found[quantity] = _signed(found[quantity], times, speeds, values(quantity))
    if "charge" in found and not found["charge"].unit and "charge" not in fixed:
        highest = max((value for value in values("charge") if math.isfinite(value)), default=100.0)
        if highest <= 1.0:
            unit = "fraction"
            found["charge"] = replace(found["charge"], factor=100.0, unit=unit, why="by its size")
    for quantity in found.keys() - fixed:
        if not found[quantity].unit:
            unit = next(iter(QUANTITIES[quantity].units))
            found[quantity] = replace(found[quantity], unit=unit, why="assumed")


def _time_unit(column: Column, times: Sequence[float]) -> Column:
    known = [time for time in times if math.isfinite(time)]
    steps = [b - a for a, b in pairwise(known) if b > a]
    first, step = abs(known[0]) if known else 0.0, median(steps) if steps else 0.0
    for least, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms")):
        if first >= least:
            return replace(column, factor=_TIME[unit], unit=unit, why="since 1970, by its size")
    if step > SLOWEST_STEP:
        unit = "ms" if step < SLOWEST_STEP * 1e3 else "us" if step < SLOWEST_STEP * 1e6 else "ns"
        return replace(column, factor=_TIME[unit], unit=unit, why="by the step between rows")
    return replace(column, unit="s", why="by the step between rows")


def _speed_unit(column: Column, times: Sequence[float], speeds: Sequence[float]) -> Column:
    fastest = max((abs(speed) for speed in speeds if math.isfinite(speed)), default=0.0)
    changes = sorted(abs(change) for change, _ in _changes(times, speeds))
    strongest = changes[int(0.99 * len(changes))] if changes else 0.0
    if fastest > FASTEST or strongest > STRONGEST:
        why = "by its size" if fastest > FASTEST else "by how fast it changes"
        return replace(column, factor=_SPEED["km/h"], unit="km/h", why=why)
    return replace(column, unit="m/s", why="by its size, up to " + format(fastest, ".3g"))


def _signed(
    column: Column, times: Sequence[float], speeds: Sequence[float], values: Sequence[float]
) -> Column:
    """Turned so that it is positive while the battery discharges."""
    taken: list[float] = []
    given: list[float] = []
    for change, place in _changes(times, speeds):
        if math.isfinite(values[place]) and abs(change) > EVENT:
            (taken if change > 0 else given).append(values[place])
    unit = column.unit or next(iter(QUANTITIES[column.quantity].units))
    if min(len(taken), len(given)) < LEAST_EVENTS:
        return replace(column, unit=unit, why="positive while it discharges, assumed")
    if fmean(taken) > fmean(given):
        return replace(
            column, unit=unit, why="positive while it discharges, as accelerating shows"
        )
    why = "negative while it discharges, as accelerating shows"
    return replace(column, factor=-column.factor, unit=f"-{unit}", why=why)


def _changes(times: Sequence[float], speeds: Sequence[float]) -> list[tuple[float, int]]:
    """Change of speed per second over about a second, and the row it ends in."""
    found, begin = [], 0
    for place, time in enumerate(times):
        if not math.isfinite(time) or not math.isfinite(speeds[place]):
            continue
        while times[begin] != times[begin] or (begin < place and times[begin] < time - 1.5):
            begin += 1
        span = time - times[begin]
        if 0.4 <= span <= SLOWEST_STEP and math.isfinite(speeds[begin]):
            found.append(((speeds[place] - speeds[begin]) / span, place))
    return found


def _number(cell: str) -> float:
    """Also with a decimal comma, as in files with semicolons."""
    try:
        return float(cell)
    except ValueError:
        pass
    try:
        return float(cell.replace(",", ".")) if cell.count(",") == 1 else math.nan
    except ValueError:
        return math.nan


def _clock(cell: str) -> float:
    """Seconds since 1970 of a date, in UTC where no zone is given; or those of a time of day."""
    match = re.fullmatch(r"(.*:\d\d)[.,](\d+)(.*)", cell.strip())
    text, fraction = (
        (match[1] + match[3], float(f"0.{match[2]}")) if match else (cell.strip(), 0.0)
    )
    try:
        moment = datetime.fromisoformat(text.replace("Z", "+00:00"))
        return moment.replace(tzinfo=moment.tzinfo or timezone.utc).timestamp() + fraction
    except (ValueError, OverflowError):
        parts = text.split(":")
    if len(parts) == 3 and all(part.isascii() and part.isdigit() for part in parts):
        hours, minutes, seconds = map(int, parts)
        return 3600.0 * hours + 60.0 * minutes + seconds + fraction
    return math.nan
