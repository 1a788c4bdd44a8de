"""Statuses of the estimator, without ROS."""

from __future__ import annotations

import math
import statistics

from evpinn_ros.core.estimation.estimate import Trust
from evpinn_ros.core.estimation.estimator import Activity, EstimatorStatus
from evpinn_ros.core.estimation.learner import LearnerReport
from evpinn_ros.core.signals.detector import BATTERY_STUCK, CURRENT_SIGN, GRADE_SIGN, SPEED_STUCK
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.diagnosis import MISSING_AFTER, Condition, Status, flat, rounded, with_health
from evpinn_ros.topics.messages import Level

WAITING, NO_SPEED = "waiting for vehicle/speed", "no vehicle/speed"
LEARNING = "learning"
OVERRUN_SHARE = 0.1  # of updates that may take longer than their second
STUCK = {
    SPEED_STUCK: "vehicle/speed is stuck at one value: nothing is learned",
    BATTERY_STUCK: "battery/state is stuck at one value: it is not used, nothing is learned",
}
LATE = "{} is stamped {:.1f} s later than {}: correct the stamps at their source"
RECENT = 60  # updates whose median duration is shown


def estimator_status(status: EstimatorStatus, condition: Condition) -> Status:
    """The health of the estimator from the status of its core."""
    recent = status.durations[-RECENT:]
    bands = {kind: rounded(share) for kind, share in status.band_coverage.items()}
    values = {
        "activity": status.activity.value,
        "updates": status.updates,
        "accepted": status.accepted,
        "update_ms": rounded(1000 * statistics.median(recent)) if recent else math.nan,
        "speed_age_s": rounded(condition.age),
        "time_jumps": condition.jumps,
        "inputs_without_data": ", ".join(status.unknown) or "nothing",
        **flat("rejected", status.rejected),
        **flat("dropped", status.dropped),
        **flat("gated", status.gated),
        **flat("progress", {name: round(p) for name, p in status.progress.items()}),
        **flat("state", {name: trust.value for name, trust in status.trust.items()}),
        **flat("seen", status.seen),
        **flat("in_90_band", bands),
        **_detections(status.report),
        **_lag(status),
    }
    level, text = _estimator_verdict(status, condition)
    if text.startswith(NO_SPEED):
        text = text.replace(NO_SPEED, f"{NO_SPEED} for {condition.age:.0f} s", 1)
    elif text == LEARNING:
        text += f": {status.accepted} of {status.updates} updates accepted"
    return with_health(Status("estimate", level, text, values), condition.health)


def estimator_phases(status: EstimatorStatus, condition: Condition) -> list[Status]:
    """Texts that are logged when they change, so they contain no counts."""
    learner = status.report
    valid = [name for name, trust in status.trust.items() if trust is Trust.VALID]
    phases = [Status("estimate", *_estimator_verdict(status, condition), {})]
    phases.append(Status("valid", Level.OK, f"valid: {', '.join(valid) or 'nothing yet'}", {}))
    if learner.payload_change is not None:
        change = learner.payload_change
        text = f"payload change of {change.delta_mass:+.0f} +- {change.std:.0f} kg"
        phases.append(Status("payload", Level.OK, text, {}))
    return phases


def _estimator_verdict(status: EstimatorStatus, condition: Condition) -> tuple[Level, str]:
    if status.activity is Activity.WAITING:
        return Level.WARN, f"{WAITING}: {condition.silent}"
    if condition.age > MISSING_AFTER:
        return Level.WARN, f"{NO_SPEED}: {condition.silent}"
    if condition.file_problem is not None:
        return Level.WARN, condition.file_problem
    if status.stuck is not None:
        return Level.WARN, STUCK[status.stuck]
    if status.report.suspicion == CURRENT_SIGN:
        return Level.WARN, "accelerating charges the battery: is the sign of current wrong?"
    if status.report.suspicion == GRADE_SIGN:
        return Level.WARN, "climbing gives power back: is the sign of grade or pitch wrong?"
    if status.lag is not None and status.lag.large:
        signals = ("vehicle/speed", "battery/state")
        late, early = signals if status.lag.seconds > 0.0 else reversed(signals)
        return Level.WARN, LATE.format(late, abs(status.lag.seconds), early)
    if status.activity is Activity.PREDICTING:
        return Level.WARN, "predicting from speed alone: battery/state is silent"
    if status.activity is Activity.PAUSED:
        return Level.OK, "predicting; learning is paused by ~/enable"
    if status.rejected.get("overrun", 0) > OVERRUN_SHARE * max(status.updates, 10):
        return Level.WARN, "updates take longer than a second: this computer is too slow or busy"
    return Level.OK, LEARNING


def _detections(report: LearnerReport) -> dict[str, object]:
    """Detections in the car and its signals, as values."""
    values: dict[str, object] = {
        "suspicion": report.suspicion or "none",
    }
    if report.payload_change is not None:
        change = report.payload_change
        values["payload_change_stamp_s"] = change.stamp_ns / NANOSECONDS
        values["payload_change_kg"] = rounded(change.delta_mass)
        values["payload_change_std_kg"] = rounded(change.std)
    return values


def _lag(status: EstimatorStatus) -> dict[str, object]:
    """Lag of speed behind the battery, s, and how much of it is corrected."""
    if status.lag is None:
        return {"lag_s": "unknown"}
    values = {"lag_s": status.lag.seconds, "lag_std_s": status.lag.sigma}
    return {name: rounded(value) for name, value in (values | {"shift_s": status.shift}).items()}
