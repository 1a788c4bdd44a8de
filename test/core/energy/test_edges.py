"""Sums and differences of edges: what two routes share cancels, what is each edge's adds up."""

import numpy as np
import pytest

from evpinn_ros.core.energy.edges import Edges

EDGES = Edges(
    energy=np.array([100.0, 40.0, -10.0]),
    directions=np.array([[3.0], [4.0], [0.0]]),
    own=np.array([16.0, 9.0, 0.0]),
    uneven=np.array([0.0, 0.0, 2.0]),
)


def test_an_edge_has_what_is_its_own_and_what_all_share():
    assert EDGES.sigma == pytest.approx([5.0, 5.0, 2.0])


def test_a_route_adds_shared_errors_by_size_and_own_ones_by_square():
    found = EDGES.route([0, 1, 2])
    assert found.value == 130.0
    assert found.sigma == pytest.approx(np.sqrt((3.0 + 4.0) ** 2 + 16.0 + 9.0 + 2.0**2))


def test_what_two_routes_share_cancels():
    found = EDGES.difference([0, 1], [0, 2])
    assert found.value == 50.0
    assert found.sigma == pytest.approx(np.sqrt(4.0**2 + 9.0 + 2.0**2))
    assert EDGES.difference([0, 1], [1, 0]) == (0.0, 0.0)
