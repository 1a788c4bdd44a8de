"""`evpinn bench settings`: scores each car with constants of the core chosen without it.

Every alternative of `SETTINGS` replaces one constant of the core, and is scored on every car
(`benchmarks.variants`). Each car is then scored with all constants at the values that the other
cars find likeliest (leave one car out), beside the core as it is, and beside the values that the
car itself finds likeliest, which is what constants fitted to the scored drives would show.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from statistics import fmean
from typing import Annotated, Any, NamedTuple

from benchmarks.cli import output
from benchmarks.variants import SCORE_COLUMNS, ConstantPlace, Variant, VariantRow, read_car, score
from evpinn_ros.cli.console import show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.core.estimation.states import State

CARS = ("i3", "i3_speed", "e208", "leaf2013", "sumo_id3", "simulated", "model3")
ONE_CAR = {"i3_speed": "i3", "sumo_id3": "sumo_i3", "sumo_e208": "sumo_i3"}
"""Cars that are judged, and left out, together: the same drives, or the same simulator."""

UNSEEN, PRODUCT, OWN = "the other cars'", "the product's", "its own"


class Setting(NamedTuple):
    """A constant and the values it may take."""

    place: ConstantPlace
    values: tuple[Any, ...]

    def variants(self) -> list[Variant]:
        """The core as it is, then the alternatives."""
        others = (value for value in self.values if value != self.place.present)
        return [
            Variant(PRODUCT),
            *(
                Variant(f"{self.place.name} {_text(value)}", {self.place: value})
                for value in others
            ),
        ]


def _posterior(key: str, *values: float) -> Setting:
    return Setting(ConstantPlace("posterior", key), values)


SETTINGS = (
    Setting(ConstantPlace("journey", "NOISE_TIME"), (0.75, 1.5, 3.0)),
    _posterior("OUTLIER", 2.5, 4.0),
    Setting(ConstantPlace("journey", "LOAD_TIME"), (150.0, 300.0, 600.0)),
    _posterior("EVIDENCE_KEPT", 100.0, 400.0, 1600.0),
    _posterior("LARGE_NETWORK_ODDS", 0.0, 7.0),
    _posterior("SCALE_INTERVALS", 10.0, 30.0, 100.0),
    _posterior("LEAST_SCALE", 0.05, 1.0),
    _posterior("DRIFT", 0.0, 0.02, 0.05),
    Setting(ConstantPlace("bands", "DEGREES"), (4.0, 6.0, 10.0)),
    Setting(ConstantPlace(State.ROLLING_DRIVE, "std"), (0.05, 0.08, 0.12)),
    Setting(ConstantPlace(State.MASS_DRIVE, "std"), (40.0, 80.0, 120.0)),
    Setting(ConstantPlace(State.LOSS_DRIVE, "std"), (0.01, 0.02, 0.04)),
    Setting(ConstantPlace(State.LOAD_DRIVE, "std"), (150.0, 250.0, 400.0)),
    Setting(ConstantPlace(State.TURNING, "mean"), (0.0, 150.0, 300.0)),
    Setting(ConstantPlace(State.FORCE_SQUARED, "mean"), (0.0, 200.0, 400.0)),
    Setting(ConstantPlace(State.COLD, "mean"), (30.0, 60.0)),
    Setting(ConstantPlace(State.COLD_START, "mean"), (30.0, 60.0)),
)

Scores = Mapping[str, Mapping[str, VariantRow]]
"""Rows by car and name of the variant."""


def alternatives() -> list[Variant]:
    """The core as it is, and with one constant at a time replaced."""
    return [
        Variant(PRODUCT),
        *(variant for setting in SETTINGS for variant in setting.variants()[1:]),
    ]


def others(car: str, cars: Iterable[str]) -> list[str]:
    """The cars that may choose constants for a car."""
    return [other for other in cars if _one(other) != _one(car)]


def choose(scores: Scores, judges: Sequence[str]) -> dict[ConstantPlace, Any]:
    """Choose the core's constants on these cars, each constant by itself.

    Judges vote by their likelihoods in `scores`, which hold those of `alternatives`; several of
    `ONE_CAR` have one vote together. No other car's scores are looked at.
    """
    changes: dict[ConstantPlace, Any] = {}
    for setting in SETTINGS:
        likeliest = max(
            setting.variants(), key=lambda variant: support(scores, judges, variant.name)
        )
        changes |= likeliest.changes  # the first where they tie, the product's
    return changes


def support(scores: Scores, judges: Sequence[str], variant: str) -> float:
    """Sum of the cars' likelihoods of a variant."""
    cars: dict[str, list[float]] = {}
    for key in judges:
        cars.setdefault(_one(key), []).append(scores[key][variant].likelihood)
    return sum(map(fmean, cars.values()))


def final_variants(scores: Scores, car: str) -> list[Variant]:
    """Variants that a car is scored with: constants chosen without it, the product's, its own."""
    return [
        Variant(UNSEEN, choose(scores, others(car, scores))),
        Variant(PRODUCT),
        Variant(OWN, choose(scores, [car])),
    ]


def changes_text(changes: Mapping[ConstantPlace, Any]) -> str:
    """Replaced constants, by name and value."""
    return ", ".join(f"{place.name} {_text(value)}" for place, value in changes.items())


def _one(key: str) -> str:
    return ONE_CAR.get(key, key)


def _text(value: Any) -> str:
    return f"{value:g}"


def settings(
    data: output.DataArgument,
    cars: Annotated[str, output.cars_option(CARS)] = "",
    jobs: output.JobsOption = 2,
    json_file: JsonOption = None,
) -> None:
    """Score each car with constants of the core chosen on the other cars.

    The constants are chosen by likelihood. For comparison, the core is also scored with its own
    constants, and with constants chosen on the scored car.

    Example: evpinn bench settings $DATA --cars model3,e208,leaf2013
    """
    keys = output.chosen_cars(data, cars, CARS)
    lonely = [key for key in keys if not others(key, keys)]
    if lonely:
        raise InputError(f"--cars: {lonely[0]} needs another car, to choose its constants")
    scores: dict[str, dict[str, VariantRow]] = {key: {} for key in keys}
    finals: dict[str, dict[str, VariantRow]] = {key: {} for key in keys}
    chosen: dict[str, list[Variant]] = {}
    with output.json_as_it_comes(
        json_file, lambda: _found(scores, chosen, finals), (data, *keys)
    ) as keep:
        recorded = list(
            output.in_parallel("cars read", jobs, read_car, [(data, key) for key in keys])
        )
        tasks = [(variant, car) for car in recorded for variant in alternatives()]
        for row in output.in_parallel("alternatives on cars", jobs, score, tasks):
            scores[row.car][row.variant] = row
            keep()
        chosen |= {key: final_variants(scores, key) for key in keys}
        tasks = [(variant, car) for car in recorded for variant in chosen[car.key]]
        for row in output.in_parallel("chosen constants", jobs, score, tasks):
            finals[row.car][row.variant] = row
            keep()
        _show_alternatives(scores)
        _show_chosen(chosen, finals)


def _found(
    scores: Scores, chosen: Mapping[str, Sequence[Variant]], finals: Scores
) -> dict[str, list[dict[str, Any]]]:
    return {
        "alternatives": [asdict(row) for rows in scores.values() for row in rows.values()],
        "chosen": [
            {"changes": changes_text(variant.changes), **asdict(finals[key][variant.name])}
            for key, variants in chosen.items()
            for variant in variants
            if variant.name in finals[key]
        ],
    }


def _show_alternatives(scores: Scores) -> None:
    title = "Likelihood minus that of the product's constants"
    table = PlainTable(title, ("instead", *scores, "all cars"))
    for variant in alternatives()[1:]:
        gains = [
            support(scores, judges, variant.name) - support(scores, judges, PRODUCT)
            for judges in (*([key] for key in scores), list(scores))
        ]
        table.add_row(variant.name, *(f"{gain:+.2f}" for gain in gains))
    show(table, at_least=output.TABLE_WIDTH)


def _show_chosen(chosen: Mapping[str, Sequence[Variant]], finals: Scores) -> None:
    changes = {
        (key, variant.name): changes_text(variant.changes) or "-"
        for key, variants in chosen.items()
        for variant in variants
    }
    columns = (
        ("car", "{0.car}"),
        ("constants", "{0.variant}"),
        ("other than the product's", "{1}"),
        *SCORE_COLUMNS,
    )
    rows = [(finals[key][name], text) for (key, name), text in changes.items()]
    title = "Scores with constants chosen without the car, and with others"
    show(output.table_of(title, rows, columns, left=3), at_least=output.TABLE_WIDTH)
