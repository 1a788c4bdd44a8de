"""Outputs of the estimator as ROS 2 messages; readers raise `BadMessage`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
from typing import Any

from evpinn_ros import topics
from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.estimate import (
    ParameterEstimate,
    ParameterSet,
    PowerEstimate,
    PowerKind,
    Trust,
)
from evpinn_ros.core.estimation.outputs import Output
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES, Identifiable
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import (
    BadMessage,
    NewMessage,
    named_vector,
    read_named_vector,
    scalar,
)

POWER_TOPICS = {
    PowerKind.MEASURED: topics.POWER_MEASURED,
    PowerKind.PREDICTED: topics.POWER_PREDICTED,
    PowerKind.SMOOTHED: topics.POWER_SMOOTHED,
}
POWER_KINDS = {topic: kind for kind, topic in POWER_TOPICS.items()}
POWER, LAG = "power", "lag"
UNMEASURED_ENERGY = "unmeasured_energy"  # J, predicted since the battery was last measured
BOUNDS = ("lower", "upper", "prior_share")


def estimate_messages(new: NewMessage, output: Output) -> Iterator[tuple[Topic, Any]]:
    """Every message of one output; ValueError if a number is not finite."""
    if isinstance(output, PowerEstimate):
        names, values, sigmas = [POWER], [output.power], [output.sigma]
        if math.isfinite(output.energy_sigma):
            names.append(UNMEASURED_ENERGY)
            values.append(output.energy)
            sigmas.append(output.energy_sigma)
        yield POWER_TOPICS[output.kind], named_vector(new, output.stamp_ns, names, values, sigmas)
    else:
        yield from _parameter_messages(new, output)


def _parameter_messages(
    new: NewMessage, parameter_set: ParameterSet
) -> Iterator[tuple[Topic, Any]]:
    stamp_ns = parameter_set.stamp_ns
    parameters = {name: Uncertain(p.value, p.std) for name, p in parameter_set.parameters.items()}
    live = uncertain_vector(new, stamp_ns, parameters)
    yield topics.PARAMETERS, live
    sums = map(Uncertain, parameter_set.identifiable, parameter_set.identifiable_std)
    combined = dict(zip(IDENTIFIABLE_NAMES, sums, strict=True))
    yield topics.IDENTIFIABLE, uncertain_vector(new, stamp_ns, combined)
    bounds = {
        f"{name}_{bound}": getattr(estimate, bound)
        for name, estimate in parameter_set.parameters.items()
        for bound in BOUNDS
    }
    yield topics.BOUNDS, named_vector(new, stamp_ns, list(bounds), list(bounds.values()))
    if parameter_set.reliable:
        yield topics.RELIABLE, live
    if (lag := parameter_set.lag) is not None:
        yield topics.LAG, uncertain_vector(new, stamp_ns, {LAG: Uncertain(lag.seconds, lag.sigma)})
    for topic in topics.PARAMETER_SCALARS:
        name = topic.name.rpartition("/")[2]
        yield topic, scalar(new, parameter_set.parameters[name].value)


def breakdown_messages(
    new: NewMessage, stamp_ns: int, breakdown: Breakdown | None
) -> Iterator[tuple[Topic, Any]]:
    """The message of a breakdown; none if it is None."""
    if breakdown is None:
        return
    amounts = {**breakdown.amounts(), "measured": breakdown.total()}
    energies = {
        name: Uncertain(amount.kwh * JOULES_PER_KWH, amount.sigma_kwh * JOULES_PER_KWH)
        for name, amount in amounts.items()
    }
    yield topics.ENERGY_BREAKDOWN, uncertain_vector(new, stamp_ns, energies)


def uncertain_vector(
    new: NewMessage, stamp_ns: int, values_by_name: Mapping[str, Uncertain]
) -> Any:
    """A named vector of values and their 1-sigma."""
    values, sigmas = zip(*values_by_name.values(), strict=True)
    return named_vector(new, stamp_ns, list(values_by_name), values, sigmas)


# --- readers -----------------------------------------------------------------------------------


def read_power(topic: Topic, message: Any) -> PowerEstimate:
    """Power of one of `POWER_TOPICS`, with the energy predicted since the last battery reading."""
    vector = read_named_vector(message)
    values, sigmas = vector.values, vector.sigmas
    if POWER not in values:
        raise BadMessage("no_power")
    numbers = values[POWER], sigmas.get(POWER, math.nan), math.nan, math.nan
    if UNMEASURED_ENERGY in values:
        energy = values[UNMEASURED_ENERGY], sigmas.get(UNMEASURED_ENERGY, math.nan)
        numbers = (*numbers[:2], *energy)
    return PowerEstimate(POWER_KINDS[topic], vector.stamp_ns, *numbers)


def read_identifiable(message: Any) -> tuple[Identifiable, Identifiable]:
    """The identifiable combinations, and their 1-sigma."""
    vector = read_named_vector(message)
    values, sigmas = (
        Identifiable(*_all(numbers, IDENTIFIABLE_NAMES))
        for numbers in (vector.values, vector.sigmas)
    )
    return values, sigmas


def read_breakdown(message: Any) -> dict[str, tuple[float, float]]:
    """Energy and 1-sigma by part, kWh."""
    vector = read_named_vector(message)
    return {
        name: (energy / JOULES_PER_KWH, vector.sigmas.get(name, math.nan) / JOULES_PER_KWH)
        for name, energy in vector.values.items()
    }


def read_parameters(parameters: Any, combined: Any, bounds: Any) -> ParameterSet:
    """A parameter set from messages published together; statuses are not on the topics."""
    live, limits = read_named_vector(parameters), read_named_vector(bounds).values
    values = _all(live.values, PARAMETER_NAMES)
    estimates = {}
    for name, value in zip(PARAMETER_NAMES, values, strict=True):
        std, bound = live.sigmas.get(name, math.nan), bounds_of(limits, name)
        estimates[name] = ParameterEstimate(
            value, std, bound["prior_share"], bound["lower"], bound["upper"], Trust.ESTIMATING
        )
    return ParameterSet(live.stamp_ns, estimates, *read_identifiable(combined), reliable=False)


def bounds_of(limits: Mapping[str, float], name: str) -> dict[str, float]:
    """Each of `BOUNDS` of a parameter, from the values of `estimate/bounds`; NaN if missing."""
    return {bound: limits.get(f"{name}_{bound}", math.nan) for bound in BOUNDS}


def _all(numbers: Mapping[str, float], names: tuple[str, ...]) -> list[float]:
    if not {*names} <= {*numbers}:
        raise BadMessage("incomplete")
    return [numbers[name] for name in names]
