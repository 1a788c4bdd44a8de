"""Random exports of a drive, as apps and people of twelve languages write them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
import math
import random

from exports import Drive, simulated
import numpy as np

# Names of time, speed, voltage, current, power and state of charge.
LANGUAGES = {
    "english": "Time,Vehicle speed,Battery voltage,Battery current,Battery power,State of charge",
    "german": "Zeit,Geschwindigkeit,Batteriespannung,Batteriestrom,Batterieleistung,Ladezustand",
    "french": "Temps,Vitesse,Tension batterie,Courant batterie,Puissance batterie,État de charge",
    "spanish": "Tiempo,Velocidad,Tensión batería,Corriente batería,Potencia batería,"
    "Estado de carga",
    "italian": "Tempo,Velocità,Tensione batteria,Corrente batteria,Potenza batteria,"
    "Stato di carica",
    "dutch": "Tijd,Snelheid,Spanning batterij,Stroom batterij,Vermogen batterij,Laadtoestand",
    "danish": "Tid,Hastighed,Batterispænding,Batteristrøm,Batteri effekt,SoC",
    "swedish": "Tid,Hastighet,Batterispänning,Batteri ström,Batteri effekt,SoC",
    "polish": "Czas,Prędkość,Napięcie baterii,Prąd baterii,Moc baterii,Stan naładowania",
    "czech": "Čas,Rychlost,Napětí baterie,Proud baterie,Výkon baterie,Stav nabití",
    "russian": "Время,Скорость,Напряжение,Ток,Мощность,SoC",
    "chinese": "时间,车速,总电压,总电流,功率,SOC",
}
SPEEDS = {"km/h": 3.6, "mph": 1 / 0.44704, "m/s": 1.0, "kn": 3600 / 1852}
VOLTAGES, CURRENTS, POWERS = {"V": 1.0, "mV": 1e3}, {"A": 1.0, "mA": 1e3}, {"kW": 1e-3, "W": 1.0}
DISTANCES = {"km": 1e-3, "mi": 1 / 1609.344}
DECOYS = {
    "Motor Power (kW)": 3.0,
    "12V Battery Voltage (V)": 13.9,
    "DC-DC Current (A)": 21.0,
    "Cell voltage max (V)": 3.91,
    "Speed limit (km/h)": 50.0,
    "Coolant temperature (°C)": 31.5,
    "Charger current (A)": 0.0,
    "Motor rpm": 5210.0,
    "Battery corrected voltage (V)": 402.0,
    "Open circuit voltage (V)": 398.0,
    "Watt hours used": 55.0,
    "Ah since start": 7.0,
}
# Names of what is drawn and of what flows back, in columns of their own.
ONE_WAY = "Battery discharge current", "Battery charge current"
FAULTS = (
    *("lost signs", "clipped", "speed 0", "constant voltage", "backwards", "one way", "whole"),
    *("frozen", "bridged"),
)
DOUBTED = FAULTS[:4]  # by which the log alone does not tell what is right
SHORTEST_FROZEN, SHORTEST_BRIDGED = 20.0, 60.0  # s
LEAST_BRIDGED = 0.2  # of the largest speed and current
SHORTEST_TOLD = 240.0  # s of a car's battery that tell driving from standing
SLOWEST_TOLD = 2.0  # s between rows, up to which lone signs are told from hills
START = datetime(2024, 3, 5, 9, 8, 9)
Clock = Callable[[float], str]
Rows = list[list[str]]


def _date(pattern: str, hours: float = 0.0) -> Clock:
    def written(seconds: float) -> str:
        moment = START + timedelta(hours=hours, seconds=seconds)
        return moment.strftime(pattern).replace("%L", f"{moment.microsecond // 1000:03d}")

    return written


EPOCH = 1_709_629_689
CLOCKS: dict[str, tuple[str, Clock]] = {
    "iso": ("", _date("%Y-%m-%dT%H:%M:%S.%LZ")),
    "german": ("", _date("%d.%m.%Y %H:%M:%S.%L")),
    "american": ("", _date("%m/%d/%Y %I:%M:%S.%L %p")),
    "seconds only": ("", _date("%Y-%m-%d %H:%M:%S")),
    "minutes only": ("", _date("%Y-%m-%d %H:%M")),
    "time of day": ("", _date("%H:%M:%S.%L")),
    "12 hours": ("", _date("%I:%M:%S.%L", 3.85)),
    "12 hours, dated": ("", _date("%Y-%m-%d %I:%M:%S.%L", 3.85)),
    "since 1970": ("", lambda seconds: f"{EPOCH + seconds:.2f}"),
    "since 1970, ms": ("", lambda seconds: f"{1000 * (EPOCH + seconds):.0f}"),
    "since start": ("s", lambda seconds: f"{seconds:.2f}"),
    "since start, ms": ("ms", lambda seconds: f"{1000 * seconds:.0f}"),
    "since start, ms under s": ("s", lambda seconds: f"{1000 * seconds:.0f}"),
    "since start, min": ("min", lambda seconds: f"{seconds / 60:.6f}"),
}
MISSING = ("", "NaN", "N/A", "null", "-")


@dataclass
class Export:
    """A table of a drive, and what is right."""

    data: bytes
    drive: Drive
    drive_columns: tuple[str, ...] = ()
    refused: bool = False  # a person could not read it either, or would have to choose
    doubtful: bool = False  # a person would doubt it
    kind: dict[str, object] = field(default_factory=dict)  # choices, for messages


def random_export(seed: int) -> Export:
    """The export of a seed."""
    chance = random.Random(seed)
    step = chance.choice([0.2, 0.5, 1.0, 1.0, 1.0, 2.0, 5.0])
    light = chance.random() < 0.1
    drive = simulated(
        count=chance.randrange(300, 500),
        step=step,
        mass=chance.uniform(150, 350) if light else chance.uniform(1200, 2600),
        volts=chance.choice([24.0, 48.0]) if light else chance.uniform(280, 750),
        seed=seed,
    )
    export = Export(b"", drive)
    separator = chance.choice([",", ",", ";", "\t", "|"])
    comma = chance.random() < 0.35
    quoted = chance.choice(["none", "needed", "needed", "all"])
    clock = chance.choice(sorted(CLOCKS))
    if clock == "seconds only" and step > 1.0:
        clock = "iso"
    if clock == "since start, ms under s" and step > SLOWEST_TOLD:
        clock = "iso"
    if clock == "minutes only" and drive.time[-1] < 240.0:
        clock = "iso"
    language = chance.choice(sorted(LANGUAGES))
    fault = chance.choice(["", "", *FAULTS])
    is_short = light or drive.time[-1] < SHORTEST_TOLD
    if fault == "frozen" and drive.time[-1] - drive.time[_freezes(drive)] < SHORTEST_FROZEN:
        fault = ""
    if fault == "bridged" and _bridge(drive) is None:
        fault = ""
    if (fault == "lost signs" and step > SLOWEST_TOLD) or (fault == "speed 0" and is_short):
        fault = ""
    export.doubtful = fault in DOUBTED
    logged = _logged(drive, fault, seed)
    ends = {0, drive.time.size - 1}
    if fault == "frozen":  # what the log has of the drive
        ends.add(_freezes(drive))
        export.drive = drive.rows(np.arange(_freezes(drive) + 1))
    if fault == "bridged" and (bridge := _bridge(drive)):
        ends |= set(bridge)
        first, after = bridge
        export.drive = drive.rows(np.r_[: first + 1, after : drive.time.size])
    columns = _columns(chance, logged, fault, LANGUAGES[language].split(","), CLOCKS[clock], clock)
    export.kind = {
        "seed": seed, "step": step, "light": light, "separator": separator, "comma": comma,
        "quoted": quoted, "clock": clock, "language": language, "columns": list(columns),
        "fault": fault,
    }  # fmt: skip
    names = list(columns)
    export.drive_columns = tuple(names[:3])
    chance.shuffle(names)
    rows = _rows(chance, drive, names, columns, ends, comma=comma)
    layout = chance.choice(["wide"] * 6 + ["polled", "long"])
    if layout != "wide" and not clock.endswith("only"):
        time = names.index(next(iter(columns)))
        names, rows = (_polled if layout == "polled" else _long)(names, rows, time)
        export.kind["layout"] = layout
    lines = [_line(row, separator, quoted) for row in [names, *rows]]
    if quoted == "none" and separator == "," and comma:
        export.refused = True  # it may be read, where there is one way to do it
    if "layout" not in export.kind:
        _disturb(chance, export, lines, names, rows, separator, quoted)
    end = chance.choice(["\n", "\r\n"])
    encoding = chance.choice(["utf-8", "utf-8", "utf-8-sig", "utf-16"])
    export.data = (end.join(lines) + end).encode(encoding)
    return export


def _logged(drive: Drive, fault: str, seed: int) -> Drive:
    """The drive as a log with a fault has it."""
    noise, current = np.random.default_rng(seed), drive.current
    power = drive.voltage * current
    if fault == "lost signs":
        lost = (current < 0.0) & (noise.random(current.size) < noise.choice([0.2, 0.33, 0.5]))
        return replace(drive, current=np.where(lost, -current, current))
    if fault == "clipped":  # the voltage with it, so that the power has one largest value too
        most = noise.choice([0.4, 0.6]) * float(power.max())
        volts = np.full(power.size, drive.voltage.mean())
        return replace(drive, current=np.minimum(power, most) / volts, voltage=volts)
    if fault == "speed 0":
        return replace(drive, speed=np.zeros(current.size))
    if fault == "constant voltage":
        volts = noise.choice([0.85, 1.15]) * float(drive.voltage.mean())
        return replace(drive, voltage=np.full(current.size, volts))
    if fault == "backwards":
        return replace(drive, speed=-drive.speed)
    if fault == "frozen":
        last, there = np.arange(current.size), _freezes(drive)
        rows = np.minimum(last, there)
        names = ("speed", "voltage", "current", "odometer", "charge")
        return replace(drive, **{name: getattr(drive, name)[rows] for name in names})
    if fault == "bridged" and (bridge := _bridge(drive)):
        return drive.bridged(*bridge)
    if fault == "whole":
        return replace(drive, speed=np.rint(3.6 * drive.speed) / 3.6)
    return drive


def _freezes(drive: Drive) -> int:
    """The last row before an adapter is lost while the car moves, in the second half."""
    half = drive.time.size // 2
    return half + int(np.argmax(drive.speed[half:] > 5.0))


def _bridge(drive: Drive) -> tuple[int, int] | None:
    """Rows before and after a hole that an exporter fills with lines that rise or fall."""
    first = _freezes(drive)
    changes = [
        np.abs(of - of[first]) > LEAST_BRIDGED * np.abs(of).max()
        for of in (drive.speed, drive.current)
    ]
    fits = changes[0] & changes[1] & (drive.time > drive.time[first] + SHORTEST_BRIDGED)
    fits[-1] = False
    return (first, int(np.argmax(fits))) if fits.any() else None


def _polled(
    names: list[str], rows: list[list[str]], time: int
) -> tuple[list[str], list[list[str]]]:
    """The table with one signal a row."""
    polled = []
    for row in rows:
        for place, cell in enumerate(row):
            if place != time:
                cells = [""] * len(row)
                cells[time], cells[place] = row[time], cell
                polled.append(cells)
    return names, polled


def _long(names: list[str], rows: Rows, time: int) -> tuple[list[str], Rows]:
    """The table with time, name, value and unit in a row."""
    parts = [name.replace("[", "(").rstrip(")]").partition("(") for name in names]
    known = [(name.strip(), unit) for name, _, unit in parts]
    return [names[time], "PID", "VALUE", "UNITS"], [
        [row[time], known[place][0], cell, known[place][1]]
        for row in rows
        for place, cell in enumerate(row)
        if place != time
    ]


Column = Callable[[int], str | float]


def _columns(
    chance: random.Random,
    drive: Drive,
    fault: str,
    words: list[str],
    clock: tuple[str, Clock],
    kind: str,
) -> dict[str, Column]:
    """What to write for a moment, by the name of the column."""
    time, speed, voltage, current, power, charge = words
    bracket = chance.choice(["{} ({})", "{} [{}]", "{}({})", "{}"])

    def named(name: str, unit: str, *, always: bool = False) -> str:
        return (bracket if not always or bracket != "{}" else "{} ({})").format(name, unit)

    unit, written = clock
    columns: dict[str, Column] = {
        named(time, unit, always=kind == "since start, min") if unit else time: (
            lambda i: written(float(drive.time[i]))
        )
    }
    unit = chance.choice([*SPEEDS, "km/h", "km/h"])
    factor = SPEEDS[unit]
    columns[named(speed, unit, always=unit == "kn")] = lambda i: factor * drive.speed[i]
    sign = chance.choice([1.0, 1.0, -1.0])
    if fault == "one way":
        volt, amp = chance.choice(sorted(VOLTAGES)), chance.choice(["A", "mA"])
        columns[named(voltage, volt)] = lambda i: VOLTAGES[volt] * drive.voltage[i]
        for name, way in zip(ONE_WAY, (1.0, -1.0), strict=True):
            columns[named(name, amp)] = lambda i, way=way: (
                CURRENTS[amp] * max(way * drive.current[i], 0.0)
            )
    elif chance.random() < 0.2 and fault not in ("constant voltage", "bridged"):
        unit = chance.choice(sorted(POWERS))
        by = sign * POWERS[unit]
        columns[named(power, unit)] = lambda i: by * drive.voltage[i] * drive.current[i]
    else:
        volt, amp = chance.choice(sorted(VOLTAGES)), chance.choice(["A", "A", "A", "mA"])
        columns[named(voltage, volt)] = lambda i: VOLTAGES[volt] * drive.voltage[i]
        columns[named(current, amp)] = lambda i: sign * CURRENTS[amp] * drive.current[i]
    if chance.random() < 0.6:
        columns[named(charge, "%")] = lambda i: float(drive.charge[i])
    if chance.random() < 0.4:
        length = chance.choice(sorted(DISTANCES))
        columns[named("Odometer", length)] = lambda i: DISTANCES[length] * drive.odometer[i]
    for name in chance.sample(sorted(DECOYS), chance.randrange(4)):
        columns[name] = _decoy(DECOYS[name])
    return columns


def _decoy(value: float) -> Column:
    return lambda i: value * (1.0 + 0.1 * math.sin(i / 7.0))


def _rows(
    chance: random.Random,
    drive: Drive,
    names: list[str],
    columns: dict[str, Column],
    ends: set[int],
    *,
    comma: bool,
) -> Rows:
    """The cells of all moments: some are missing, but for those at the ends of what is right."""
    digits, missing = chance.choice([2, 2, 3]), chance.choice(MISSING)
    share = chance.choice([0.0, 0.0, 0.01])
    last = drive.time.size - 1

    def written(i: int, name: str) -> str:
        value = columns[name](i)
        if not isinstance(value, str):
            if 0 < i < last and chance.random() < share and i not in ends:
                return missing
            value = f"{value:.{digits}f}"
        is_number = value.count(".") == 1 and ":" not in value
        return value.replace(".", ",") if comma and is_number else value

    rows = [[written(i, name) for name in names] for i in range(last + 1)]
    if chance.random() < 0.1:  # what a bus sends in place of a measurement
        place = next((k for k, name in enumerate(names) if name.endswith(("(V)", "[V]"))), None)
        if place is not None and "12V" not in names[place] and "Cell" not in names[place]:
            rows[last // 3][place] = "6553,5" if comma else "6553.5"
    return rows


def _line(cells: list[str], separator: str, quoted: str) -> str:
    def written(cell: str) -> str:
        needs = quoted == "all" or (quoted == "needed" and separator in cell)
        return f'"{cell}"' if needs else cell

    return separator.join(map(written, cells))


def _disturb(
    chance: random.Random,
    export: Export,
    lines: list[str],
    names: list[str],
    rows: Rows,
    separator: str,
    quoted: str,
) -> None:
    """Another header, another car, rows in another order or torn."""
    kinds = ["header", "order", "unit", "cars", "newest", "torn", "ended", "units", "sep"]
    what = chance.choice(["", "", "", "", *kinds])
    export.kind["disturbed"] = what
    middle = len(lines) // 2
    if what == "header":
        lines.insert(middle, lines[0])
    elif what == "order":
        places = chance.sample(range(len(names)), len(names))
        turned = [[row[place] for place in places] for row in [names, *rows[middle - 1 :]]]
        lines[middle:] = [_line(row, separator, quoted) for row in turned]
    elif what == "unit":
        place = next((i for i, name in enumerate(names) if name in export.drive_columns), 0)
        other = [f"{name} (raw)" if i == place else name for i, name in enumerate(names)]
        lines.insert(middle, _line(other, separator, quoted))
        export.refused = True
    elif what == "cars":
        name = chance.choice(["vehicle", "id", "device", "plate", "asset", "bus no"])
        lines[:] = [
            separator.join([name if i == 0 else "AB 12" if i < middle else "CD 34", line])
            for i, line in enumerate(lines)
        ]
        export.refused = True
    elif what == "newest":
        lines[1:] = lines[:0:-1]
    elif what == "ended":
        lines[:] = [line + separator for line in lines]
    elif what == "units":
        bare = [name.replace("[", "(").partition("(")[0].strip() for name in names]
        units = [name.replace("[", "(").partition("(")[2].strip(")]") for name in names]
        lines[:1] = [_line(bare, separator, quoted), _line(units, separator, quoted)]
    elif what == "sep" and separator != "|":
        lines.insert(0, f"sep={separator}")
    elif what == "torn":
        at = chance.randrange(1, len(lines))
        lines[at] = lines[at][: len(lines[at]) // 2]
