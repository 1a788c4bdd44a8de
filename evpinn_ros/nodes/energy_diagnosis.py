"""Status of the energy node, decided without ROS."""

from __future__ import annotations

from dataclasses import dataclass
import math

from evpinn_ros.energy.account import AccountSummary
from evpinn_ros.energy.charge import Uncertain
from evpinn_ros.energy.meter import EnergyState
from evpinn_ros.energy.reconciliation import Reconciled, Verdict
from evpinn_ros.nodes.diagnosis import MISSING_AFTER, Health, Status, rounded, with_health
from evpinn_ros.nodes.forecaster import Air, Basis, PlanAnswer
from evpinn_ros.topics.messages import Level

ANSWERED = "answered"
NO_POWER = "no power/smoothed"
JOULES_PER_WH = 3600.0


@dataclass(frozen=True, slots=True)
class EnergyReport:
    """Basis of the energy node's diagnosis.

    Attributes:
        state: of the meter, corrected where a dropout was reconciled.
        account: totals, consumption, state of charge, range.
        reconciled: the last battery dropout that ended, None before.
        learned_capacity: how many changes of the state of charge the capacity rests on.
        file_problem: why the energy file was not used or not written, None if all is well.
        health: of the node.
        power_age: s since the last power/smoothed, NaN before the first.
        jumps: times that time went back.
        basis: what forecasts rest on.
        air: of the surroundings, that forecasts take.
        charge_after: state of charge, 0..1, at the end of the last plan.
        answered: plans answered.
        refused: plans refused.
        plan_problem: why the last plan was refused, None when it was answered.
    """

    state: EnergyState
    account: AccountSummary
    reconciled: Reconciled | None
    learned_capacity: int
    file_problem: str | None
    health: Health
    power_age: float
    jumps: int
    basis: Basis
    air: Air
    charge_after: Uncertain
    answered: int
    refused: int
    plan_problem: str | None


def meter_status(report: EnergyReport) -> Status:
    """The health of the energy meter."""
    state = report.state
    values = {
        "consumed_wh": _wh(state.consumed),
        "consumed_sigma_wh": _wh(state.consumed_sigma),
        "lifetime_wh": _wh(report.account.lifetime.net.value),
        "lifetime_km": rounded(report.account.lifetime.distance / 1e3),
        "measuring": state.measuring,
        "unmeasured_s": rounded(state.unmeasured_s),
        "unknown_s": rounded(state.unknown_s),
        "gaps": state.gaps,
        "dropped": state.dropped,
        "power_age_s": rounded(report.power_age),
        "time_jumps": report.jumps,
        **_dropout_values(report.reconciled),
    }
    if report.file_problem is not None:
        values["energy_file"] = report.file_problem
    level, text = _meter_verdict(report)
    if text == NO_POWER:
        text += f" for {report.power_age:.0f} s"
    return with_health(Status("meter", level, text, values), report.health)


def energy_phases(report: EnergyReport) -> list[Status]:
    """Text that is logged when it changes: nothing in it counts."""
    basis = f"forecasts rest on the {report.basis.value}"
    return [Status("meter", *_meter_verdict(report), {}), Status("plan", Level.OK, basis, {})]


def _meter_verdict(report: EnergyReport) -> tuple[Level, str]:
    if math.isnan(report.power_age):
        return Level.WARN, "waiting for power/smoothed"
    if report.power_age > MISSING_AFTER:
        return Level.WARN, NO_POWER
    if not report.state.measuring:
        return Level.WARN, "predicting: no power/measured"
    if report.file_problem is not None:
        return Level.WARN, report.file_problem
    if report.reconciled is not None and report.reconciled.verdict is Verdict.CONTRADICTED:
        return Level.WARN, f"the last dropout: {Verdict.CONTRADICTED.value}"
    return Level.OK, "measuring"


def _dropout_values(reconciled: Reconciled | None) -> dict[str, object]:
    """The last battery dropout: what was predicted, what is known, what became of it."""
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


def charge_status(report: EnergyReport) -> Status:
    """State of the battery's charge, and the distance it suffices for."""
    account = report.account
    values = {
        "state_of_charge": rounded(account.charge.value),
        "projected": account.projected,
        "capacity_wh": _wh(account.capacity.value),
        "capacity_sigma_wh": _wh(account.capacity.sigma),
        "capacity_learned_from": report.learned_capacity,
        "usable_wh": _wh(account.usable.value),
    }
    if account.remaining is not None:
        distance, _, lower, upper = (metres / 1e3 for metres in account.remaining)
        values |= {
            "distance_to_empty_km": rounded(distance),
            "band_km": f"{lower:.0f} to {upper:.0f}",
        }
    if not account.charge.known:
        return Status("charge", Level.OK, "the state of charge is unknown", values)
    if account.projected:
        text = "state of charge projected by the energy taken: none came for a minute"
        return Status("charge", Level.OK, text, values)
    return Status("charge", Level.OK, "state of charge received", values)


def _wh(joules: float) -> object:
    return rounded(joules / JOULES_PER_WH)


def plan_status(report: EnergyReport) -> Status:
    """Status of answering plans."""
    values = {
        "answered": report.answered,
        "refused": report.refused,
        "forecasts_from": report.basis.value,
        **_air_values(report.air),
        "charge_after": rounded(report.charge_after.value),
        "charge_after_sigma": rounded(report.charge_after.sigma),
    }
    if report.plan_problem is not None:
        return Status("plan", Level.WARN, f"plan refused: {report.plan_problem}", values)
    if report.basis is Basis.VEHICLE_FILE:
        text = "forecasts rest on the vehicle file: no estimate/model or estimate/identifiable yet"
        return Status("plan", Level.OK, text, values)
    return Status("plan", Level.OK, "ready", values)


def answered_status(answer: PlanAnswer) -> Status:
    """The status of a plan that is answered: its energy, and how it compares with others, J."""
    forecast = answer.forecast
    values: dict[str, object] = {
        "energy": repr(float(forecast.energy[-1])),
        "sigma": repr(float(forecast.sigma[-1])),
    }
    if answer.charge.known:
        values["battery"] = repr(answer.charge.value)
        values["battery_sigma"] = repr(answer.charge.sigma)
    for name, apart in answer.differences.items():
        values[f"difference/{name}"] = repr(apart.value)
        values[f"difference_sigma/{name}"] = repr(apart.sigma)
    return Status("plan", Level.OK, ANSWERED, values)


def _air_values(air: Air) -> dict[str, object]:
    """Air outside as forecasts take it; unknown values are those of the vehicle file."""
    named = zip(("air_celsius", "air_pascal", "head_wind_mps"), air, strict=True)
    return {name: "unknown" if value is None else rounded(value) for name, value in named}
