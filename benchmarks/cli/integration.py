"""The parts of `evpinn bench energy` that count energy: integrators, and the meter on board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
import time
from typing import Any

from benchmarks.battery_end import BatteryRow, battery_rows
from benchmarks.cli.output import figures_table
from benchmarks.energy_integration import integration_rows
from benchmarks.integrators import (
    SIMULATED,
    IntegratorAgreement,
    IntegratorRow,
    UnbrokenPower,
    agreement,
    compare_integrators,
    measured_power,
    simulated_power,
)
from benchmarks.logs import Log
from evpinn_ros.cli.console import note, say, show
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable

EPOCHS = 1000


def integrators(cars: Sequence[Sequence[Log]], epochs: int) -> dict[str, Any]:
    """Compare integrators on each car's logs and on simulated drives; gives the figures."""
    rows: list[IntegratorRow] = []
    agreements: list[IntegratorAgreement] = []
    for logs in cars:
        drives = _drives(logs)
        agreements += [agreement(drive) for drive in drives]
        if drives:
            rows += _compared(logs[0].vehicle, drives, epochs)
    rows += _compared(SIMULATED, simulated_power(), epochs)
    if agreements:
        worst = max(agreements, key=lambda each: abs(each.percent))
        say(
            f"RKNN, shipped, against the trapezoid on every sample, {len(agreements)} whole logs: "
            f"{worst.percent:+.4f} % at worst, {worst.log} (goal 0.1 %)"
        )
    return {
        "rows": [row._asdict() for row in rows],
        "agreement": [each._asdict() for each in agreements],
    }


def _drives(logs: Sequence[Log]) -> list[UnbrokenPower]:
    drives = []
    for log in logs:
        try:
            drives.append(measured_power(log))
        except InputError as error:
            note(f"evpinn: {error}")
    return drives


def _compared(car: str, drives: Sequence[UnbrokenPower], epochs: int) -> list[IntegratorRow]:
    """One car's figures, shown with methods down and samplings across."""
    rows = list(compare_integrators(car, drives, epochs))
    cells: dict[str, list[str]] = {}
    for row in rows:
        cells.setdefault(row.method, [row.method]).append(f"{row.median:.3f} / {row.worst:.3f}")
    title = f"{car} ({len(drives)}): median / worst error, % of gross energy"
    samplings = dict.fromkeys(row.sampling for row in rows)
    show(PlainTable(title, ("method", *samplings), cells.values()))
    return rows


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
