"""Every endpoint of every node is what the table of topics says."""

import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from evpinn_ros import topics
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import LISTENS_TO, EstimatorNode
from evpinn_ros.nodes.factory import installed
from evpinn_ros.topics import TOPICS

BUILT_IN = ("/rosout", "/parameter_events", "/clock")
LISTENS = {
    "can_bridge": set(),
    "estimator": set(LISTENS_TO),
    "energy": {
        *(topics.BATTERY, topics.SPEED, topics.ODOMETRY, topics.VELOCITY_REPORT),
        *(topics.POWER_MEASURED, topics.POWER_SMOOTHED, topics.IDENTIFIABLE, topics.MODEL),
        *(topics.PLAN, topics.SPEED_PROFILE, topics.TRAJECTORY, topics.CONDITIONS),
        *(topics.PRESSURE, topics.TEMPERATURE, topics.WIND),
    },
}
# No CAN profile knows an auxiliary load yet.
NOT_YET = {topics.AUXILIARY_POWER}


def described(qos):
    return (
        qos.reliability is ReliabilityPolicy.RELIABLE,
        qos.durability is DurabilityPolicy.TRANSIENT_LOCAL,
        qos.depth,
    )


def expected(qos):
    return qos.reliable, qos.transient_local, qos.depth


@pytest.mark.parametrize("make", [CanBridgeNode, EstimatorNode, EnergyNode])
def test_endpoints_follow_the_table(bench, make, tmp_path):
    log = tmp_path / "x.log"
    log.write_text("(1.0) can0 123#00\n")
    options = {"log_file": str(log)} if make is CanBridgeNode else {}
    node = bench.start(make, **options)
    name = node.get_name()
    publishers = {p.topic_name: described(p.qos_profile) for p in node.publishers}
    subscriptions = {s.topic_name: described(s.qos_profile) for s in node.subscriptions}
    own = [t for t in TOPICS if t.source in (name, "all") and t not in NOT_YET]
    assert {k: v for k, v in publishers.items() if k not in BUILT_IN} == {
        topic.under(): expected(topic.publisher_qos) for topic in own
    }
    assert {k: v for k, v in subscriptions.items() if k not in BUILT_IN} == {
        topic.under(): expected(topic.subscriber_qos) for topic in installed(LISTENS[name])
    }


def test_quality_of_service_can_be_overridden(bench):
    key = "qos_overrides./ev/vehicle/speed.subscription"
    node = bench.start(EstimatorNode, **{f"{key}.reliability": "reliable", f"{key}.depth": 50})
    speed = next(s for s in node.subscriptions if s.topic_name == "/ev/vehicle/speed")
    assert described(speed.qos_profile) == (True, False, 50)
    assert node.describe_parameter(f"{key}.depth")


def test_an_override_that_would_not_be_heard_is_refused(bench):
    key = "qos_overrides./ev/energy/state.publisher.lifespan"
    with pytest.raises(InputError, match="'lifespan' cannot be overridden; known are history"):
        bench.start(EnergyNode, **{key: 1})
    bench.start(EnergyNode, **{"qos_overrides./ev/camera.publisher.lifespan": 1})


def test_names_follow_the_namespace_and_remapping(bench):
    node = bench.start(EnergyNode)
    assert {p.topic_name for p in node.publishers} >= {"/ev/energy/state", "/diagnostics"}
    node = bench.start(lambda **options: EnergyNode(**{
        **options, "namespace": "/truck", "cli_args": ["--ros-args", "-r", "plan:=/route/plan"],
    }))  # fmt: skip
    names = {s.topic_name for s in node.subscriptions}
    assert "/route/plan" in names and "/truck/power/smoothed" in names
