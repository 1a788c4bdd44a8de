"""Outputs of the energy meter as ROS 2 messages; the estimator does not load this module."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import Any

from evpinn_ros import topics
from evpinn_ros.core.energy.account import AccountSummary, EnergyTotals
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.meter import EnergyState, Flow
from evpinn_ros.core.estimation.outputs import Output
from evpinn_ros.topics import Topic
from evpinn_ros.topics.estimates import estimate_messages, uncertain_vector
from evpinn_ros.topics.messages import NewMessage, named_vector, read_named_vector, scalar

FLOWS = ("measured", "predicted", "rknn", "regenerated")
JOULES_PER_METRE = 3.6  # in one Wh/km
UNKNOWN_FLOW = Flow(math.nan, math.nan, math.nan)


def output_messages(
    new: NewMessage, output: Output | EnergyState | AccountSummary
) -> Iterator[tuple[Topic, Any]]:
    """Every message of one output of estimator or meter; ValueError if a number is not finite."""
    if isinstance(output, EnergyState):
        yield from _energy_messages(new, output)
    elif isinstance(output, AccountSummary):
        yield from _summary_messages(new, output)
    else:
        yield from estimate_messages(new, output)


def _energy_messages(new: NewMessage, state: EnergyState) -> Iterator[tuple[Topic, Any]]:
    power = state.measured.power if state.measuring else state.predicted.power
    consumed = Flow(state.consumed, power, state.consumed_sigma)
    flows = state.measured, state.predicted, state.rknn, state.regenerated, consumed
    # A sum is finite if both terms are.
    finite = [
        (name, *flow)
        for name, flow in zip((*FLOWS, "consumed"), flows, strict=True)
        if math.isfinite(flow.energy + flow.power)
    ]
    if finite:
        names, energies, powers, sigmas = zip(*finite, strict=True)
        vector = named_vector(new, state.stamp_ns, names, energies, sigmas, powers)
        yield topics.ENERGY_STATE, vector
    yield topics.ENERGY_CONSUMED, scalar(new, state.consumed)


def _summary_messages(new: NewMessage, summary: AccountSummary) -> Iterator[tuple[Topic, Any]]:
    totals = _totals("", summary.since_reset) | _totals("lifetime_", summary.lifetime)
    yield topics.ENERGY_TOTALS, uncertain_vector(new, summary.stamp_ns, totals)
    driven = {
        f"wh_per_km_{name}": cost / JOULES_PER_METRE for name, cost in summary.consumption.items()
    }
    driven |= {
        "distance_trip": summary.since_reset.distance,
        "distance_lifetime": summary.lifetime.distance,
    }
    consumption = named_vector(new, summary.stamp_ns, list(driven), list(driven.values()))
    yield topics.ENERGY_CONSUMPTION, consumption
    values_by_name = {
        "usable_energy": summary.usable,
        "state_of_charge": summary.charge,
        "capacity": summary.capacity,
    }
    if summary.remaining is not None:
        distance, sigma, lower, upper = summary.remaining
        values_by_name |= {
            "distance_to_empty": Uncertain(distance, sigma),
            "distance_lower": Uncertain(lower, 0.0),
            "distance_upper": Uncertain(upper, 0.0),
        }
    finite = {name: value for name, value in values_by_name.items() if value.known}
    if finite:
        yield topics.ENERGY_RANGE, uncertain_vector(new, summary.stamp_ns, finite)


def _totals(prefix: str, totals: EnergyTotals) -> dict[str, Uncertain]:
    """Totals by name; drawn and regenerated energy have the 1-sigma of the net energy."""
    net = totals.net
    return {
        f"{prefix}net": net,
        f"{prefix}drawn": Uncertain(totals.drawn, net.sigma),
        f"{prefix}regenerated": Uncertain(totals.regenerated, net.sigma),
    }


def read_energy(message: Any) -> EnergyState:
    """The state in a message of `energy/state`; NaN or 0 for what the topic lacks."""
    vector = read_named_vector(message)
    flows = {
        name: Flow(vector.values[name], vector.rates[name], vector.sigmas.get(name, math.nan))
        if name in vector.rates
        else UNKNOWN_FLOW
        for name in FLOWS
    }
    return EnergyState(
        stamp_ns=vector.stamp_ns,
        **flows,
        consumed=math.nan,
        consumed_sigma=math.nan,
        gaps=0,
        dropped=0,
        unmeasured_s=math.nan,
        unknown_s=math.nan,
        measuring="measured" in vector.values,
    )
