"""How the energy node is doing, decided without ROS."""

from __future__ import annotations

from dataclasses import dataclass
import math

from evpinn_ros.energy.meter import EnergyState
from evpinn_ros.nodes.diagnosis import SILENT_AFTER, Health, Status, rounded, with_health
from evpinn_ros.nodes.forecaster import Basis
from evpinn_ros.nodes.messages import Level

JOULES_PER_WH = 3600.0


@dataclass(frozen=True, slots=True)
class EnergyReport:
    """All that the diagnosis of the energy node rests on.

    Attributes:
        state: of the meter.
        health: of the node.
        power_age: s since the last power/smoothed, NaN before the first.
        jumps: times that time went back.
        state_of_charge: 0..1, NaN while unknown.
        basis: what forecasts rest on.
        answered: plans answered.
        refused: plans refused.
        plan_problem: why the last plan was refused, None when it was answered.
    """

    state: EnergyState
    health: Health
    power_age: float
    jumps: int
    state_of_charge: float
    basis: Basis
    answered: int
    refused: int
    plan_problem: str | None


def meter_status(report: EnergyReport) -> Status:
    """The health of the energy meter."""
    state = report.state
    values = {
        "consumed_wh": rounded(state.consumed / JOULES_PER_WH),
        "measuring": state.measuring,
        "unmeasured_s": rounded(state.unmeasured_s),
        "gaps": state.gaps,
        "dropped": state.dropped,
        "power_age_s": rounded(report.power_age),
        "time_jumps": report.jumps,
    }
    if math.isnan(report.power_age):
        verdict = Level.WARN, "waiting for power/smoothed"
    elif report.power_age > SILENT_AFTER:
        verdict = Level.WARN, f"no power/smoothed for {report.power_age:.0f} s"
    elif not state.measuring:
        verdict = Level.WARN, "predicting: no power/measured"
    else:
        verdict = Level.OK, "measuring"
    return with_health(Status("meter", *verdict, values), report.health)


def plan_status(report: EnergyReport) -> Status:
    """How plans are answered."""
    values = {
        "answered": report.answered,
        "refused": report.refused,
        "state_of_charge": rounded(report.state_of_charge),
        "forecasts_from": report.basis.value,
    }
    if report.plan_problem is not None:
        return Status("plan", Level.WARN, f"plan refused: {report.plan_problem}", values)
    if report.basis is Basis.VEHICLE_FILE:
        text = "forecasts rest on the vehicle file: no estimate/model or estimate/identifiable yet"
        return Status("plan", Level.OK, text, values)
    return Status("plan", Level.OK, "ready", values)
