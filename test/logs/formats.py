"""One drive, written as apps and people write it: every locale, unit, clock and order."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
import gzip
import math
from pathlib import Path
import random
import re

START = datetime(2024, 3, 5, 23, 50, 0, tzinfo=timezone.utc)  # midnight comes after ten minutes


@dataclass(frozen=True)
class Row:
    """A moment of the drive, in SI; current positive while it discharges."""

    time: float
    speed: float
    voltage: float
    current: float
    charge: float
    height: float
    ambient: float


def drive(count: int, step: float) -> list[Row]:
    """Stop and go in town, with a pack that sags."""
    rows = []
    for i in range(count):
        time = round(i * step, 3)
        speed = 8.0 - 8.0 * math.cos(time / 8.0)
        current = 12.0 + 5.0 * speed * math.sin(time / 8.0) + 0.3 * speed
        voltage = 380.0 - 0.1 * current
        rows.append(Row(time, speed, voltage, current, 80.0 - time / 90.0, 100 + time / 20, 6.5))
    return rows


Cell = Callable[[Row], float]
SPEEDS: dict[str, Cell] = {
    "Vehicle speed (km/h)": lambda row: row.speed * 3.6,
    "GPS Speed [mph]": lambda row: row.speed / 0.44704,
    "Speed (GPS)(m/s)": lambda row: row.speed,
    "velocity_kn": lambda row: row.speed * 3600 / 1852,
    "Geschwindigkeit [km/h]": lambda row: row.speed * 3.6,
    "v.p.speed": lambda row: row.speed * 3.6,
}
VOLTAGES: dict[str, Cell] = {
    "Battery DC Voltage (V)": lambda row: row.voltage,
    "Pack Volts": lambda row: row.voltage,
    "[BMS] HV Battery Voltage(mV)": lambda row: row.voltage * 1000,
    "Batteriespannung": lambda row: row.voltage,
}
CURRENTS: dict[str, Cell] = {
    "Battery DC Current (A)": lambda row: row.current,
    "pack_current_a": lambda row: row.current,
    "HV Strom": lambda row: -row.current,
    "v.b.current": lambda row: -row.current,
}
OTHERS: dict[str, Cell] = {
    "State of charge (%)": lambda row: row.charge,
    "Altitude (ft)": lambda row: row.height / 0.3048,
    "Ambient air temp(°F)": lambda row: row.ambient * 1.8 + 32,
    "12V battery voltage (V)": lambda _: 14.2,
    "Motor Power (kW)": lambda _: 3.0,
    "Cell voltage max (V)": lambda _: 3.9,
}


def _clock(pattern: str) -> Callable[[float], list[str]]:
    def written(time: float) -> list[str]:
        moment = START + timedelta(seconds=time)
        milli = f"{moment.microsecond // 1000:03d}"
        text = moment.strftime(pattern).replace("%L", milli)
        return text.split("|")

    return written


# Names of the columns of time, how they are written, and whether they know the day.
CLOCKS: dict[str, tuple[list[str], Callable[[float], list[str]], bool]] = {
    "iso": (["timestamp"], _clock("%Y-%m-%dT%H:%M:%S.%LZ"), True),
    "zone": (["time"], _clock("%Y-%m-%d %H:%M:%S.%L+00:00"), True),
    "german": (["Datum"], _clock("%d.%m.%Y %H:%M:%S.%L"), True),
    "american": (["Date/Time"], _clock("%m/%d/%Y %I:%M:%S.%L %p"), True),
    "torque": (["Device Time"], _clock("%d-%b-%Y %H:%M:%S.%L"), True),
    "split": (["Date", "Time"], _clock("%d/%m/%Y|%H:%M:%S.%L"), True),
    "seconds": (["epoch"], lambda time: [f"{START.timestamp() + time:.3f}"], True),
    "milli": (["utc"], lambda time: [f"{1000 * (START.timestamp() + time):.0f}"], True),
    "micro": (["timestamp"], lambda time: [f"{1e6 * (START.timestamp() + time):.0f}"], True),
    "since": (["Time (s)"], lambda time: [f"{time:.3f}"], False),
    "since_ms": (["elapsed"], lambda time: [f"{1000 * time:.0f}"], False),
    "of_day": (["time"], _clock("%H:%M:%S.%L"), False),
    "of_day_12": (["time"], _clock("%I:%M:%S.%L %p"), False),
}


@dataclass(frozen=True)
class Style:
    """How a table is written."""

    clock: str
    speed: str
    voltage: str
    current: str
    separator: str = ","
    comma: bool = False
    thousands: bool = False
    quoted: bool = False
    encoding: str = "utf-8"
    end: str = "\n"
    sep_line: bool = False
    polled: bool = False  # one signal a row, each at its own time
    long: bool = False
    zipped: bool = False
    torn: int = 0
    rows: str = "oldest first"
    seed: int = 0


def number(value: float, style: Style) -> str:
    """A number in the style's locale."""
    text = f"{value:,.4f}" if style.thousands else f"{value:.4f}"
    if style.comma:
        text = text.translate(str.maketrans(",.", ".,"))
    if style.separator in text or style.quoted:
        return f'"{text}"'
    return text


def write(folder: Path, rows: list[Row], style: Style) -> Path:
    """The drive in a file."""
    chance = random.Random(style.seed)
    names = CLOCKS[style.clock][0]
    cells: dict[str, Cell] = {
        style.speed: SPEEDS[style.speed],
        style.voltage: VOLTAGES[style.voltage],
        style.current: CURRENTS[style.current],
        **OTHERS,
    }
    order = list(cells)
    chance.shuffle(order)
    lines = (_long if style.long else _wide)(rows, style, order, cells)
    if style.rows == "in no order":
        chance.shuffle(lines)
    elif style.rows == "newest first":
        lines.reverse()
    for line in chance.sample(lines, style.torn):
        torn = line[: chance.randrange(1, line.rfind(style.separator))]
        lines.insert(lines.index(line), torn)
    header = [*names, "PID", "VALUE", "UNITS"] if style.long else [*names, *order]
    quote = '"{}"'.format if style.quoted else str
    lines.insert(0, style.separator.join(map(quote, header)))
    if style.sep_line:
        lines.insert(0, f"sep={style.separator}")
    data = (style.end.join(lines) + style.end).encode(style.encoding)
    path = folder / ("drive.csv.gz" if style.zipped else "drive.csv")
    path.write_bytes(gzip.compress(data) if style.zipped else data)
    return path


def _time(time: float, style: Style) -> list[str]:
    cells = CLOCKS[style.clock][1](time)
    if style.comma:  # the sign before the digits of the second
        cells = [re.sub(r"\.(\d{3}\b)(?!\.)", r",\1", cell) for cell in cells]
    return [f'"{cell}"' if style.quoted or style.separator in cell else cell for cell in cells]


def _wide(rows: list[Row], style: Style, order: list[str], cells: dict[str, Cell]) -> list[str]:
    lines = []
    for row in rows:
        if not style.polled:
            found = [number(cells[name](row), style) for name in order]
            lines.append(style.separator.join([*_time(row.time, style), *found]))
            continue
        for k, name in enumerate(order):
            found = [number(cells[each](row), style) if each == name else "" for each in order]
            lines.append(style.separator.join([*_time(row.time + POLL * k, style), *found]))
    return lines


POLL = 0.05  # s from one signal to the next


def _long(rows: list[Row], style: Style, order: list[str], cells: dict[str, Cell]) -> list[str]:
    lines = []
    quote = '"{}"'.format if style.quoted else str
    for row in rows:
        for k, name in enumerate(order):
            bare, _, unit = name.rpartition("(")
            known = (bare.strip(), unit.rstrip(")")) if bare else (name, "")
            found = [quote(known[0]), number(cells[name](row), style), quote(known[1])]
            lines.append(style.separator.join([*_time(row.time + POLL * k, style), *found]))
    return lines


def polled_at(style: Style, name: str) -> float:
    """When a signal is measured, s after the row's time."""
    if not style.polled and not style.long:
        return 0.0
    order = [style.speed, style.voltage, style.current, *OTHERS]
    order = list(dict.fromkeys(order))
    random.Random(style.seed).shuffle(order)
    return POLL * order.index(name)
