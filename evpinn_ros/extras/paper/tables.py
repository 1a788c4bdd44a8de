"""The tables of the paper beside our results, for terminal and report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from evpinn_ros.common.units import JOULES_PER_WH
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.parameters import Parameters
from evpinn_ros.extras.paper.experiment import Outcome
from evpinn_ros.extras.paper.published import (
    COMPARED,
    ENERGY_LOSSES,
    LOGGED_EPOCHS,
    POWER_LOSSES,
    PREDICTED,
    Losses,
)
from evpinn_ros.extras.paper.scores import TableFiveRow, combinations

UNKNOWN = "-"
FOUR = ("eta", "mass", "c_rr", "c_d")
FINDING_COLUMNS = (
    *("", "guess", "found, 1-sigma", "from guess"),
    *("prior", "from data", "paper", "fit"),
)
DIGITS = {
    "eta": 4,
    "mu": 4,
    "mass": 0,
    "c_rr": 5,
    "c_d": 4,
    "mass_over_eta": 0,
    "drag_area_over_eta": 4,
    "regeneration": 4,
}
TITLES = {
    "mass": "mass, kg",
    "mass_over_eta": "mass/eta, kg",
    "drag_area_over_eta": "A C_d/eta, m\u00b2",
}


class ResultTable(NamedTuple):
    """A table of texts; the first column is aligned left, the others right."""

    title: str
    columns: Sequence[str]
    rows: list[list[str]]
    note: str


def all_tables(outcome: Outcome) -> Iterator[ResultTable]:
    """All tables in the order of the paper, each followed by the figures that it leaves out."""
    yield power_loss_table(outcome)
    yield energy_loss_table(outcome)
    yield parameter_table(outcome)
    yield combination_table(outcome)
    yield vehicle_table(outcome)
    yield power_table(outcome)
    yield energy_table(outcome)


def power_loss_table(outcome: Outcome) -> ResultTable:
    """Table II, or III for a Model S: this drive beside the paper's drive of that car."""
    key, number = "tesla_model_3_lr", "II"
    if outcome.vehicle.key == "tesla_model_s":
        key, number = outcome.vehicle.key, "III"
    published = {row.epoch: row for row in POWER_LOSSES[key]}
    measured = {row.epoch: row for row in outcome.training.rows}
    last = outcome.training.rows[-1].epoch
    rows = []
    for epoch in sorted({*LOGGED_EPOCHS, last}):
        both = measured.get(epoch), published.get(epoch)
        rows.append([f"{epoch} T", *(x for row in both for x in _losses(row and row.training))])
        rows.append([f"{epoch} V", *(x for row in both for x in _losses(row and row.validation))])
    columns = ["epoch", *Losses._fields, *(f"paper: {name}" for name in Losses._fields)]
    note = (
        "T training, V validation, under the paper's random split. Power is normalised to "
        "[-1, 1], which the paper does not state; physics includes lambda = 0.1. Epoch n is after "
        "the n-th step."
    )
    if key != outcome.vehicle.key:
        note = f"The paper's drive is not of a {outcome.vehicle.name}. {note}"
    name = outcome.settings.optimizer.value
    title = f"Table {number}: loss of the power network ({name}), paper: {load_vehicle(key).name}"
    return ResultTable(title, columns, rows, note)


def energy_loss_table(outcome: Outcome) -> ResultTable:
    """Losses of the energy network beside those of Table IV."""
    published = {row.epoch: row for row in ENERGY_LOSSES}
    measured = {row.epoch: row for row in outcome.energy_rows}
    rows = []
    for epoch in LOGGED_EPOCHS:
        ours, theirs = measured.get(epoch), published[epoch]
        for label, rknn, dnn in (("T", 1, 3), ("V", 2, 4)):
            our_losses = [_loss(None if ours is None else ours[column]) for column in (rknn, dnn)]
            rows.append([f"{epoch} {label}", *our_losses, _loss(theirs[rknn]), _loss(theirs[dnn])])
    return ResultTable(
        "Table IV: loss of the energy networks",
        ["epoch", "RKNN", "DNN", "paper RKNN", "paper DNN"],
        rows,
        "Energy of a step over its RMS. P(t + dt/2) is the mean of both ends. Epoch n is before "
        "the n-th step. A single epoch is accidental: at a constant learning rate, late losses "
        "vary a hundredfold, see Fig. 8.",
    )


def parameter_table(outcome: Outcome) -> ResultTable:
    """Table V, with figures that distinguish learned values from priors."""
    published = PREDICTED.get(outcome.vehicle.key)
    return ResultTable(
        "Table V: parameters",
        FINDING_COLUMNS,
        _finding_rows(
            outcome.parameters,
            {} if published is None else published._asdict(),
            outcome.regression._asdict(),
        ),
        "The paper calls the distance from the initial guess an error, but the truth is unknown. "
        "Prior: share of the prior's variance that is left; from data: whether the data determine "
        "the value, which is impossible for eta, mass or C_d by itself. Fit: eq. 21 by least "
        "squares, without a network.",
    )


def combination_table(outcome: Outcome) -> ResultTable:
    """Table of the combinations that data can determine in eq. 21."""
    published = PREDICTED.get(outcome.vehicle.key)
    area, form = outcome.vehicle.frontal_area, outcome.settings.form
    return ResultTable(
        "What the data can determine",
        FINDING_COLUMNS,
        _finding_rows(
            outcome.combinations,
            {} if published is None else combinations(published, area, form),
            combinations(outcome.regression, area, form),
        ),
        "Scaling eta, mass and C_d by the same factor, and mu by its inverse in the form "
        "wheel_power, changes no power: only these combinations enter eq. 21.",
    )


def _finding_rows(
    rows: Sequence[TableFiveRow], published: Mapping[str, float], fitted: Mapping[str, float]
) -> list[list[str]]:
    return [
        [
            TITLES.get(row.name, row.name),
            _number(row.name, row.initial),
            f"{_number(row.name, row.value)} \u00b1 {_number(row.name, row.std)}",
            f"{100 * (row.value - row.initial) / row.initial:+.1f} %",
            f"{100 * row.prior_share:.0f} %",
            "yes" if row.determined else "no",
            _number(row.name, published[row.name]) if row.name in published else UNKNOWN,
            _number(row.name, fitted[row.name]),
        ]
        for row in rows
    ]


def vehicle_table(outcome: Outcome) -> ResultTable:
    """Table VI: values of the vehicle files beside the paper's."""
    rows = []
    for compared in COMPARED:
        rows.append([compared.title, *(_number(n, getattr(compared, n)) for n in FOUR)])
        rows.append(["  our vehicle file", *_four(load_vehicle(compared.vehicle).initial)])
    for key, title in (("tesla_model_3_lr", "Model 3 LR"), ("tesla_model_s", "Model S")):
        rows.append([f"paper, {title}", *_four(PREDICTED[key])])
    rows.append([f"found here, {outcome.vehicle.name}", *_four(outcome.training.values)])
    return ResultTable(
        "Table VI: compared with other vehicles",
        ["vehicle", "eta", "mass, kg", "C_rr", "C_d"],
        rows,
        "The paper's values, and the priors of this package's vehicle files.",
    )


def power_table(outcome: Outcome) -> ResultTable:
    """Table of scores of every method on data outside its training."""
    rows = [
        [
            scored.method,
            scored.split,
            f"{scored.score.rmse_w:.0f}",
            f"{scored.score.mae_w:.0f}",
            r2_text(scored.score.r2),
            _percent(scored.score.energy_error_percent),
        ]
        for scored in outcome.scores
    ]
    return ResultTable(
        "Power on data not trained on",
        ["method", "scored on", "RMSE, W", "MAE, W", "R\u00b2", "energy"],
        rows,
        "With a random split, interpolation in time between neighbours needs no model of the car; "
        "a method that is no better proves nothing. The last 20 % is outside the training. "
        f"{_beyond(outcome)} `printed` is eq. 21 to the letter, `recovery` the reading that "
        "Table V implies.",
    )


def energy_table(outcome: Outcome) -> ResultTable:
    """Table of the energy of the drive by every integrator."""
    energies = outcome.energies
    exact = float(energies.measured[-1])
    entries = (
        ("measured power, exact quadrature", energies.measured),
        ("measured power, RKNN", energies.rknn),
        ("measured power, DNN", energies.dnn),
        ("network's power, exact quadrature", energies.predicted),
    )
    rows = [
        [
            title,
            f"{energy[-1] / JOULES_PER_WH:.2f} Wh",
            _percent(100.0 * (float(energy[-1]) - exact) / abs(exact) if exact else None),
        ]
        for title, energy in entries
    ]
    return ResultTable(
        "Energy of the drive",
        ["method", "energy", "error"],
        rows,
        "The network's power was trained on 80 % of this drive. dE/dt = P does not depend on E, "
        "so RK4 is Simpson's rule, which no network can improve.",
    )


def _beyond(outcome: Outcome) -> str:
    """Sentence on the network's power at times after those of its training."""
    rows = outcome.chronological.problem.split.validation
    powers = (power[rows] / 1000.0 for power in (outcome.unseen_power, outcome.log.power))
    network, measured = (f"{power.min():.0f} to {power.max():.0f} kW" for power in powers)
    return (
        "Time is an input of the network, and every time there is later than those it was trained "
        f"on: it predicts {network}; {measured} were measured. `time held` gives it the last "
        "trained time instead."
    )


def r2_text(value: float | None) -> str:
    """Text of R\u00b2 with its significant digits."""
    return UNKNOWN if value is None else f"{value:.4f}" if value > -10.0 else f"{value:.0f}"


def _losses(losses: Losses | None) -> list[str]:
    return [UNKNOWN] * len(Losses._fields) if losses is None else [_loss(x) for x in losses]


def _four(values: Parameters) -> list[str]:
    return [_number(name, getattr(values, name)) for name in FOUR]


def _number(name: str, value: float) -> str:
    return f"{value:.{DIGITS[name]}f}"


def _loss(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.4g}"


def _percent(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:+.2f} %"
