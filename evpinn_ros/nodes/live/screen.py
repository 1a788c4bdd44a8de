"""The live view as a screen of text, as a line, and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from typing import Any, NamedTuple

from rich.cells import set_cell_size
from rich.text import Text

from evpinn_ros import topics
from evpinn_ros.common.errors import printable
from evpinn_ros.common.units import KMH, fixed
from evpinn_ros.core.estimation.estimate import FIGURES
from evpinn_ros.core.estimation.operating_range import MANNERS, SPEED_EDGES
from evpinn_ros.core.vehicle.parameters import QUANTITIES
from evpinn_ros.nodes.live.data import BIN_NS, NOTHING, POWERS, LiveData, ParameterRow
from evpinn_ros.topics.messages import Level

TITLE, HEADING, FAINT = "bold reverse", "bold", "dim"
STATE_STYLES = {"valid": "green", "estimating": "yellow", "stale": "red", "invalid": "bold red"}
LEVEL_STYLES = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red"}
POWER_STYLES = {"measured": "cyan", "predicted": "magenta"}
BARS = "▁▂▃▄▅▆▇█"
RATES = {
    "speed": topics.SPEED,
    "battery": topics.BATTERY,
    "predicted": topics.POWER_PREDICTED,
    "parameters": topics.PARAMETERS,
}

WIDE = 76  # characters from which every column is shown
AXIS_WIDTH = 6
MOST_CHART_ROWS, MOST_PROBLEMS, MOST_BREAKDOWN_ROWS = 6, 3, 2
BESIDE = {"measured", "regained"}  # of the breakdown: not parts of the sum
UNKNOWN = "-"
GREATEST = 1e7  # largest number shown in full
BEYOND_ANY_CAR = 1e9  # W
BRAILLE = 0x2800  # the character without dots
# Bit of each dot of a character: column, then row from the top.
DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
DOT_COLUMNS, DOT_ROWS = len(DOTS), len(DOTS[0])  # of one character


class ScreenColumn(NamedTuple):
    """A column of the table of parameters."""

    title: str
    width: int
    wide_only: bool = False


COLUMNS = (
    ScreenColumn("", 6),
    ScreenColumn("meaning", 13, wide_only=True),
    ScreenColumn("value", 9),
    ScreenColumn("1-sigma", 9),
    ScreenColumn("bounds", 19, wide_only=True),
    ScreenColumn("prior", 6),
    ScreenColumn("data", 6),
)


def screen(data: LiveData, now: float, width: int, height: int) -> Text:
    """The view in `width` x `height` characters; less important rows are left out."""
    problems = data.problems(now)
    breakdown = list(_breakdown(data, width))
    # Rows that each part needs, the most important part first.
    needs = {
        "title": 1,
        "problems": min(len(problems), 1),
        "owner": 1,
        "breakdown": len(breakdown),
        "parameters": 1 + len(data.parameters()),
        "power": 1 + len(POWERS),
        "coverage": 1 + len(MANNERS),
    }
    kept, left = set(), height
    for name, rows in needs.items():
        if rows <= left:
            kept.add(name)
            left -= rows
    more_problems = min(max(len(problems) - 1, 0), MOST_PROBLEMS - 1, left)
    chart_rows = min(1 + (left - more_problems) // len(POWERS), MOST_CHART_ROWS)
    parts: dict[str, Iterable[Text]] = {
        "title": [_title(data, now, width)],
        "owner": [_owner(data)],
        "breakdown": breakdown,
        "parameters": _parameters(data, width),
        "power": _power(data, now, width, chart_rows),
        "coverage": _coverage(data, now, width),
        "problems": [
            Text(f"! {printable(text)}", LEVEL_STYLES.get(level, LEVEL_STYLES[Level.ERROR]))
            for level, text in problems[: 1 + more_problems]
        ],
    }
    lines = [line for name, part in parts.items() if name in kept for line in part]
    for line in lines:
        line.truncate(width, overflow="ellipsis")
    return Text("\n").join(lines)


def plain_line(data: LiveData, now: float) -> str:
    """The values of the view as one line."""
    if not data.received:
        return NOTHING
    parts = [_speed(data, now), _owner(data).plain]
    for topic, name in POWERS.items():
        power = data.power(topic, now)
        parts.append(f"{name} {_kilowatts(power.value)}{_sigma(power.sigma)} kW drawn")
    parts.append(f"Wh went to {', '.join(_amounts(data)) or UNKNOWN}")
    parts += [
        f"{row.name} {_parameter(row, row.value)} +- {_parameter(row, row.std)}"
        + (f" {row.state}" if row.state else "")
        for row in data.parameters()
        if math.isfinite(row.value)
    ]
    return "; ".join(parts)


def problem_lines(data: LiveData, now: float) -> list[str]:
    """A line for each problem."""
    return [f"{level.name.lower()}: {text}" for level, text in data.problems(now)]


def _title(data: LiveData, now: float, width: int) -> Text:
    battery = data.fresh_battery(now)
    right = f"{_speed(data, now)} "
    if battery is not None:
        drawn = f"{_number(0.0 - battery.current, 1)} A drawn"  # sign as of power: + is drawn
        right = f"{_number(battery.voltage, 0)} V  {drawn}  {right}"
    room = max(width - len(right) - 1, 0)
    silent = "estimator silent" if data.received else "no nodes"
    left = set_cell_size(f" evpinn  {data.activity(now) or silent}", room)
    return Text(f"{left} {right}", style=TITLE)


def _speed(data: LiveData, now: float) -> str:
    return f"{_number(data.fresh_speed(now) * data.units.speeds, 1)} {data.units.speed}"


def _parameters(data: LiveData, width: int) -> Iterable[Text]:
    columns = [column for column in COLUMNS if width >= WIDE or not column.wide_only]
    yield Text(f"{_row(columns, {c.title: c.title for c in columns})} state", style=HEADING)
    for row in data.parameters():
        bounds = f"{_parameter(row, row.lower, '')} .. {_parameter(row, row.upper, '')}"
        texts = {
            "": row.name,
            "meaning": QUANTITIES[row.name].word.removesuffix(" efficiency"),
            "value": _parameter(row, row.value),
            "1-sigma": _parameter(row, row.std),
            "bounds": bounds if math.isfinite(row.lower) else UNKNOWN,
            "prior": _percent(100 * row.prior_share),
            "data": _percent(row.progress),
        }
        shown = row.state or UNKNOWN
        yield Text(f"{_row(columns, texts)} ").append(shown, STATE_STYLES.get(row.state, FAINT))


def _row(columns: Iterable[ScreenColumn], texts: Mapping[str, str]) -> str:
    words = ("", "meaning")
    return "".join(_cell(texts[c.title], c.width, right=c.title not in words) for c in columns)


def _power(data: LiveData, now: float, width: int, rows: int) -> Iterable[Text]:
    room = max(width - AXIS_WIDTH, 0)
    bins = room * DOT_COLUMNS
    lines = {name: data.line.last(name, bins) for name in POWERS.values()}
    axis = power_axis([value for line in lines.values() for value in line])
    heading = Text("kW drawn", style=HEADING)
    for topic, name in POWERS.items():
        power = data.power(topic, now)
        heading.append(f"  {name} ", "not bold")
        heading.append(f"{_kilowatts(power.value)}{_sigma(power.sigma)}", POWER_STYLES[name])
    coverage = data.band_coverage()
    if math.isfinite(coverage):
        heading.append(f"  {100 * coverage:.0f} % in band", f"not bold {FAINT}")
    heading.append(f"  {bins * BIN_NS / 1e9:.0f} s", f"not bold {FAINT}")
    yield heading
    for name, values in lines.items():
        for index, dots in enumerate(braille_line(values, room, rows, axis)):
            ends = {0: axis[1], rows - 1: axis[0]} if rows > 1 else {0: axis[1]}
            label = f"{ends[index] / 1e3:g}" if index in ends else ""
            yield Text(_cell(label, AXIS_WIDTH - 1, right=True) + " ", FAINT).append(
                dots, f"not dim {POWER_STYLES[name]}"
            )


def power_axis(values: Sequence[float]) -> tuple[float, float]:
    """Round ends, W, of an axis that contains zero and all plausible values; NaN is ignored."""
    plausible = [value for value in values if abs(value) < BEYOND_ANY_CAR]
    low, high = min([0.0, *plausible]), max([0.0, *plausible])
    span = max(high - low, 1000.0)
    step = 10.0 ** math.floor(math.log10(span))
    step = next((step / n for n in (5, 2) if span / step * n <= 8), step)
    return math.floor(low / step) * step, max(math.ceil(high / step), 1) * step


def braille_line(
    values: Sequence[float], width: int, height: int, axis: tuple[float, float]
) -> list[str]:
    """Rows of Braille from the top, with two values per character, oldest first; NaN is a gap."""
    low, high = axis
    cells = [[0] * width for _ in range(height)]
    last_row = height * DOT_ROWS - 1
    before: int | None = None
    for column, value in enumerate(values[: width * DOT_COLUMNS]):
        if not math.isfinite(value):
            before = None
            continue
        share = min(max((value - low) / (high - low), 0.0), 1.0)
        row = round((1.0 - share) * last_row)
        # Joined to the previous value, without a second dot beside its dot.
        step = 0 if before is None or before == row else (1 if row > before else -1)
        first = row if before is None or not step else before + step
        for dot in range(min(first, row), max(first, row) + 1):
            cell, bit = column // DOT_COLUMNS, DOTS[column % DOT_COLUMNS][dot % DOT_ROWS]
            cells[dot // DOT_ROWS][cell] |= bit
        before = row
    return ["".join(chr(BRAILLE + cell) for cell in row) for row in cells]


def _owner(data: LiveData) -> Text:
    energy = data.vector(topics.ENERGY_STATE)
    words = (
        f"  {_percent(100 * data.charge())}",
        f"  range {_range(data)}",
        f"  {_number(data.consumption() * data.units.metres / 1e3, 0)} Wh/{data.units.distance}",
        f"  used {_watt_hours(energy, 'consumed')} Wh",
        f"  regained {_watt_hours(energy, 'regenerated')} Wh",
    )
    return Text("charge", style=HEADING).append("".join(words), "not bold")


def _range(data: LiveData) -> str:
    """Distance to empty with its 90 % band; while unknown, the distance from which on it is."""
    values = data.vector(topics.ENERGY_RANGE)
    ends = ("to_empty", "lower", "upper")
    metres = (values.get(f"distance_{end}", math.nan) for end in ends)
    middle, low, high = (_number(far / data.units.metres, 0) for far in metres)
    if "distance_to_empty" in values:
        return f"{middle} {data.units.distance} ({low}-{high})"
    least = f"from {1e4 / data.units.metres:.0f} {data.units.distance} on"
    return UNKNOWN if math.isnan(data.charge()) else least


def _breakdown(data: LiveData, width: int) -> Iterable[Text]:
    title = "Wh went to"
    rows = [""]
    for amount in _amounts(data) or [UNKNOWN]:
        if rows[-1] and len(title) + len(rows[-1]) + len(amount) + 2 > width:
            rows.append("")
        rows[-1] += f"  {amount}"
    for index, row in enumerate(rows[:MOST_BREAKDOWN_ROWS]):
        head = title if index == 0 else " " * len(title)
        yield Text(head, style=HEADING).append(row, "not bold")


def _amounts(data: LiveData) -> list[str]:
    """Text of each part of the energy with its 1-sigma, Wh, the largest first."""
    values = data.vector(topics.ENERGY_BREAKDOWN)
    sigmas = data.sigmas(topics.ENERGY_BREAKDOWN)
    names = sorted(set(values) - BESIDE, key=lambda name: -abs(values[name]))
    return [
        f"{printable(name)} {_watt_hours(values, name)}+-{_watt_hours(sigmas, name)}"
        for name in names
        if values[name] or sigmas.get(name)
    ]


def _coverage(data: LiveData, now: float, width: int) -> Iterable[Text]:
    seen = data.seen()
    most = max([1.0, *(n for row in seen for n in row if math.isfinite(n))])
    cell, gap = (8, 4 * " ") if width >= WIDE else (6, " ")
    rates = [f"{gap}{name} {data.rate(topic, now):.1f}/s" for name, topic in RATES.items()]
    limits = [f"{edge * KMH * data.units.speeds:.0f}" for edge in SPEED_EDGES]
    titles = (*(f"<{limit}" for limit in limits), f">{limits[-1]}")
    heading = "".join(_cell(title, cell, right=True) for title in titles)
    yield (
        Text(_cell(f"samples {data.units.speed}", 12), HEADING)
        .append(heading, "not bold")
        .append(rates[0], f"not bold {FAINT}")
    )
    for manner, row, rate in zip(MANNERS, seen, rates[1:], strict=True):
        line = Text(_cell(manner, 12))
        for count in row:
            line.append(_cell(_count(count, most), cell, right=True), "" if count > 0 else FAINT)
        yield line.append(rate, FAINT)


def _count(count: float, most: float) -> str:
    if not math.isfinite(count):
        return UNKNOWN
    if count <= 0:
        return "."
    short = f"{count:.0f}" if count < 1000 else f"{count / 1000:.3g}k"
    return BARS[min(int(count / most * len(BARS)), len(BARS) - 1)] + short


def _parameter(row: ParameterRow, value: float, unit: str | None = None) -> str:
    if not abs(value) < GREATEST:
        return UNKNOWN if not math.isfinite(value) else f"{value:.1e}"
    text = QUANTITIES[row.name].text(value)
    return text if unit is None else text.removesuffix(f" {QUANTITIES[row.name].unit}") + unit


def _percent(value: float) -> str:
    return f"{value:.0f} %" if abs(value) < GREATEST else UNKNOWN


def _watt_hours(energies: Mapping[str, float], name: str) -> str:
    return _number(energies.get(name, math.nan) / 3600, 0)


def _kilowatts(watts: float) -> str:
    return _number(watts / 1e3, 1)


def _sigma(watts: float) -> str:
    return f" +- {_kilowatts(watts)}" if 50 <= watts < math.inf else ""


def _number(value: float, decimals: int) -> str:
    if not math.isfinite(value):
        return UNKNOWN
    if abs(value) >= GREATEST:
        return f"{value:.1e}"
    return fixed(value, decimals)


def _cell(text: str, width: int, *, right: bool = False) -> str:
    short = text if len(text) <= width else text[: width - 1] + "…"
    return short.rjust(width) if right else short.ljust(width)


def as_json(data: LiveData, now: float) -> dict[str, Any]:
    """Values of the view for `evpinn watch --json`, in SI; None or NaN if unknown."""
    battery = data.fresh_battery(now)
    parts, sigmas = data.vector(topics.ENERGY_BREAKDOWN), data.sigmas(topics.ENERGY_BREAKDOWN)
    return {
        "speed_mps": data.fresh_speed(now),
        "voltage_v": battery.voltage if battery else None,
        "current_a": battery.current if battery else None,
        "power_w": {name: _estimate(*data.power(topic, now)) for topic, name in POWERS.items()},
        "receiving": data.received,
        "state_of_charge": data.charge(),
        "wh_per_km": data.consumption(),
        "energy_j": data.vector(topics.ENERGY_STATE),
        "breakdown_j": {
            name: _estimate(value, sigmas.get(name, math.nan)) for name, value in parts.items()
        },
        "consumption": data.vector(topics.ENERGY_CONSUMPTION),
        "range_m": data.vector(topics.ENERGY_RANGE),
        "parameters": {
            row.name: {name: getattr(row, name) for name in FIGURES} | {"state": row.state or None}
            for row in data.parameters()
        },
        "per_second": {name: data.rate(topic, now) for name, topic in RATES.items()},
        "doing": data.activity(now) or None,
        "problems": [
            {"level": level.name.lower(), "text": text} for level, text in data.problems(now)
        ],
    }


def _estimate(value: float, std: float) -> dict[str, float]:
    return {"value": value, "std": std}
