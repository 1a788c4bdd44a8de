"""Use made of the columns of a table, in words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from evpinn_ros.cli.console import note

if TYPE_CHECKING:
    from evpinn_ros.logs.column import Column
    from evpinn_ros.logs.source import Source


# Units are looked up in small letters.
PRETTY = {
    **dict.fromkeys(("a", "amp", "amps", "ampere"), "A"),
    **dict.fromkeys(("v", "volt", "volts"), "V"),
    **dict.fromkeys(("w", "watt", "watts"), "W"),
    **dict.fromkeys(("c", "degc", "°c", "℃"), "°C"),
    **dict.fromkeys(("f", "degf", "°f", "℉"), "°F"),
    **{each.lower(): each for each in ("mV", "mA", "kW", "kWh", "100W", "250W", "50W")},
}


def explain_columns(source: Source) -> None:
    """Say what was guessed of a table; of one with our own names what is not used."""
    if not any(rule.why for rule in source.rules):
        if source.ignored:
            note(f"{source.path}: columns not used: {shorter(source.ignored)}")
        return
    note(f"{source.path}: columns were found by their names and values:")
    for rule in source.rules:
        note(f"  {rule.quantity}: {choice(rule)}{' (assumed)' if rule.could_be else ''}")
    if source.ignored:
        note(f"  not used: {shorter(source.ignored)}")
    note("  to correct one: --column speed='NAME:km/h', --column current='NAME:-A', ...")


def explain_notes(source: Source) -> None:
    """Say what turned out on reading."""
    for text in source.notes:
        note(text if text.startswith(str(source.path)) else f"{source.path}: {text}")


def shorter(names: Iterable[str]) -> str:
    """Names in a list, those that differ by a number alone as the first and the last of them."""
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
    """The column that was chosen for a quantity, with its unit and the reason."""
    unit = _unit(rule.unit) if rule.unit else ""
    return ", ".join(filter(None, [repr(rule.name), unit, rule.why]))


def _unit(text: str) -> str:
    """A unit as people write it; the reason beside it gives the sign of `-a`."""
    bare = text.lstrip("-")
    return PRETTY.get(bare, bare)
