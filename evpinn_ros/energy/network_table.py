"""The network of a car over many steps: in blocks, or looked up in a table.

A plan of many points takes its units block by block, exactly. Many trips at once spread their
steps over a grid of speed and force between whose nodes the network is taken as linear.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from evpinn_ros.common.arrays import as_numpy, like, namespace, sums_at, whole, zeros
from evpinn_ros.estimation.network import FORCE_SCALE, SPEED_CENTRE, SPEED_SCALE, Network
from evpinn_ros.estimation.terms import Wheels

BLOCK = 1024  # steps of which the units of the network are computed together, in the cache
# Nodes of the table, m/s and m/s^2.
GRID_SPEED, GRID_FORCE = np.arange(0.0, 101.0, 1.0), np.linspace(-4.0, 4.0, 33)


def table_of(network: Network) -> np.ndarray:
    """Force of the network on the grid, N per weight, shape (speeds, forces, NETWORK)."""
    speed, force = np.meshgrid(GRID_SPEED, GRID_FORCE, indexing="ij")
    found = network.force(speed.ravel(), force.ravel())
    return np.asarray(found.reshape(*speed.shape, -1))


def units_of(network: Network, wheels: Wheels) -> Iterator[tuple[slice, np.ndarray]]:
    """Units of the network in n steps, a block at a time: which steps, and shape (UNITS, block).

    As `Network.force` has them, by 1 - 2 / (exp(2 x) + 1), half the time of tanh: |x| < 100.
    """
    scale = np.array([SPEED_SCALE, FORCE_SCALE])
    slopes = 2.0 * network.inner / scale
    weights = np.column_stack((slopes, 2.0 * network.bias - SPEED_CENTRE * slopes[:, 0]))
    speed = wheels.speed.ravel()
    inputs = np.stack((speed, wheels.force.ravel(), np.ones_like(speed)))
    for begin in range(0, speed.size, BLOCK):
        part = slice(begin, begin + BLOCK)
        found = weights @ inputs[:, part]
        np.exp(found, out=found)
        found += 1.0
        np.divide(-2.0, found, out=found)
        found += 1.0
        yield part, found


def nodes_of(wheels: Wheels, way: Any) -> tuple[Any, list[tuple[int, Any]]]:
    """Numbers of the lower nodes of the grid below steps; shifts of all four, and m to each."""
    xp, forces = namespace(way), len(GRID_FORCE)
    x = xp.clip(wheels.speed * (1.0 / GRID_SPEED[1]), None, len(GRID_SPEED) - 1.001)
    y = (wheels.force - GRID_FORCE[0]) * (1.0 / (GRID_FORCE[1] - GRID_FORCE[0]))
    i, j = whole(x), whole(xp.clip(y, None, forces - 1.001))
    above, y = (x - i) * way, y - j
    below = way - above
    stronger, faster = below * y, above * y
    shares = [(0, below - stronger), (1, stronger), (forces, above - faster), (forces + 1, faster)]
    return i * forces + j, shares


def looked_up(wheels: Wheels, distance: Any, table: np.ndarray) -> Any:
    """Energy of the network before its share of the terms is taken away, (batch, NETWORK).

    Steps are spread over the four nodes around them by weights, so a trip is one row of weights.
    """
    batch, last = len(distance), len(GRID_FORCE) + 1
    node, shares = nodes_of(wheels, abs(distance))
    most = (int(node.max()) // len(GRID_FORCE) + 2) * len(GRID_FORCE)
    cell = (most * like(np.arange(batch), node)[:, None] + node).ravel()
    weights = zeros((batch * most,), distance)
    for shift, share in shares:
        weights[shift:] += sums_at(cell, share.ravel(), len(weights))[: len(weights) - shift]
    # A tenth of the nodes: at a speed there are few forces.
    below = np.flatnonzero(np.bincount(as_numpy(node).ravel(), minlength=most - last))
    used = np.unique(np.concatenate([below + shift for shift, _ in shares]))
    table = like(table.reshape(-1, table.shape[2])[used], distance)
    return weights.reshape(batch, -1)[:, used] @ table
