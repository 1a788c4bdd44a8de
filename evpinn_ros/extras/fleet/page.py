"""The page of `evpinn fleet`, and its cells and charts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from typing import Any, NamedTuple

from evpinn_ros.common.units import counted, two_digits, with_sigma
from evpinn_ros.core.estimation.evidence import LINEAR, Evidence
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.extras.fleet.population import COMBINATIONS, Population, PopulationValue
from evpinn_ros.extras.fleet.tables import CHARTED, SHOWN, FleetSummary
from evpinn_ros.report.html import write_page
from evpinn_ros.report.shapes import trend_intervals

POPULATION_HEAD = (
    *("", "vehicle file", "mean of the cars", "from car to car", "next car", "worth, cars"),
)
CAR_HEAD = ("car", "vehicle", "drives", "hours", *PARAMETER_NAMES)
CHART_TITLES = {
    "mass_over_eta": "mass / η, kg",
    "c_d_over_eta": "drag coefficient / η",
    "c_rr": "rolling resistance",
    "regeneration": "regeneration, η μ",
    "p_aux": "auxiliary power, W",
}
MARGIN = 0.04  # of the width, on both sides


def write_fleet_page(path: Path, summary: FleetSummary, command: str) -> None:
    """Write the report; OSError if that fails."""
    write_page(
        path,
        "fleet.html.j2",
        title="evpinn fleet",
        command=command,
        counts=summary.counts,
        sentence=fleet_sentence(summary.counts),
        shown=SHOWN,
        charted=CHARTED,
        population_head=POPULATION_HEAD,
        models=[
            (
                key,
                len(known),
                fleet_charts(population, known),
                population_cells(population),
                trend_intervals(points),
            )
            for key, population in summary.populations.items()
            for known, points in [(summary.known[key], summary.points[key])]
        ],
        car_head=CAR_HEAD,
        cars=[_car_cells(row) for row in summary.cars],
        problems=summary.problems,
    )


def fleet_sentence(counts: Mapping[str, int]) -> str:
    """Sentence with the numbers of cars, drives and problems."""
    cars, drives = (counted(counts[name], name[:-1]) for name in ("cars", "drives"))
    problems = counted(counts["problems"], "problem") if counts["problems"] else "no problem"
    return f"{cars}, {counts['learned']} of {drives} learned, {problems}."


def population_cells(population: Population) -> list[tuple[str, ...]]:
    """Rows under `POPULATION_HEAD`: the parameters, then the identifiable combinations."""
    priors = population.vehicle.priors.items()
    files = {name: with_sigma(prior.value, prior.std) for name, prior in priors}
    return [
        (name, files.get(name, ""), *_value_cells(name, population.value(name)))
        for name in (*PARAMETER_NAMES, *COMBINATIONS)
    ]


def _value_cells(name: str, shared: PopulationValue) -> tuple[str, ...]:
    """Cells: value and spread, each with 1-sigma, 1-sigma of the next car, and number of cars."""
    linear = name == LINEAR  # all others are logarithms
    value = shared.mean if linear else math.exp(shared.mean)
    scale, unit = (1.0, " W") if linear else (100.0, " %")
    return (
        with_sigma(value, shared.mean_std * (1.0 if linear else value)),
        with_sigma(scale * shared.spread, scale * shared.spread_std) + unit,
        f"± {two_digits(scale * shared.new_car_std)}{unit}",
        f"{shared.cars:.1f}",
    )


def _car_cells(row: dict[str, Any]) -> Sequence[str]:
    parameters = (
        "-" if row[name] is None else with_sigma(row[name], row[f"{name}_std"])
        for name in PARAMETER_NAMES
    )
    drives = f"{row['learned']} of {row['drives']}"
    return (row["car"], row["vehicle"], drives, f"{row['duration_s'] / 3600:.2f}", *parameters)


class Whisker(NamedTuple):
    """A row of a chart; positions are in percent of the width."""

    name: str
    text: str
    low: float  # value minus 1-sigma
    at: float  # value
    high: float  # value plus 1-sigma
    kind: str  # "file", "car", or "model"


def fleet_charts(population: Population, cars: Mapping[str, Evidence]) -> list[dict[str, Any]]:
    """Charts of `CHART_TITLES`: the vehicle file, cars by name, and the next car of the model."""
    return [
        {"title": title, "rows": _rows(name, population, cars)}
        for name, title in CHART_TITLES.items()
    ]


def _rows(name: str, population: Population, cars: Mapping[str, Evidence]) -> list[Whisker]:
    model = population.value(name)
    rows = [("vehicle file", population.of_file(name), "file")]
    rows += [(car, population.of_car(name, evidence), "car") for car, evidence in cars.items()]
    rows.append(("next car", (model.mean, model.new_car_std), "model"))
    points = [
        (_value(name, mean - std), _value(name, mean), _value(name, mean + std))
        for _, (mean, std), _ in rows
    ]
    low, high = min(point[0] for point in points), max(point[2] for point in points)
    edge = MARGIN * (high - low)

    def place(value: float) -> float:
        return round(100.0 * (value - low + edge) / (high - low + 2.0 * edge), 1)

    return [
        Whisker(
            name=row,
            text=with_sigma(at, 0.5 * (above - below)),
            low=place(below),
            at=place(at),
            high=place(above),
            kind=kind,
        )
        for (row, _, kind), (below, at, above) in zip(rows, points, strict=True)
    ]


def _value(name: str, value: float) -> float:
    return value if name == LINEAR else math.exp(value)
