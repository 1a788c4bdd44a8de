"""The parts of `evpinn bench energy` that count energy on board, and the battery at its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
import time
from typing import Any

from benchmarks.battery_end import BatteryRow, battery_rows
from benchmarks.cli.output import figures_table
from benchmarks.energy_integration import integration_rows
from benchmarks.logs import Log
from evpinn_ros.cli.console import show
from evpinn_ros.common.plain_table import PlainTable


def battery(logs: Sequence[Log]) -> dict[str, Any]:
    """The battery at the end of each drive of a car, of known power; give the figures."""
    rows = dict(battery_rows(logs))
    show_battery(f"{logs[0].vehicle}: error of the battery at the end of known power", rows)
    return {name: row._asdict() for name, row in rows.items()}


def show_battery(title: str, rows: Mapping[str, BatteryRow]) -> None:
    """A table of drives."""
    columns = ("drive", "charge used", "by capacity", "by state", "V held", "V by state")
    table = PlainTable(title, columns)
    for name, row in rows.items():
        shares = ("-" if each is None else f"{100 * each:+.2f} points" for each in row[1:3])
        volts = ("-" if each is None else f"{each:+.1f} V" for each in row[3:])
        table.add_row(Path(name).name, f"{100 * row.used:.1f} %", *shares, *volts)
    show(table)


def counting(cars: Sequence[Sequence[Log]]) -> list[dict[str, Any]]:
    """Count by the chain (`benchmarks.energy_integration`); show and give the figures."""
    rows = integration_rows(cars, time.thread_time)
    shown = [
        (f"{row.name} ({row.cases})", f"{row.figure:.3g} {row.unit}", row.goal) for row in rows
    ]
    show(figures_table("Energy counted on board (cases)", shown))
    return [row._asdict() for row in rows]
