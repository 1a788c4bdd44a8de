"""Writes sentences on columns that contradict each other or the car, and on uncertain totals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from evpinn_ros.core.signals.detector import DRAWN_AT_REST
from evpinn_ros.logs.column import Column
from evpinn_ros.logs.signal import (
    EVENT,
    LEAST_EVENTS,
    Signal,
    accelerations,
    at_times,
    battery_power,
    correlation,
    pull,
)

ALIKE = 0.5  # correlation from which on two powers are the same, up to sign and size
RISES = 0.7  # correlation with braking from which on a power is that of braking
SAME_SIZE = (0.5, 2.0)  # ratio of two powers that are the same
LONGEST_PAIR = 2.5  # s between a power and its neighbours that imply its sign
STRONG = 0.3  # share of most returned powers: above noise
MIRRORED = 0.4  # share by which a power without its sign differs from its neighbours
LEAST_LOST = 3  # powers needed to judge
LEAST_LONE, LONE = 2, 0.035  # positive powers between two negative ones, and their share
LEAST_BRAKED, BRAKED = 10, 0.12  # s of hard braking, and their share
LEAST_CLIPPED, CLIPPED = 10, 0.01  # values at the largest one, and their share
BEYOND = 1.1  # fitted mean power over the largest power, above which that is clipped
HARD_ON = 10_000.0  # W from which on a battery's voltage drops by some V
LIGHT_BELOW, HARD_ON_LIGHT = 60.0, 25.0  # V, and A of such a battery, for the same
LEAST_TURNS, TURNS = 50, 100  # readings that show whether two batteries alternate
ONE_SIDED, TURN = 0.6, 0.01  # at most 0.25 by chance in given logs; share of the value
BEYOND_NEXT = 0.6  # share of the change over two steps: half of it where rows repeat
LONGEST_HELD = 60.0  # s for which a slow poll or an app may repeat a voltage
CONSTANT = 1e-3  # share of the voltage


def contradictions(used: Mapping[str, Column], cells: Mapping[str, Signal]) -> Iterator[str]:
    """Sentences on columns that contradict each other, or the car; cells in file units."""
    signals = {name: column.in_si(cells[name]) for name, column in used.items()}
    drawn = battery_power(signals)
    if drawn is None:
        return
    if {"power", "voltage", "current"} <= signals.keys():
        yield from _compared(used["power"], signals["power"], drawn)
    yield from never_back(drawn, signals["speed"])


def doubts(used: Mapping[str, Column], cells: Mapping[str, Signal]) -> Iterator[str]:
    """Sentences on why totals of energy are uncertain; cells in file units."""
    signals = {name: column.in_si(cells[name]) for name, column in used.items()}
    drawn = battery_power(signals)
    if drawn is None:
        return
    column = used["current" if {"voltage", "current"} <= used.keys() else "power"]
    if pull(signals["speed"], drawn) < 0.0:
        remedy = f"--column '{column.quantity}={column.name}:{column.turned_unit}' turns it"
        yield wrong_sign(repr(column.name), remedy)
    elif column.could_be and column.why:
        yield column.assumption.partition(": ")[2]
    yield from energy_doubts(signals, repr(column.name))


def energy_doubts(signals: Mapping[str, Signal], of: str) -> Iterator[str]:
    """Sentences on lost signs, offsets, limits and a constant voltage; SI."""
    drawn, speed = battery_power(signals), signals["speed"]
    if drawn is None:
        return
    yield from unsigned(drawn, speed)
    yield from drawn_at_rest(drawn, speed)
    yield from lost_signs(drawn, speed, of)
    for name in ("voltage", "current"):
        if name in signals and takes_turns(signals[name]):
            yield (
                f"the {name} changes between two values with every reading: two batteries seem to "
                "take turns, so every energy is wrong"
            )
    if {"voltage", "current"} <= signals.keys():
        yield from clipped(signals["current"], speed, of, (1.0, "A"))
        yield from constant_voltage(signals["voltage"], signals["current"])
    else:
        yield from clipped(drawn, speed, of, (1e-3, "kW"))


def wrong_sign(of: str, remedy: str) -> str:
    """Sentence on a current or power that contradicts the car's acceleration."""
    return (
        f"the car speeds up while its battery is charged: the sign of {of} is probably wrong; "
        f"{remedy}"
    )


def never_back(drawn: Signal, speed: Signal) -> Iterator[str]:
    """Sentence on a battery that is never charged, SI: regenerative braking is missing."""
    if _is_one_way(drawn) and not _rises_while_braking(drawn, speed):
        yield (
            "no current ever flows back into the battery, so nothing is known of its "
            "regeneration (mu); if the car regenerates, every energy is too large"
        )


def unsigned(drawn: Signal, speed: Signal) -> Iterator[str]:
    """Sentence on an unsigned power, SI."""
    if _is_one_way(drawn) and _rises_while_braking(drawn, speed):
        yield (
            "the harder the car brakes, the more the battery seems to give: the current has lost "
            "its sign, so every energy is too large"
        )


def _is_one_way(drawn: Signal) -> bool:
    power = drawn.known
    return bool(power.size >= LEAST_EVENTS and power.min() >= 0.0 and np.ptp(power))


def drawn_at_rest(drawn: Signal, speed: Signal) -> Iterator[str]:
    """Sentence on a battery that gives more than heating at rest, SI: it has an offset."""
    at_rest = drawn.value[(at_times(speed, drawn.time) == 0.0) & np.isfinite(drawn.value)]
    if at_rest.size >= LEAST_EVENTS and (power := float(np.median(at_rest))) > DRAWN_AT_REST.on:
        yield (
            f"the battery gives {power / 1e3:.0f} kW while the car stands: the current has an "
            "offset or a wrong unit or sign, so every energy is wrong"
        )


def takes_turns(signal: Signal) -> bool:
    """True if values alternate between larger and smaller, for long and clearly."""
    value = np.abs(signal.known)
    away = value[1:-1] - 0.5 * (value[:-2] + value[2:])
    size = min(TURNS, away.size)
    if size < LEAST_TURNS:
        return False
    far = max(TURN * np.median(value), BEYOND_NEXT * np.median(np.abs(value[2:] - value[:-2])))
    if np.median(np.abs(away)) <= far:
        return False
    sides = np.sign(away[::2][: away.size // 2]) - np.sign(away[1::2])
    windows = 0.5 * sides[: sides.size // (size // 2) * (size // 2)].reshape(-1, size // 2)
    return bool(np.median(np.abs(windows.mean(axis=1))) > ONE_SIDED)


def lost_signs(drawn: Signal, speed: Signal, of: str) -> Iterator[str]:
    """Sentence on a power, SI, part of whose returned power has lost its sign."""
    time, power = drawn.points()
    taken = -power[power < 0.0]
    if taken.size < LEAST_LOST or power.size < LEAST_EVENTS:
        return
    size = np.abs(power)
    large = size > STRONG * np.quantile(taken, 0.9)
    beside = (size[:-2] + size[2:]) / 2.0
    # Three powers in a row of similar size, the middle one of the opposite sign.
    near = time[2:] - time[:-2] <= 2.0 * LONGEST_PAIR
    smooth = large[:-2] & large[1:-1] & large[2:] & near
    smooth &= np.abs(size[1:-1] - beside) < MIRRORED * beside
    smooth &= np.abs(size[2:] - size[:-2]) < beside
    smooth &= at_times(Signal(*accelerations(speed)), time[1:-1]) < -EVENT
    back = power < 0.0
    lone = smooth & (back[:-2] == back[2:]) & (back[1:-1] != back[2:])
    smooth &= back[:-2] | back[1:-1] | back[2:]
    # A rider may brake for a single moment: some powers must be positive between negative ones.
    is_lost = (lone & back[2:]).sum() >= max(LEAST_LONE, LONE * smooth.sum())
    if is_lost or _mirrored(drawn, speed):
        yield (
            f"while the car brakes, some values of {of} are as large as its negative ones, but "
            "positive: they have lost their sign, so every energy is too large"
        )


def _mirrored(drawn: Signal, speed: Signal) -> bool:
    """True if many powers of hard braking are positive, but of the negative ones' size."""
    times, change = accelerations(speed)
    power, kinetic = at_times(drawn, times), -change * at_times(speed, times)
    steps = np.diff(drawn.points()[0])
    braking = (change < -EVENT) & np.isfinite(power + kinetic)
    if braking.sum() < LEAST_EVENTS or np.median(steps) > LONGEST_PAIR:
        return False
    hard = braking & (kinetic > np.median(kinetic[braking]))
    ratio = power[hard] / kinetic[hard]
    if (ratio < 0.0).sum() < LEAST_BRAKED:
        return False
    back = float(np.median(ratio[ratio < 0.0]))
    lost = (ratio > 0.0) & (np.abs(ratio + back) < -MIRRORED * back)
    seconds = np.unique(times[hard][lost].round()).size  # a fast log has many readings per second
    return seconds >= LEAST_BRAKED and bool(lost.mean() >= BRAKED)


def clipped(drawn: Signal, speed: Signal, of: str, unit: tuple[float, str]) -> Iterator[str]:
    """Sentence on a current or power, SI, that stays at its maximum while the car needs more.

    `unit` is its factor and name.
    """
    largest = float(drawn.known.max(initial=0.0))
    at_largest = drawn.value == largest
    count = int(at_largest.sum())
    if largest <= 0.0 or count < max(LEAST_CLIPPED, CLIPPED * drawn.known.size):
        return
    times, change = accelerations(speed)
    power, fast = at_times(drawn, times), np.abs(at_times(speed, times))
    road = np.column_stack((change * fast, fast, fast**3, np.ones(fast.size)))
    known = np.isfinite(power) & np.isfinite(fast) & (power > 0.0)
    below, above = known & (power < 0.95 * largest), known & (power >= largest)
    if min(below.sum(), above.sum()) < LEAST_LOST or below.sum() < LEAST_EVENTS:
        return
    coefficients = np.linalg.lstsq(road[below], power[below], rcond=None)[0]
    if float(np.mean(road[above] @ coefficients)) > BEYOND * largest:
        yield (
            f"{of} is never above {largest * unit[0]:.4g} {unit[1]} and reaches it {count} times, "
            "also while the car needs more: it seems to be clipped, so every energy is too small"
        )


def constant_voltage(voltage: Signal, current: Signal) -> Iterator[str]:
    """Sentence on a voltage, V, that never drops, or not for long, under a large current, A."""
    volts, amperes = voltage.known, current.known
    if min(volts.size, amperes.size) < LEAST_EVENTS:
        return
    low, middle, high = np.quantile(volts, (0.01, 0.5, 0.99))
    least = HARD_ON_LIGHT if middle < LIGHT_BELOW else HARD_ON / middle
    swing = float(np.ptp(np.quantile(amperes, (0.01, 0.99))))
    if high - low <= CONSTANT * middle and swing > least:
        yield (
            f"the voltage is always {middle:.4g} V while the current changes by {swing:.0f} A, so "
            "it is nominal, not measured: energies are off by the same percentage"
        )
        return
    time, value = voltage.points()
    edges = np.flatnonzero(np.diff(value, prepend=np.nan, append=np.nan) != 0.0)
    longest = int(np.diff(edges).argmax())
    first, last = int(edges[longest]), int(edges[longest + 1]) - 1
    held = current.value[(current.time >= time[first]) & (current.time <= time[last])]
    swing = float(np.ptp(held[np.isfinite(held)])) if np.isfinite(held).any() else 0.0
    if (last - first) * float(np.median(np.diff(time))) >= LONGEST_HELD and swing > least:
        yield (
            f"the voltage stands still at {value[first]:.4g} V from {time[first]:.0f} s on for "
            f"{time[last] - time[first]:.0f} s while the current changes by {swing:.0f} A, so it "
            "is not measured then: energies may be off by a few percent"
        )


def _rises_while_braking(drawn: Signal, speed: Signal) -> bool:
    times, change = accelerations(speed)
    power, kinetic = at_times(drawn, times), change * at_times(speed, times)
    braking = change < -EVENT
    return correlation(kinetic[braking], power[braking]) < -RISES


def _compared(column: Column, power: Signal, drawn: Signal) -> Iterator[str]:
    name = column.name
    at = at_times(power, drawn.time)
    alike = correlation(at, drawn.value)
    if np.isnan(alike):
        return
    if abs(alike) < ALIKE:
        yield f"{name!r} does not follow voltage times current, which are used instead"
        return
    both = np.isfinite(at) & np.isfinite(drawn.value)
    ratio = float(np.std(at[both]) / np.std(drawn.value[both]))
    if not column.has_unit:  # W, kW or mW
        ratio /= 1e3 ** round(np.log10(ratio) / 3.0)
    if alike < 0.0:
        yield f"{name!r} has the opposite sign of voltage times current, which are used instead"
    if not SAME_SIZE[0] < ratio < SAME_SIZE[1]:
        yield f"{name!r} is {ratio:.2g} times voltage times current, which are used instead"
