"""What a node on a car's computer does not load."""

import pytest

HEAVY = ("torch", "polars", "pandas", "matplotlib", "scipy")


@pytest.mark.parametrize("nodes", ["estimator, energy", "can_bridge"])
def test_no_default_node_loads_what_it_does_not_need(loads_without, nodes):
    bus = () if nodes == "can_bridge" else ("can", "cantools")
    loads_without(f"from evpinn_ros.nodes import {nodes}", *HEAVY, *bus)
