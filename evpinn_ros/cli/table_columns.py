"""Prints how the columns of a table are used."""

from __future__ import annotations

from collections.abc import Container, Hashable, Iterable, Iterator
from typing import TYPE_CHECKING

from evpinn_ros.cli.console import note
from evpinn_ros.common.units import counted

if TYPE_CHECKING:
    from evpinn_ros.logs.column import Column
    from evpinn_ros.logs.source import Source


# Spelling of a unit by its lower-case name.
PRETTY = {
    **dict.fromkeys(("a", "amp", "amps", "ampere"), "A"),
    **dict.fromkeys(("v", "volt", "volts"), "V"),
    **dict.fromkeys(("w", "watt", "watts"), "W"),
    **dict.fromkeys(("c", "degc", "°c", "℃"), "°C"),
    **dict.fromkeys(("f", "degf", "°f", "℉"), "°F"),
    **{unit.lower(): unit for unit in ("mV", "mA", "kW", "kWh", "100W", "250W", "50W")},
}


def explain_columns(sources: Iterable[Source]) -> None:
    """Print guessed and unused columns, once for all tables with the same columns."""
    tables: dict[Hashable, list[Source]] = {}
    for source in sources:
        tables.setdefault(_choices(source), []).append(source)
    for first, *others in tables.values():
        alike = f" and {counted(len(others), 'file')} like it" if others else ""
        for place, line in enumerate(_columns(first)):
            note(line if place else f"{first.path}{alike}: {line}")


def _choices(source: Source) -> Hashable:
    """Columns and units of a table, without the reasons, whose figures differ between files."""
    chosen = ((rule.quantity, rule.name, rule.unit, rule.could_be) for rule in source.rules)
    return tuple(chosen), tuple(source.ignored)


def _columns(source: Source) -> Iterator[str]:
    if not any(rule.why for rule in source.rules):
        if source.ignored:
            yield f"columns not used: {shorter(source.ignored)}"
        return
    yield "columns were found by their names and values:"
    for rule in source.rules:
        yield f"  {rule.quantity}: {choice(rule)}{' (assumed)' if rule.could_be else ''}"
    if source.ignored:
        yield f"  not used: {shorter(source.ignored)}"
    yield "  to correct one: --column speed='NAME:km/h', --column current='NAME:-A', ..."


def explain_notes(source: Source, said: Container[str] = ()) -> list[str]:
    """Print the notes of `source` that are not in `said`; returns them."""
    texts = [text for text in source.notes if text not in said]
    for text in texts:
        note(text if text.startswith(str(source.path)) else f"{source.path}: {text}")
    return texts


def shorter(names: Iterable[str]) -> str:
    """Names joined by commas; three or more that differ by a final number are "A1 to A9"."""
    runs: list[list[str]] = []
    for name in names:
        if runs and _stem(name) == _stem(runs[-1][-1]) != name:
            runs[-1].append(name)
        else:
            runs.append([name])
    shown = (f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(run) for run in runs)
    return ", ".join(shown)


def _stem(name: str) -> str:
    return name.rstrip("0123456789")


def choice(rule: Column) -> str:
    """Name, unit and reason of the column chosen for a quantity."""
    unit = (rule.unit or "").lstrip("-")  # the reason beside it gives the sign of `-a`
    return ", ".join(filter(None, [repr(rule.name), PRETTY.get(unit, unit), rule.why]))
