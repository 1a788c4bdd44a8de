"""A live view that has received everything."""

from collections.abc import Callable
from typing import Any

import pytest

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.nodes.live.data import LiveData
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import Level, diagnostics, named_vector
from evpinn_ros.topics.readings import battery_message, speed_message

VALUES = (0.912, 0.64, 1847.0, 0.0092, 0.2312, 412.0)
ESTIMATE = {
    "state.eta": "valid",
    "progress.eta": 87,
    "seen.0_30_kmh_braking": 12,
    "seen.over_120_kmh_steady": 3400,
    "in_90_band.predicted": 0.893,
}


PARTS = [  # J and 1-sigma
    ("air", 0.72e6, 0.108e6),
    ("tyres", 1.44e6, 0.18e6),
    ("slope", -0.108e6, 0.036e6),
    ("climate", 0.0, 0.0),
    ("drivetrain", 0.648e6, 0.072e6),
    ("unexplained", 0.018e6, 0.036e6),
    ("measured", 3.96e6, 0.0),
    ("regained", 0.9e6, 0.1e6),
]


def vector(stamp_ns: int, **values: float) -> Any:
    return named_vector(new_message, stamp_ns, list(values), list(values.values()))


def heard(now: float) -> list[tuple[Topic, Any]]:
    """All that a running system publishes in one moment."""
    stamp = int(now * NANOSECONDS)
    sigmas = [value / 20 for value in VALUES]
    bounds = {f"{name}_lower": 0.5 * v for name, v in zip(PARAMETER_NAMES, VALUES, strict=True)}
    bounds |= {f"{name}_upper": 2.0 * v for name, v in zip(PARAMETER_NAMES, VALUES, strict=True)}
    bounds |= {f"{name}_prior_share": 0.25 for name in PARAMETER_NAMES}
    said = [("/ev/estimator: estimate", Level.OK, "learning: 3 of 4 updates accepted", ESTIMATE)]
    return [
        (topics.SPEED, speed_message(new_message, SpeedReading(stamp, 12.5))),
        (topics.BATTERY, battery_message(new_message, BatteryReading(stamp, 352.0, -41.5))),
        (topics.PARAMETERS, named_vector(new_message, stamp, PARAMETER_NAMES, VALUES, sigmas)),
        (topics.BOUNDS, vector(stamp, **bounds)),
        (topics.POWER_MEASURED, vector(stamp, power=14600.0)),
        (topics.POWER_PREDICTED, named_vector(new_message, stamp, ["power"], [13900.0], [1200.0])),
        (topics.ENERGY_STATE, vector(stamp, predicted=3.6e6, consumed=3.96e6)),
        (topics.ENERGY_BREAKDOWN, named_vector(new_message, stamp, *zip(*PARTS, strict=True))),
        (topics.ENERGY_CONSUMPTION, vector(stamp, wh_per_km_trip=163.0)),
        (
            topics.ENERGY_RANGE,
            vector(
                stamp,
                distance_to_empty=2.45e5,
                distance_lower=2.1e5,
                distance_upper=2.9e5,
                state_of_charge=0.614,
            ),
        ),
        (topics.DIAGNOSTICS, diagnostics(new_message, stamp, said)),
    ]


@pytest.fixture
def well() -> Callable[[float], LiveData]:
    """A state that heard everything ten times a second from second 100 to this one."""

    def make(until: float) -> LiveData:
        data = LiveData()
        for tenth in range(1000, int(10 * until) + 1):
            for topic, message in heard(tenth / 10):
                data.take(topic, message, tenth / 10)
        return data

    return make
