"""What a node on a car's computer does not load."""

import pytest

HEAVY = ("torch", "polars", "pandas", "matplotlib", "scipy")


@pytest.mark.parametrize("node", ["estimator", "energy", "can_bridge"])
def test_no_default_node_loads_what_it_does_not_need(loads_without, node):
    bus = () if node == "can_bridge" else ("can", "cantools")
    loads_without(f"import evpinn_ros.nodes.{node}", *HEAVY, *bus)
