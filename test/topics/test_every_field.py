"""Every field of a published value is in its message; one that is not is named here."""

from typing import Any

import numpy as np
import pytest

from evpinn_ros.bags.types import encode, new_message
from evpinn_ros.core.energy.account import AccountSummary, EnergyTotals
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import UNKNOWN_END, Forecast
from evpinn_ros.core.energy.meter import EnergyState, Flow
from evpinn_ros.core.energy.remaining import Remaining
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.estimate import (
    ParameterEstimate,
    ParameterSet,
    PowerEstimate,
    PowerKind,
    Trust,
)
from evpinn_ros.core.estimation.lag import Lag
from evpinn_ros.core.estimation.terms import COUNT
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES, Identifiable
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.replays.energy_metrics import account_metrics, breakdown_metrics
from evpinn_ros.topics import ENERGY_STATE, POWER_SMOOTHED, energies, estimates
from evpinn_ros.topics.messages import header
from evpinn_ros.topics.plans import forecast_message
from test.declared import changes

NOW = 1_700_000_000_250_000_000
TOTALS = EnergyTotals(9e6, 1e6, 4e8, 5e4, 7e6, 30.0, 5.0)
SUMMARY = AccountSummary(
    stamp_ns=NOW,
    since_reset=TOTALS,
    lifetime=TOTALS.plus(TOTALS),
    consumption={"10": 500.0, "trip": 480.0},
    charge=Uncertain(0.5, 0.01),
    projected=False,
    capacity=Uncertain(2e8, 1e7),
    usable=Uncertain(1e8, 5e6),
    remaining=Remaining(2e5, 1e4, 1.8e5, 2.2e5),
)
ESTIMATE = ParameterEstimate(0.5, 0.1, 0.3, 0.2, 0.8, Trust.ESTIMATING, 40.0)
PARAMETERS = ParameterSet(
    stamp_ns=NOW,
    parameters=dict.fromkeys(PARAMETER_NAMES, ESTIMATE),
    identifiable=Identifiable(2000.0, 0.7, 0.01, 0.6, 400.0),
    identifiable_std=Identifiable(50.0, 0.1, 0.001, 0.1, 40.0),
    reliable=False,
    identifiable_trust=dict.fromkeys(IDENTIFIABLE_NAMES, Trust.ESTIMATING),
    lag=Lag(1.0, 0.02),
)
STATE = EnergyState(
    stamp_ns=NOW,
    measured=Flow(9e6, 1.1e4, 1e3),
    predicted=Flow(9.1e6, 1.2e4, 2e3),
    rknn=Flow(9.2e6, 1.3e4, 2e3),
    regenerated=Flow(1e6, 0.0, 3e3),
    consumed=9e6,
    consumed_sigma=3e3,
    gaps=1,
    dropped=2,
    unmeasured_s=30.0,
    unknown_s=5.0,
    measuring=True,
)
POWER = PowerEstimate(PowerKind.SMOOTHED, NOW, 1e4, 300.0, 5e5, 1e4)
BREAKDOWN = Breakdown(
    measured=9e6,
    measured_variance=1e8,
    distance=5e4,
    seconds=3e3,
    unseen=1e3,
    noise=1e9,
    energy=np.arange(1.0, 1.0 + COUNT) * 1e5,
    covariance=np.eye(COUNT) * 1e8,
)
FORECAST = Forecast(*(scale * np.arange(1.0, 4.0) for scale in (10.0, 1e5, 1e3, 1e4)))


def output_bytes(output: Any) -> list[tuple[str, bytes]]:
    """All messages of an output of the estimator or the account, by topic."""
    return [
        (topic.name, encode(message))
        for topic, message in energies.output_messages(new_message, output)
    ]


def breakdown_bytes(breakdown: Breakdown) -> list[bytes]:
    messages = estimates.breakdown_messages(new_message, NOW, breakdown)
    return [encode(message) for _, message in messages]


def forecast_bytes(forecast: Forecast) -> bytes:
    columns = forecast.time, forecast.energy, forecast.power, forecast.sigma
    return encode(forecast_message(new_message, header(new_message, NOW), *columns))


def figures(parameters: ParameterSet) -> dict[str, Any]:
    return {name: p.figures() for name, p in parameters.parameters.items()}


IN_DIAGNOSTICS = {"gaps", "dropped", "unmeasured_s", "unknown_s"}
# Value, its form, and the fields that are elsewhere.
FORMS = {
    "parameters, messages": (
        PARAMETERS,
        output_bytes,
        # `/diagnostics` has these, and the shift for the shortest lag that is applied.
        {
            *("parameters.trust", "parameters.progress", "parameters.possible"),
            *("identifiable_trust", "lag.least"),
        },
    ),
    "parameters, metrics": (
        PARAMETERS,
        figures,
        {
            *("stamp_ns", "reliable", "parameters.progress", "parameters.possible"),
            *("identifiable_trust", "lag.seconds", "lag.sigma", "lag.least"),
            *(f"identifiable.{name}" for name in IDENTIFIABLE_NAMES),
            *(f"identifiable_std.{name}" for name in IDENTIFIABLE_NAMES),
        },
    ),
    "power": (POWER, output_bytes, set()),
    "energy": (STATE, output_bytes, IN_DIAGNOSTICS),
    "account, messages": (
        SUMMARY,
        output_bytes,
        # `driven` over `distance` is a consumption; `/diagnostics` has the others.
        {
            "projected",
            *(
                f"{totals}.{name}"
                for totals in ("since_reset", "lifetime")
                for name in ("driven", "unmeasured_s", "unknown_s")
            ),
        },
    ),
    "account, metrics": (
        SUMMARY,
        account_metrics,
        {
            *("stamp_ns", "charge.sigma", "capacity.sigma", "usable.sigma", "remaining.sigma"),
            *("since_reset.driven", "since_reset.unknown_s", "lifetime.driven"),
            *("lifetime.unmeasured_s", "lifetime.unknown_s", "lifetime.distance"),
            "lifetime.variance",
        },
    ),
    "breakdown, message": (BREAKDOWN, breakdown_bytes, {"distance", "seconds", "unseen"}),
    "breakdown, metrics": (BREAKDOWN, lambda value: breakdown_metrics(value, "hybrid"), set()),
    # `end` is what `energy/forecast/status` compares plans by.
    # `curve` is read at the plan's own points, which the message holds.
    "forecast": (
        FORECAST,
        forecast_bytes,
        {"curve", *(f"end.{name}" for name in UNKNOWN_END._fields)},
    ),
}


@pytest.mark.parametrize("name", FORMS)
def test_every_field_has_a_place(name):
    value, form, elsewhere = FORMS[name]
    before = form(value)
    assert {path for path, changed in changes(value) if form(changed) == before} == elsewhere


def test_what_is_read_from_messages_is_what_was_sent():
    sent = dict(energies.output_messages(new_message, POWER))
    assert estimates.read_power(POWER_SMOOTHED, sent[POWER_SMOOTHED]) == POWER
    heard = energies.read_energy(dict(energies.output_messages(new_message, STATE))[ENERGY_STATE])
    names = {"stamp_ns", "measured", "predicted", "rknn", "regenerated", "measuring"}
    assert all(getattr(heard, name) == getattr(STATE, name) for name in names)
    by_topic = {
        topic.name: message for topic, message in energies.output_messages(new_message, PARAMETERS)
    }
    messages = (by_topic[f"estimate/{name}"] for name in ("parameters", "identifiable", "bounds"))
    read = estimates.read_parameters(*messages)
    for name in ("stamp_ns", "identifiable", "identifiable_std"):
        assert getattr(read, name) == getattr(PARAMETERS, name)
    for name in ("value", "std", *estimates.BOUNDS):
        assert {getattr(p, name) for p in read.parameters.values()} == {getattr(ESTIMATE, name)}
    ((_, message),) = estimates.breakdown_messages(new_message, NOW, BREAKDOWN)
    amounts = {**BREAKDOWN.amounts(), "measured": BREAKDOWN.total()}
    assert estimates.read_breakdown(message) == {
        name: (pytest.approx(amount.kwh), pytest.approx(amount.sigma_kwh))
        for name, amount in amounts.items()
    }
