"""Outputs of the estimator and the energy meter as ROS 2 messages, for nodes and bags alike."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import TYPE_CHECKING, Any

from evpinn_ros import topics
from evpinn_ros.energy.account import AccountSummary, Totals
from evpinn_ros.energy.charge import Uncertain
from evpinn_ros.energy.meter import EnergyState, Flow
from evpinn_ros.estimation.breakdown import JOULES_PER_KWH, Breakdown
from evpinn_ros.estimation.estimate import ParameterSet, PowerEstimate, PowerKind
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import NewMessage, named_vector, scalar
from evpinn_ros.vehicle.identifiable import IDENTIFIABLE_NAMES

if TYPE_CHECKING:  # for its type alone: the energy node would load torch with it
    from evpinn_ros.estimation.estimator import Output

POWER_TOPICS = {
    PowerKind.MEASURED: topics.POWER_MEASURED,
    PowerKind.PREDICTED: topics.POWER_PREDICTED,
    PowerKind.SMOOTHED: topics.POWER_SMOOTHED,
}
FLOWS = ("measured", "predicted", "rknn", "regenerated")
UNMEASURED_ENERGY = "unmeasured_energy"  # J, predicted since the battery was last measured
JOULES_PER_METRE = 3.6  # in a Wh/km


def output_messages(new: NewMessage, output: Output) -> Iterator[tuple[Topic, Any]]:
    """Every message that one output of the estimator leads to.

    Raises:
        ValueError: a number is not finite; nothing of this output may then be published.
    """
    if isinstance(output, PowerEstimate):
        names, values, sigmas = ["power"], [output.power], [output.sigma]
        if math.isfinite(output.energy_sigma):
            names.append(UNMEASURED_ENERGY)
            values.append(output.energy)
            sigmas.append(output.energy_sigma)
        vector = named_vector(new, output.stamp_ns, names, values, sigmas)
        yield POWER_TOPICS[output.kind], vector
    else:
        yield from _parameter_messages(new, output)


def _parameter_messages(new: NewMessage, found: ParameterSet) -> Iterator[tuple[Topic, Any]]:
    names = list(found.parameters)
    values = [estimate.value for estimate in found.parameters.values()]
    sigmas = [estimate.std for estimate in found.parameters.values()]
    live = named_vector(new, found.stamp_ns, names, values, sigmas)
    yield topics.PARAMETERS, live
    yield (
        topics.IDENTIFIABLE,
        named_vector(
            new,
            found.stamp_ns,
            IDENTIFIABLE_NAMES,
            list(found.identifiable),
            list(found.identifiable_std),
        ),
    )
    bounds = {
        f"{name}_{end}": getattr(estimate, end)
        for name, estimate in found.parameters.items()
        for end in ("lower", "upper", "prior_share")
    }
    yield topics.BOUNDS, named_vector(new, found.stamp_ns, list(bounds), list(bounds.values()))
    if found.reliable:
        yield topics.RELIABLE, live
    for topic in topics.PARAMETER_SCALARS:
        name = topic.name.rpartition("/")[2]
        yield topic, scalar(new, found.parameters[name].value)


def breakdown_messages(
    new: NewMessage, stamp_ns: int, found: Breakdown | None
) -> Iterator[tuple[Topic, Any]]:
    """The message of a breakdown; none while there is none."""
    if found is None:
        return
    amounts = {**found.amounts(), "measured": found.total()}
    names, energies = list(amounts), [each.kwh * JOULES_PER_KWH for each in amounts.values()]
    sigmas = [each.sigma_kwh * JOULES_PER_KWH for each in amounts.values()]
    yield topics.ENERGY_BREAKDOWN, named_vector(new, stamp_ns, names, energies, sigmas)


def energy_messages(new: NewMessage, state: EnergyState) -> Iterator[tuple[Topic, Any]]:
    """The messages of an energy state; a flow not known yet is left out of the vector."""
    flows = {name: getattr(state, name) for name in FLOWS}
    power = state.measured.power if state.measuring else state.predicted.power
    flows["consumed"] = Flow(state.consumed, power, state.consumed_sigma)
    known = {
        name: flow
        for name, flow in flows.items()
        if math.isfinite(flow.energy) and math.isfinite(flow.power)
    }
    if known:
        yield (
            topics.ENERGY_STATE,
            named_vector(
                new,
                state.stamp_ns,
                list(known),
                [flow.energy for flow in known.values()],
                [flow.sigma for flow in known.values()],
                [flow.power for flow in known.values()],
            ),
        )
    yield topics.ENERGY_CONSUMED, scalar(new, state.consumed)


def summary_messages(new: NewMessage, summary: AccountSummary) -> Iterator[tuple[Topic, Any]]:
    """The messages of an energy account; what is not known yet is left out."""
    totals = _totals("", summary.since_reset) | _totals("lifetime_", summary.lifetime)
    yield topics.ENERGY_TOTALS, _vector(new, summary.stamp_ns, totals)
    driven = {
        f"wh_per_km_{name}": cost / JOULES_PER_METRE for name, cost in summary.consumption.items()
    }
    driven |= {
        "distance_trip": summary.since_reset.distance,
        "distance_lifetime": summary.lifetime.distance,
    }
    consumption = named_vector(new, summary.stamp_ns, list(driven), list(driven.values()))
    yield topics.ENERGY_CONSUMPTION, consumption
    found = {
        "usable_energy": summary.usable,
        "state_of_charge": summary.charge,
        "capacity": summary.capacity,
    }
    if summary.remaining is not None:
        distance, sigma, lower, upper = summary.remaining
        found |= {
            "distance_to_empty": Uncertain(distance, sigma),
            "distance_lower": Uncertain(lower, 0.0),
            "distance_upper": Uncertain(upper, 0.0),
        }
    known = {name: value for name, value in found.items() if value.known}
    if known:
        yield topics.ENERGY_RANGE, _vector(new, summary.stamp_ns, known)


def _totals(prefix: str, totals: Totals) -> dict[str, Uncertain]:
    """Drawn and regenerated energy are as unsure as the net energy that they are parts of."""
    net = totals.net
    return {
        f"{prefix}net": net,
        f"{prefix}drawn": Uncertain(totals.drawn, net.sigma),
        f"{prefix}regenerated": Uncertain(totals.regenerated, net.sigma),
    }


def _vector(new: NewMessage, stamp_ns: int, found: dict[str, Uncertain]) -> Any:
    values = [each.value for each in found.values()]
    return named_vector(
        new, stamp_ns, list(found), values, [each.sigma for each in found.values()]
    )
