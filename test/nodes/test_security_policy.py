"""The SROS 2 policies allow what the running nodes have, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.topics import NAMESPACE

POLICIES = Path(__file__).resolve().parents[2] / "config" / "security"
NODES = {
    "can_bridge": (CanBridgeNode, {"interface": "virtual", "channel": "policy", "bitrate": 0}),
    "estimator": (EstimatorNode, {}),
    "energy": (EnergyNode, {}),
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
    found = {kind: set() for kind in ATTRIBUTES}
    for rule in profile:
        assert (
            rule.attrib and {*rule.attrib} <= ATTRIBUTES and {*rule.attrib.values()} == {"ALLOW"}
        )
        for kind in rule.attrib:
            found[kind] |= {full_name(entry.text, name) for entry in rule}
    return found


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
    node = bench.start(make, use_sim_time=True, **parameters)

    def has(query):
        return {topic for topic, _ in query(name, NAMESPACE)}

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
    assert in_the_graph() == allowed(name)
