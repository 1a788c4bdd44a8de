"""The service `EstimatePlan` of `evpinn_msgs`: plans in, energies and their differences out."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numpy as np

from evpinn_ros.energy.forecaster import PlanAnswer, PlanLog
from evpinn_ros.energy.plan import Plan, PlanError, Question, plan_from_speed_profile

MOST_PLANS = 100
MOST_POINTS = 2_000_000
"""Of all plans of a call together, some seconds of work."""


def answer_plans(
    request: Any,
    response: Any,
    answer: Callable[[Plan, Question], PlanAnswer],
    log: PlanLog,
) -> Any:
    """Fill the response; a plan that cannot be driven has its reason there, and NaN elsewhere.

    Args:
        request: of the service; plans beyond `MOST_PLANS` or `MOST_POINTS` are refused.
        response: of the service.
        answer: forecasts a plan, and compares it with those of the same question before it.
        log: counts the plans.
    """
    count, points, together = len(request.plans), 0, object()
    more, sigmas = np.full((2, count, count), math.nan)
    found = np.full((4, count), math.nan)  # energy and charge at the end, each with its sigma
    for index, asked in enumerate(request.plans):
        try:
            if index >= MOST_PLANS:
                raise PlanError(f"more than {MOST_PLANS} plans")
            points += len(asked.time)
            if points > MOST_POINTS:
                raise PlanError(f"more than {MOST_POINTS} points with the plans before it")
            one = answer(_plan(asked), Question(str(index), together))
        except PlanError as error:
            response.refusals.append(str(error))
            log.refuse(str(error))
            continue
        response.refusals.append("")
        log.answer(one.charge)
        found[:, index] = one.forecast.energy[-1], one.forecast.sigma[-1], *one.charge
        more[index, index] = sigmas[index, index] = 0.0
        for name, apart in one.differences.items():
            other = int(name)
            more[index, other], more[other, index] = apart.value, -apart.value
            sigmas[index, other] = sigmas[other, index] = apart.sigma
    response.energies, response.sigmas = found[:2].tolist()
    response.end_charges, response.end_charge_sigmas = found[2:].tolist()
    response.differences = more.ravel().tolist()
    response.difference_sigmas = sigmas.ravel().tolist()
    return response


def refuse_plans(request: Any, response: Any, reason: str) -> Any:
    """Fill the response: no plan is answered, for one reason."""
    count = len(request.plans)
    response.refusals = [reason] * count
    for name in ("energies", "sigmas", "end_charges", "end_charge_sigmas"):
        setattr(response, name, [math.nan] * count)
    response.differences = response.difference_sigmas = [math.nan] * count**2
    return response


def _plan(asked: Any) -> Plan:
    time, distance, speed, elevation = (
        np.array(each, dtype=float)
        for each in (asked.time, asked.distance, asked.speed, asked.elevation)
    )
    return plan_from_speed_profile(time, distance, speed, elevation if elevation.size else None)
