"""`evpinn bench ablation`: scores the core without each of its parts, the battery hidden.

`evpinn bench plans` shows what the unevenness of speed is worth: it also scores even speed.
"""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from itertools import product
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.cli import output
from benchmarks.variants import (
    SCORE_COLUMNS,
    SEEDS,
    ConstantPlace,
    Variant,
    VariantRow,
    read_car,
    score,
)
from evpinn_ros.cli.console import show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.core.estimation.gaussian import replace_states
from evpinn_ros.core.estimation.journey import noise_of
from evpinn_ros.core.estimation.posterior import (
    BANK,
    LOAD_STDS,
    NETWORK_STDS,
    CarState,
    begin_drive,
)
from evpinn_ros.core.estimation.states import OFFSETS, SIZE, WEIGHTS, State
from evpinn_ros.core.estimation.terms import Equation, Warmth, standing_powers
from evpinn_ros.core.signals.interval import Steps
from evpinn_ros.core.signals.road import Conditions

CARS = ("model3", "i3", "i3_speed", "e208", "changchun", "simulated")
NOTHING = 1e-6


def _bank(networks: tuple[float, ...], loads: tuple[float, ...]) -> dict[ConstantPlace, Any]:
    """Other hypotheses: 1-sigma of a weight of the network, N, and of the wandering load, W."""
    return {ConstantPlace("posterior", "BANK"): np.array(list(product(networks, loads)))}


def _without(*states: State) -> dict[ConstantPlace, float]:
    """States that stay at zero."""
    return {
        ConstantPlace(state, key): value
        for state in states
        for key, value in {"mean": 0.0, "std": NOTHING}.items()
    }


def _forget_network(state: CarState, equation: Equation, **keep: float) -> CarState:
    """Begin a drive with a network that knows nothing of those before it."""
    state = begin_drive(state, equation, **keep)
    fresh = dict.fromkeys(range(SIZE)[WEIGHTS], BANK[:, 0] ** 2)
    return state.with_gaussian(replace_states(state.gaussian, fresh))


def _unreported(conditions: Conditions, warmth: Warmth) -> dict[State, float]:
    """Standing powers of a car that reports nothing."""
    return standing_powers(conditions._replace(load_known=False), warmth)


def _fixed(growth: float) -> dict[ConstantPlace, Any]:
    """Unseen hills of one size, m^2 per m, instead of a learned one."""
    return {ConstantPlace("bands", "GROWTHS"): np.full(3, growth)}


def _one_noise(steps: Steps) -> np.ndarray:
    """One noise for standing and moving."""
    return np.array((0.0, float(noise_of(steps).sum()), 0.0))


STARTS = (State.COLD_START, State.HOT_START)
# Between the hypotheses of the bank, by their geometric mean.
MIDDLE = tuple(float(np.sqrt(np.prod(stds))) for stds in (NETWORK_STDS, LOAD_STDS))

VARIANTS = (
    Variant("whole"),
    Variant("no network", _bank((NOTHING,), LOAD_STDS)),
    Variant("network of one drive alone", {ConstantPlace("car", "begin_drive"): _forget_network}),
    Variant("no bank, its middle alone", _bank(MIDDLE[:1], MIDDLE[1:])),
    Variant("small network alone", _bank(NETWORK_STDS[:1], LOAD_STDS)),
    Variant("large network alone", _bank(NETWORK_STDS[1:], LOAD_STDS)),
    Variant("no wandering load", _bank(NETWORK_STDS, (NOTHING,))),
    Variant("small wandering load alone", _bank(NETWORK_STDS, LOAD_STDS[:1])),
    Variant("no offsets of a drive", _without(*OFFSETS)),
    Variant(
        "a drive keeps no offset of the last",
        {ConstantPlace("car", "begin_drive"): partial(begin_drive, keep=0.0)},
    ),
    Variant("no share of a drive", {ConstantPlace("posterior", "LOSS_SHOWN"): NOTHING}),
    Variant("no cold tyres", _without(State.ROLLING_START, State.ROLLING_COLD)),
    Variant("no loss by turning", _without(State.TURNING)),
    Variant("no loss by force squared", _without(State.FORCE_SQUARED)),
    Variant("no heating and cooling", _without(State.COLD, State.HOT, *STARTS)),
    Variant("no start of heating", _without(*STARTS)),
    Variant("reported loads ignored", {ConstantPlace("terms", "standing_powers"): _unreported}),
    Variant("bands not scaled", {ConstantPlace("bands", "DEGREES"): 1e12}),
    Variant("hills of one size", _fixed(0.004)),
    Variant("no unseen hills", _fixed(0.0)),
    Variant("no heavy tails", {ConstantPlace("posterior", "OUTLIER"): 1e3}),
    Variant(
        "noise not scaled",
        {ConstantPlace("posterior", key): 1.0 for key in ("LEAST_SCALE", "MOST_SCALE")},
    ),
    Variant("one noise standing and moving", {ConstantPlace("journey", "noise_of"): _one_noise}),
    Variant("a car does not change", {ConstantPlace("posterior", "DRIFT"): 0.0}),
)


def ablation(
    data: output.DataArgument,
    cars: Annotated[str, output.cars_option(CARS)] = "",
    seeds: Annotated[int, typer.Option(min=1, help="Networks whose scores are averaged.")] = len(
        SEEDS
    ),
    jobs: output.JobsOption = 2,
    json_file: JsonOption = None,
) -> None:
    """Score drives with each part of the core left out in turn.

    Example: evpinn bench ablation $DATA --cars i3,e208
    """
    keys = output.chosen_cars(data, cars, CARS)
    rows: list[VariantRow] = []
    with output.json_as_it_comes(
        json_file, lambda: list(map(asdict, rows)), (data, *keys)
    ) as keep:
        read = [read_car(data, key) for key in keys]
        tasks = [(variant, car, range(seeds)) for car in read for variant in VARIANTS]
        for row in output.in_parallel("variants", jobs, score, tasks):
            rows.append(row)
            keep()
    for key in keys:
        _show([row for row in rows if row.car == key])


def _show(rows: list[VariantRow]) -> None:
    whole = rows[0]
    lost = ["", *("{:+.2f} +- {:.2f}".format(*whole.gain(row)) for row in rows[1:])]
    columns = ("left out", "{0.variant}"), *SCORE_COLUMNS, ("lost likelihood", "{1}")
    table = output.table_of(whole.car, list(zip(rows, lost, strict=True)), columns)
    show(table, at_least=output.TABLE_WIDTH)
