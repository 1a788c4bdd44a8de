"""The SROS 2 policies allow what the running nodes have, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from evpinn_ros import topics
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.typed import TYPED, TYPED_FORECAST
from evpinn_ros.topics import NAMESPACE

POLICIES = Path(__file__).resolve().parents[2] / "config" / "security"
NODES = {
    "can_bridge": (CanBridgeNode, {"interface": "virtual", "channel": "policy", "bitrate": 0}),
    "estimator": (EstimatorNode, {}),
    "energy": (EnergyNode, {}),
}
# Of what is in the graph only where the messages are installed (`typed_check.py` has them all).
OPTIONAL = {
    "estimator": {"vehicle/status/velocity_status"},
    "energy": {"vehicle/status/velocity_status", "plan/trajectory", "energy/estimate_plan"},
}
ATTRIBUTES = {"publish", "subscribe", "reply", "request", "call", "execute"}


def allowed(name):
    """The full names of what a policy allows, by kind, as sros2 expands them."""
    root = ElementTree.parse(POLICIES / f"{name}.policy.xml").getroot()
    assert (root.tag, root.get("version")) == ("policy", "0.2.0")
    (enclave,) = root.findall("enclaves/enclave")
    assert enclave.get("path") == f"{NAMESPACE}/{name}"
    (profile,) = enclave.findall("profiles/profile")
    assert (profile.get("ns"), profile.get("node")) == (NAMESPACE, name)
    names: dict[str, set[str]] = {kind: set() for kind in ATTRIBUTES}
    for rule in profile:
        assert (
            rule.attrib and {*rule.attrib} <= ATTRIBUTES and {*rule.attrib.values()} == {"ALLOW"}
        )
        for kind in rule.attrib:
            names[kind] |= {full_name(entry.text, name) for entry in rule}
    return names


def without_messages(name):
    """Topics of the nodes where no messages of other packages are installed."""
    beside = {f"{NAMESPACE}/{topic}" for topic in OPTIONAL.get(name, ())}
    typed = f"{NAMESPACE}/{topics.TYPED}/"
    by_kind = {
        kind: {topic for topic in names - beside if not topic.startswith(typed)}
        for kind, names in allowed(name).items()
    }
    return {**by_kind, "execute": set()}


def full_name(text, node):
    assert "*" not in text
    if text.startswith("/"):
        return text
    return f"{NAMESPACE}/{node}{text[1:]}" if text.startswith("~") else f"{NAMESPACE}/{text}"


def test_every_node_has_its_policy():
    assert {path.name for path in POLICIES.iterdir()} == {f"{name}.policy.xml" for name in NODES}


@pytest.mark.parametrize("name", NODES)
def test_a_policy_allows_what_the_node_has_and_nothing_else(bench, name):
    make, parameters = NODES[name]
    # DDS may show a node of this name that another test has ended: none is in this namespace.
    space = f"/policy_of_{name}"
    node = bench.start(make, space, use_sim_time=True, **parameters)

    def has(query):
        return {topic.replace(space, NAMESPACE, 1) for topic, _ in query(name, space)}

    def in_the_graph():
        return {
            "publish": has(node.get_publisher_names_and_types_by_node),
            "subscribe": has(node.get_subscriber_names_and_types_by_node),
            "reply": has(node.get_service_names_and_types_by_node),
            "request": has(node.get_client_names_and_types_by_node),
            "call": set(),
            "execute": set(),
        }

    bench.pump(lambda: "/clock" in in_the_graph()["subscribe"])
    assert in_the_graph() == without_messages(name)


def test_the_typed_interface_and_the_messages_of_others_are_allowed():
    node, energy = allowed("estimator"), allowed("energy")
    typed = {f"{NAMESPACE}/{entry.name}" for entry in (*TYPED.values(), TYPED_FORECAST)}
    published = node["publish"] | energy["publish"]
    assert {topic for topic in published if f"/{topics.TYPED}/" in topic} == typed
    for topic in (topics.VELOCITY_REPORT, topics.TRAJECTORY):
        assert f"{NAMESPACE}/{topic.name}" in energy["subscribe"]
    assert f"{NAMESPACE}/{topics.VELOCITY_REPORT.name}" in node["subscribe"]
    assert f"{NAMESPACE}/energy/estimate_plan" in energy["reply"]
    assert energy["execute"] == {f"{NAMESPACE}/energy/estimate_plans"}
