"""Writes the results of a fleet as Parquet, one car after the other to save memory."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
import math
from pathlib import Path
from typing import Any

import numpy as np

from evpinn_ros.common.errors import as_input_error
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.writer import replaced
from evpinn_ros.core.estimation.evidence import LINEAR, Evidence
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.extras.fleet.car import (
    NUMBERS,
    PARAMETERS,
    POINT,
    car_folder,
    impossible,
    point_of,
    read_result,
)
from evpinn_ros.extras.fleet.manifest import CarDrives
from evpinn_ros.extras.fleet.population import COMBINATIONS, Population
from evpinn_ros.replays.trends import DrivePoint

DRIVES, CARS, POPULATION = "drives.parquet", "cars.parquet", "population.parquet"
ROWS = 2000  # written together
SHOWN = 200  # cars and problems for people; the tables have all
CHARTED = 30  # cars of a model in the charts of the report

PARAMETER_TYPES = {
    column: "string" if figure == "state" else "double"
    for column, (_, figure) in PARAMETERS.items()
}
DRIVE_COLUMNS = {
    **dict.fromkeys(("car", "vehicle", "path", "problem", "fingerprint"), "string"),
    **dict.fromkeys(("start_ns", "samples"), "int64"),
    **dict.fromkeys(NUMBERS, "double"),
    **{name: "string" if name == "week" else "double" for name in POINT},
    **PARAMETER_TYPES,
}
CAR_COLUMNS = {
    **dict.fromkeys(("car", "vehicle", "problem"), "string"),
    **dict.fromkeys(("drives", "learned"), "int64"),
    "duration_s": "double",
    "in_population": "bool",
    **PARAMETER_TYPES,
}
POPULATION_COLUMNS = {
    **dict.fromkeys(("vehicle", "name"), "string"),
    **dict.fromkeys(
        ("value", "mean", "mean_std", "spread", "spread_std", "cars", "new_car_std"), "double"
    ),
    "covariance": "list",
}


@dataclass
class FleetSummary:
    """What terminal and page show of a fleet."""

    populations: dict[str, Population] = field(default_factory=dict)  # by vehicle model
    cars: list[dict[str, Any]] = field(default_factory=list)  # `SHOWN` rows of the table
    problems: list[tuple[str, str]] = field(default_factory=list)  # `SHOWN` failures
    # evidence of the first `CHARTED` cars of a population, by model and car
    known: dict[str, dict[str, Evidence]] = field(default_factory=lambda: defaultdict(dict))
    # points of the drives of each model, for trends
    points: dict[str, list[DrivePoint]] = field(default_factory=lambda: defaultdict(list))
    counts: Counter[str] = field(default_factory=Counter)  # all cars, drives, learned, problems


def require_extra() -> None:
    """InputError, before hours of work, if the extra is not installed."""
    with optional_imports():
        import jinja2  # noqa: F401
        import pyarrow.parquet  # noqa: F401


def write_tables(out: Path, fleet: Sequence[CarDrives], failed: Mapping[str, str]) -> FleetSummary:
    """Write the tables of drives, cars and populations; `failed` has the reason by failed car."""
    summary = FleetSummary()
    evidence_of_model: dict[str, list[Evidence]] = defaultdict(list)
    vehicles: dict[str, Vehicle] = {}
    with (
        _table(out / DRIVES, DRIVE_COLUMNS) as add_drive,
        _table(out / CARS, CAR_COLUMNS) as add_car,
    ):
        for car in fleet:
            result = read_result(car_folder(out, car), car.vehicle)
            rows = [*result.get("drives", []), *result.get("unreadable", [])]
            if not rows and car.car not in failed:
                continue
            for row in rows:
                add_drive({"car": car.car, "vehicle": car.vehicle.key, **row})
            row = _car_row(car, rows, failed.get(car.car))
            add_car(row)
            _count(summary, row, rows)
            vehicles[car.vehicle.key] = car.vehicle
            summary.points[car.vehicle.key] += filter(None, map(point_of, rows))
            if row["in_population"]:
                learned = Evidence(np.array(result["precision"]), np.array(result["information"]))
                evidence_of_model[car.vehicle.key].append(learned)
                if len(summary.known[car.vehicle.key]) < CHARTED:
                    summary.known[car.vehicle.key][car.car] = learned
    for key, vehicle in sorted(vehicles.items()):
        summary.populations[key] = Population(vehicle, evidence_of_model[key])
    with _table(out / POPULATION, POPULATION_COLUMNS) as add:
        for key, population in summary.populations.items():
            for row in population_rows(key, population):
                add(row)
    return summary


def population_rows(key: str, population: Population) -> Iterator[dict[str, Any]]:
    """A row for each parameter and each identifiable combination."""
    covariance = dict(zip(PARAMETER_NAMES, population.covariance().tolist(), strict=True))
    for name in (*PARAMETER_NAMES, *COMBINATIONS):
        shared = population.value(name)
        yield {
            "vehicle": key,
            "name": name,
            "value": shared.mean if name == LINEAR else math.exp(shared.mean),
            **asdict(shared),
            "new_car_std": shared.new_car_std,
            "covariance": covariance.get(name),
        }


def _car_row(
    car: CarDrives, rows: Sequence[dict[str, Any]], problem: str | None
) -> dict[str, Any]:
    learned = [row for row in rows if row["samples"]]
    last = learned[-1] if learned else {}
    wrong = impossible(last) if last else []
    if wrong and problem is None:
        problem = f"not in the population: {', '.join(wrong)} invalid"
    return {
        "car": car.car,
        "vehicle": car.vehicle.key,
        "problem": problem,
        "drives": len(rows),
        "learned": len(learned),
        "duration_s": sum(row["duration_s"] for row in learned),
        "in_population": bool(learned) and not wrong,
        **{name: last.get(name) for name in PARAMETERS},
    }


def _count(summary: FleetSummary, car: dict[str, Any], rows: Sequence[dict[str, Any]]) -> None:
    problems = [(row["path"], row["problem"]) for row in rows if row["problem"]]
    if car["problem"]:
        problems.append((f"car {car['car']}", car["problem"]))
    summary.counts.update(cars=1, drives=len(rows), learned=car["learned"], problems=len(problems))
    summary.cars.extend([car][: max(0, SHOWN - len(summary.cars))])
    summary.problems.extend(problems[: max(0, SHOWN - len(summary.problems))])


@contextmanager
def _table(path: Path, columns: Mapping[str, str]) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Yields a function that adds a row to a table; the complete table replaces the old one."""
    import pyarrow
    from pyarrow.parquet import ParquetWriter

    types = {"list": pyarrow.list_(pyarrow.float64())}
    types |= {name: pyarrow.type_for_alias(name) for name in ("bool", "string", "int64", "double")}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in columns.items()])
    rows: list[dict[str, Any]] = []

    def flush() -> None:
        writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))
        rows.clear()

    def add(row: dict[str, Any]) -> None:
        rows.append(row)
        if len(rows) >= ROWS:
            flush()

    with as_input_error(path), replaced(path) as draft, ParquetWriter(draft, schema) as writer:
        yield add
        flush()
