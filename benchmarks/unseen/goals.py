"""Goals of the core over all scored cars, beside what was measured.

A goal whose cars were not scored is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from statistics import fmean, geometric_mean
from typing import Any

from evpinn_ros.common.plain_table import PlainTable

SIX = ("i3", "i3_speed", "e208", "leaf2013", "changchun", "simulated")
OTHERS = ("model3", "sumo_i3", "sumo_id3", "sumo_e208",
          "fastsim_leaf", "fastsim_bolt", "fastsim_model3", "fastsim_zoe")  # fmt: skip
PARTS = {"carried": "carried", "withheld": "200 s", "dropout_600": "600 s"}
CRPS = "crps_percent"
GOALS = {  # of the geometric means of CRPS, percent of gross energy
    ("carried", SIX): 2.95,
    ("withheld", SIX): 5.1,
    ("withheld", OTHERS): 0.7,
}
MOST_RATIO, MEAN_RATIO = 1.0, 0.85
INSIDE = (85.0, 95.0)  # percent of the 90 % intervals
BIASES = {
    "mass_over_eta": 0.7,
    "regeneration": 1.5,
    "rolling_over_eta": 2.5,
    "drag_area_over_eta": 0.7,
}

Scores = Mapping[str, Any]
"""Scores of one method on one car, as `summary` gives them."""


def car_table(cars: Mapping[str, Scores], beside: Mapping[str, Scores]) -> PlainTable:
    """CRPS of the core over that of the other method, and coverage of its intervals, by car."""
    headers = [f"{name}:\nratio" for name in list(PARTS.values())[:2]]
    table = PlainTable("", ("core", *headers, *(f"{name}:\nin 90 %" for name in PARTS.values())))
    for car, scores in cars.items():
        ratios = (_ratio(scores, beside.get(car, {}), part) for part in list(PARTS)[:2])
        inside = (_value(scores, part, "inside_90_percent") for part in PARTS)
        table.add_row(car, *(_text(percent, ".2f") for percent in ratios),
                      *(_text(percent, ".0f") for percent in inside))  # fmt: skip
    return table


def figures(
    cars: Mapping[str, Scores], beside: Mapping[str, Scores]
) -> Iterator[tuple[str, str, str]]:
    """Figures over the cars: name, measured, goal.

    Args:
        cars: scores of the core by car.
        beside: scores of the method with which it is compared.
    """
    for (part, group), goal in GOALS.items():
        crps = _known(_value(cars[car], part, CRPS) for car in group if car in cars)
        if crps:
            name = f"CRPS {PARTS[part]}, geometric mean of {len(crps)} of {len(group)} cars"
            yield f"{name} ({group[0]}, ...)", f"{geometric_mean(crps):.2f} %", f"{goal:g} %"
    ratios = _known(
        _ratio(cars[car], beside.get(car, {}), part) for car in cars for part in list(PARTS)[:2]
    )
    if ratios:
        yield "CRPS over weak_ls, most", f"{max(ratios):.2f}", f"{MOST_RATIO:g}"
        yield "the same, mean", f"{fmean(ratios):.2f}", f"{MEAN_RATIO:g}"
    for part, name in PARTS.items():
        inside = _known(_value(scores, part, "inside_90_percent") for scores in cars.values())
        if inside:
            low, high = INSIDE
            held = sum(low <= percent <= high for percent in inside)
            measured = f"{min(inside):.0f} to {max(inside):.0f}, {held} of {len(inside)} cars"
            yield f"in 90 %, {name}", measured, f"{low:g} to {high:g}"
    simulators = {k: v for k, v in cars.items() if k.startswith(("sumo", "fastsim"))}
    for name, goal in BIASES.items():
        biases = [
            abs(methods["truth"][name]["bias_percent"])
            for methods in simulators.values()
            if name in methods.get("truth", {})
        ]
        if biases:
            title = f"{name}: size of the bias, SUMO and FASTSim"
            yield title, f"{fmean(biases):.1f} %", f"{goal:g} %"


def _ratio(scores: Scores, beside: Scores, part: str) -> float | None:
    own, other = _value(scores, part, CRPS), _value(beside, part, CRPS)
    return own / other if own is not None and other else None


def _value(scores: Scores, part: str, key: str) -> float | None:
    part_scores = scores.get(part)
    value: float | None = part_scores[key] if part_scores else None
    return value


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
