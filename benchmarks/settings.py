"""Constants of the core, chosen by the cars that are not scored.

Every alternative of `SETTINGS` replaces one constant of the core, and is scored on every car
(`benchmarks.variants`). Each car is then scored with all constants at the values that the other
cars find likeliest (leave one car out), beside the core as it is, and beside the values that the
car itself finds likeliest, which is what constants fitted to the scored drives would show.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple

from benchmarks.variants import ConstantPlace, Variant, VariantRow
from evpinn_ros.estimation.states import State

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
    Setting(ConstantPlace("bands", "PRIOR_CASES"), (2.0, 4.0, 8.0)),
    Setting(ConstantPlace("bands", "PRIOR_SCALE"), (1.0, 1.5, 2.0)),
    Setting(ConstantPlace(State.ROLLING_DRIVE, "std"), (0.05, 0.08, 0.12)),
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
    return [Variant(PRODUCT), *(each for setting in SETTINGS for each in setting.variants()[1:])]


def others(car: str, cars: Iterable[str]) -> list[str]:
    """The cars that may choose constants for a car."""
    return [each for each in cars if _one(each) != _one(car)]


def choose(scores: Scores, judges: Sequence[str]) -> dict[ConstantPlace, Any]:
    """Choose the core's constants on these cars, each constant by itself.

    Judges vote by their likelihoods in `scores`, which hold those of `alternatives`; several of
    `ONE_CAR` have one vote together. No other car's scores are looked at.
    """
    changes: dict[ConstantPlace, Any] = {}
    for setting in SETTINGS:
        likeliest = max(setting.variants(), key=lambda each: support(scores, judges, each.name))
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
