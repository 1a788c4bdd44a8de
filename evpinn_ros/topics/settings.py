"""Settings of a core from the parameters of its node, without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from evpinn_ros.core.signals.road import GradeSource
from evpinn_ros.core.signals.stream import StreamSettings
from evpinn_ros.core.signals.time_jump import JumpPolicy, JumpRule
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.topics.node_parameters import roll_pitch_yaw
from evpinn_ros.topics.readings import Rotation, rotation

if TYPE_CHECKING:
    from evpinn_ros.core.estimation.estimator import EstimatorSettings


def estimator_settings(values: Mapping[str, Any]) -> EstimatorSettings:
    """Settings of the estimator from all parameters of its table, by name; already checked."""
    # Imported here: the node `energy` does not need it.
    from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, PaperOptimizer

    stream = StreamSettings(
        smoothing_lag=values["smoothing_lag"],
        allowed_lateness=values["allowed_lateness"],
        max_gap=values["max_gap"],
        grade_source=GradeSource(values["grade_source"]),
    )
    return EstimatorSettings(
        values["seed"],
        stream,
        mode=Mode(values["mode"]),
        regen_form=RegenForm(values["regen_form"]),
        optimizer=PaperOptimizer(values["paper_optimizer"]),
    )


def imu_mounting(values: Mapping[str, Any]) -> Rotation | None:
    """Mounting of the IMU from all parameters of the estimator; None if not given."""
    angles = roll_pitch_yaw(values["imu_rotation_rpy"])
    return None if angles is None else rotation(*angles)


def jump_rule(values: Mapping[str, Any]) -> JumpRule:
    """Rule for jumps of time from all parameters of a node."""
    return _jump_rule(values["time_jump_policy"], values["time_jump_threshold"])


@cache  # called for every message
def _jump_rule(policy: str, threshold: float) -> JumpRule:
    return JumpRule(JumpPolicy(policy), threshold)
