"""Charts of a fleet's report: what data determine of each car, the vehicle file and the model."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any, NamedTuple

from evpinn_ros.common.units import with_sigma
from evpinn_ros.estimation.evidence import LINEAR, Evidence
from evpinn_ros.fleet.population import Population

CHARTED = {
    "mass_over_eta": "mass / η, kg",
    "c_d_over_eta": "drag coefficient / η",
    "c_rr": "rolling resistance",
    "regeneration": "regeneration, η μ",
    "p_aux": "auxiliary power, W",
}
MARGIN = 0.04  # of the width, on both sides


class Whisker(NamedTuple):
    """A row of a chart: its name and text, and value and 1-sigma in percent of the width."""

    name: str
    text: str
    low: float
    at: float
    high: float
    kind: str  # "file", "car", or "model"


def fleet_charts(population: Population, cars: Mapping[str, Evidence]) -> list[dict[str, Any]]:
    """A chart for each of `CHARTED`: the vehicle file, the cars, the next car of the model.

    Args:
        population: of the model.
        cars: evidence of the cars to show, by name.
    """
    return [
        {"title": title, "rows": _rows(name, population, cars)} for name, title in CHARTED.items()
    ]


def _rows(name: str, population: Population, cars: Mapping[str, Evidence]) -> list[Whisker]:
    model = population.value(name)
    found = [("vehicle file", population.of_file(name), "file")]
    found += [(car, population.of_car(name, one), "car") for car, one in cars.items()]
    found.append(("next car", (model.mean, model.new_car_std), "model"))
    points = [
        (_value(name, mean - std), _value(name, mean), _value(name, mean + std))
        for _, (mean, std), _ in found
    ]
    low, high = min(each[0] for each in points), max(each[2] for each in points)
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
        for (row, _, kind), (below, at, above) in zip(found, points, strict=True)
    ]


def _value(name: str, value: float) -> float:
    """Value of what a population holds as its logarithm."""
    return value if name == LINEAR else math.exp(value)
