"""Statuses of the energy node, without ROS."""

from __future__ import annotations

import math

from evpinn_ros.common.units import JOULES_PER_WH
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.dropout import Reconciled, Verdict
from evpinn_ros.core.energy.forecast import Air
from evpinn_ros.core.energy.forecaster import Basis, PlanAnswer, PlanLog
from evpinn_ros.nodes.diagnosis import MISSING_AFTER, Condition, Status, rounded, with_health
from evpinn_ros.topics.messages import Level

NO_POWER = "no power/smoothed"


def meter_status(account: EnergyAccount, condition: Condition) -> Status:
    """The health of the energy meter."""
    state, lifetime = account.state, account.lifetime()
    values = {
        "consumed_wh": _wh(state.consumed),
        "consumed_sigma_wh": _wh(state.consumed_sigma),
        "lifetime_wh": _wh(lifetime.net.value),
        "lifetime_km": rounded(lifetime.distance / 1e3),
        "measuring": state.measuring,
        "unmeasured_s": rounded(state.unmeasured_s),
        "unknown_s": rounded(state.unknown_s),
        "gaps": state.gaps,
        "dropped": state.dropped,
        "power_age_s": rounded(condition.age),
        "time_jumps": condition.jumps,
        **_dropout_values(account.reconciled),
    }
    if condition.file_problem is not None:
        values["energy_file"] = condition.file_problem
    level, text = _meter_verdict(account, condition)
    if text == NO_POWER:
        text += f" for {condition.age:.0f} s"
    return with_health(Status("meter", level, text, values), condition.health)


def energy_phases(account: EnergyAccount, basis: Basis, condition: Condition) -> list[Status]:
    """Texts that are logged when they change, so they contain no counts."""
    meter = Status("meter", *_meter_verdict(account, condition), {})
    return [meter, Status("plan", Level.OK, f"forecasts use the {basis.value}", {})]


def _meter_verdict(account: EnergyAccount, condition: Condition) -> tuple[Level, str]:
    if math.isnan(condition.age):
        return Level.WARN, "waiting for power/smoothed"
    if condition.age > MISSING_AFTER:
        return Level.WARN, NO_POWER
    if not account.measuring:
        return Level.WARN, "predicting: no power/measured"
    if condition.file_problem is not None:
        return Level.WARN, condition.file_problem
    reconciled = account.reconciled
    if reconciled is not None and reconciled.verdict is Verdict.CONTRADICTED:
        return Level.WARN, f"the last dropout: {Verdict.CONTRADICTED.value}"
    return Level.OK, "measuring"


def _dropout_values(reconciled: Reconciled | None) -> dict[str, object]:
    """Values of the last battery dropout: predicted energy, energy by charge, and correction."""
    if reconciled is None:
        return {}
    dropout = reconciled.dropout
    return {
        "silence": reconciled.verdict.value,
        "silence_s": rounded(dropout.duration),
        "silence_unknown_s": rounded(dropout.unknown_s),
        "silence_predicted_wh": _wh(dropout.bridge.energy),
        "silence_predicted_sigma_wh": _wh(dropout.sigma),
        "silence_by_charge_wh": _wh(reconciled.by_charge.value),
        "silence_by_charge_sigma_wh": _wh(reconciled.by_charge.sigma),
        "silence_correction_wh": _wh(reconciled.correction),
    }


def charge_status(account: EnergyAccount) -> Status:
    """Status of the battery's charge and of the distance to empty."""
    summary = account.summary()
    values = {
        "state_of_charge": rounded(summary.charge.value),
        "projected": summary.projected,
        "capacity_wh": _wh(summary.capacity.value),
        "capacity_sigma_wh": _wh(summary.capacity.sigma),
        "capacity_learned_from": account.gauge.learned,
        "state_of_health": rounded(account.gauge.health.value),
        "state_of_health_sigma": rounded(account.gauge.health.sigma),
        "usable_wh": _wh(summary.usable.value),
    }
    if summary.remaining is not None:
        distance, _, lower, upper = (metres / 1e3 for metres in summary.remaining)
        values |= {
            "distance_to_empty_km": rounded(distance),
            "band_km": f"{lower:.0f} to {upper:.0f}",
        }
    if not summary.charge.known:
        return Status("charge", Level.OK, "the state of charge is unknown", values)
    if summary.projected:
        text = "state of charge projected from the energy taken: not received for a minute"
        return Status("charge", Level.OK, text, values)
    return Status("charge", Level.OK, "state of charge received", values)


def _wh(joules: float) -> object:
    return rounded(joules / JOULES_PER_WH)


def plan_status(plans: PlanLog, basis: Basis, air: Air) -> Status:
    """Status of the planning, with the present basis and air; None in `air` is unknown."""
    outside = zip(("air_celsius", "air_pascal", "head_wind_mps"), air, strict=True)
    values = {
        "answered": plans.answered,
        "refused": plans.refused,
        "forecasts_from": basis.value,
        # Unknown values are taken from the vehicle file.
        **{name: "unknown" if value is None else rounded(value) for name, value in outside},
        "charge_after": rounded(plans.charge_after.value),
        "charge_after_sigma": rounded(plans.charge_after.sigma),
    }
    if plans.problem is not None:  # the planner has the reason; the car has no fault
        values["last_refusal"] = plans.problem
    if basis is Basis.VEHICLE_FILE:
        text = "forecasts use the vehicle file: no estimate/model or estimate/identifiable yet"
        return Status("plan", Level.OK, text, values)
    return Status("plan", Level.OK, "ready", values)


def answered_status(answer: PlanAnswer) -> Status:
    """Status of an answered plan: its energy, and its differences from other plans, J."""
    forecast = answer.forecast
    values = {"energy": forecast.energy[-1], "sigma": forecast.sigma[-1]}
    values["conditions"] = len(answer.conditions)  # the planner's; others are the last known
    values |= {f"assumed/{name}": value for name, value in answer.assumed.items()}
    if answer.charge.known:
        values |= {"battery": answer.charge.value, "battery_sigma": answer.charge.sigma}
    for name, apart in answer.differences.items():
        values |= {f"difference/{name}": apart.value, f"difference_sigma/{name}": apart.sigma}
    # The text of a numpy number would contain its type.
    texts = {key: repr(float(value)) for key, value in values.items()}
    return Status("plan", Level.OK, "answered", texts)
