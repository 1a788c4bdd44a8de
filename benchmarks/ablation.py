"""The core with one part left out: what each part is worth without the battery."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.variants import ConstantPlace, RecordedCar, Variant, VariantRow, constant, score
from evpinn_ros.estimation.car_filter import LOAD_STD
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.long_hills import LongHills
from evpinn_ros.signals.interval import Interval

CARS = ("model3", "i3", "i3_speed", "e208", "leaf2013")
NOTHING = 1e-6

ONE_SCALE = {
    constant("FORCES"): (0.002,),
    constant("SLOPES"): (0.008,) * 3,
    constant("HEIGHT_ERRORS"): (1.5,) * 3,
}
NO_SLOPE = {constant("SLOPES"): (NOTHING,) * 3, constant("HEIGHT_ERRORS"): (NOTHING,) * 3}


class _NoHills(LongHills):
    """Roads that never stray."""

    def after(self, interval: Interval) -> LongHills:
        return self

    def elsewhere(self) -> LongHills:
        return self


STARTS = (State.COLD_START, State.HOT_START)


def _without(*states: State) -> dict[ConstantPlace, tuple[float, float]]:
    """States of the car that stay at zero."""
    return {ConstantPlace("PRIORS", state): (0.0, NOTHING) for state in states}


VARIANTS = (
    Variant("whole"),
    Variant("one scale of the road", ONE_SCALE),
    Variant("no unseen slope", NO_SLOPE),
    Variant("no long hills", {constant("LongHills"): lambda _: _NoHills(0.0)}),
    Variant("no unseen force", {constant("FORCES"): (NOTHING,)}),
    Variant("dropouts hold the road before", {constant("lasting"): np.copy}),
    Variant(
        "no wandering load",
        {constant("LOAD_STD"): NOTHING, constant("KNOWN_LOAD_STD"): NOTHING},
    ),
    Variant("reported loads wander as others", {constant("KNOWN_LOAD_STD"): LOAD_STD}),
    Variant("no outliers", {constant("OUTLIER"): 1e3}),
    Variant("noise not scaled", {constant("MOST_SCALE"): 1.0}),
    Variant(
        "no offsets of a drive",
        {
            ConstantPlace("DRIVE_STD", state): NOTHING
            for state in (State.ROLL_DRIVE, State.AUX_DRIVE)
        },
    ),
    Variant("a drive keeps no offset of the last", {constant("DRIVE_KEPT"): 0.0}),
    Variant("braking as sure as driving", {constant("BRAKE_NOISE"): 0.0}),
    Variant("no loss by turning", _without(State.NO_LOAD)),
    Variant("no loss by force squared", _without(State.COPPER)),
    Variant("no heating and cooling", _without(State.COLD, State.HOT, *STARTS)),
    Variant("no start of heating", _without(*STARTS)),
    Variant("no cold tyres", _without(State.ROLL_START, State.ROLL_COLD)),
)


def ablate(car: RecordedCar) -> Iterator[VariantRow]:
    """Every variant on one car."""
    for variant in VARIANTS:
        yield score(variant, car)
