"""The core with one part left out: what each part is worth without the battery."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.variants import (
    ConstantPlace,
    RecordedCar,
    Variant,
    VariantRow,
    constant,
    prior,
    score,
)
from evpinn_ros.estimation.bands import GROWTHS
from evpinn_ros.estimation.posterior import BANK, CarState
from evpinn_ros.estimation.states import State

CARS = ("model3", "i3", "i3_speed", "e208", "leaf2013", "changchun")
NOTHING = 1e-6
FOR_EVER = 1e9  # cases: nothing that is rehearsed changes a band


def _bank(
    networks: tuple[float, float], loads: tuple[float, float]
) -> dict[ConstantPlace, object]:
    """The four hypotheses with other sizes of network, N, and load, W."""
    sizes = np.array([(network, load) for network in networks for load in loads])
    return {constant("BANK"): sizes}


def _without(*states: State) -> dict[ConstantPlace, float]:
    """States that stay at zero."""
    means = {prior(state, "mean"): 0.0 for state in states}
    return means | {prior(state, "std"): NOTHING for state in states}


def _unseen(state: CarState, *_: object) -> CarState:
    """The state as it was."""
    return state


NETWORKS, LOADS = (tuple(np.unique(sizes).tolist()) for sizes in BANK.T)
STARTS = (State.COLD_START, State.HOT_START)
VARIANTS = (
    Variant("whole"),
    Variant("no network", _bank((NOTHING, NOTHING), LOADS)),
    Variant("small networks alone", _bank((NETWORKS[0], NETWORKS[0]), LOADS)),
    Variant("no wandering load", _bank(NETWORKS, (NOTHING, NOTHING))),
    Variant("one size of the load", _bank(NETWORKS, (LOADS[1], LOADS[1]))),
    Variant("bands not rehearsed", {constant("PRIOR_CASES"): FOR_EVER}),
    Variant("hills the same everywhere", {constant("GROWTHS"): np.full(3, GROWTHS[1])}),
    Variant("no unseen hills", {constant("GROWTHS"): np.full(3, NOTHING * GROWTHS[0])}),
    Variant("reported loads teach nothing", {constant("see_reported_climate"): _unseen}),
    Variant("no outliers", {constant("OUTLIER"): 1e3}),
    Variant("noise not scaled", {constant("LEAST_SCALE"): 1.0, constant("MOST_SCALE"): 1.0}),
    Variant(
        "no offsets of a drive",
        {prior(each, "std"): NOTHING for each in (State.ROLLING_DRIVE, State.LOAD_DRIVE)},
    ),
    Variant("a drive keeps no offset of the last", {constant("DRIVE_KEPT"): 0.0}),
    Variant("cars do not drift", {constant("DRIFT"): 0.0}),
    Variant("no loss by turning", _without(State.TURNING)),
    Variant("no loss by force squared", _without(State.FORCE_SQUARED)),
    Variant("no heating and cooling", _without(State.COLD, State.HOT, *STARTS)),
    Variant("no start of heating", _without(*STARTS)),
    Variant("no cold tyres", _without(State.ROLLING_START, State.ROLLING_COLD)),
    Variant("reported heating is all true", _without(State.DOUBTED)),
)


def ablate(car: RecordedCar) -> Iterator[VariantRow]:
    """Every variant on one car."""
    for variant in VARIANTS:
        yield score(variant, car)
