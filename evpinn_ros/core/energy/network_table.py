"""The network of a car over many steps: in blocks, or looked up in a table.

A plan of many points takes its units block by block, exactly. Many trips at once spread their
steps over a grid of speed and force between whose nodes the network is taken as linear.
"""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.arrays import like, namespace, sums_at, whole, within, zeros
from evpinn_ros.core.estimation.network import FORCE_SCALE, SPEED_CENTRE, SPEED_SCALE, Network
from evpinn_ros.core.estimation.terms import Wheels

BLOCK = 1024  # steps whose units are computed together, which fit into the cache
# Nodes of the table, m/s and m/s^2.
GRID_SPEED, GRID_FORCE = np.arange(0.0, 101.0, 1.0), np.linspace(-4.0, 4.0, 33)
SPEEDS, FORCES = len(GRID_SPEED), len(GRID_FORCE)
SPEED_STEP, FORCE_STEP = float(GRID_SPEED[1]), float(GRID_FORCE[1] - GRID_FORCE[0])


def table_of(network: Network) -> np.ndarray:
    """Force of the network on the grid, N per weight, shape (speeds, forces, NETWORK)."""
    speed, force = np.meshgrid(GRID_SPEED, GRID_FORCE, indexing="ij")
    forces = network.force(speed.ravel(), force.ravel())
    return np.asarray(forces.reshape(*speed.shape, -1))


def units_of(network: Network, wheels: Wheels) -> Iterator[tuple[slice, np.ndarray]]:
    """Yields (slice of the n steps, units of the network there, shape (UNITS, block)).

    As in `Network.force`, but in single precision, which takes a third of the time: the error of a
    unit is 1e-6 at most, that of the network's energy about 1e-7 of it.
    """
    slopes = network.inner / (SPEED_SCALE, FORCE_SCALE)
    weights = np.column_stack((slopes, network.bias - SPEED_CENTRE * slopes[:, 0]))
    speed = wheels.speed.ravel()
    inputs = np.stack((speed, wheels.force.ravel(), np.ones_like(speed))).astype(np.float32)
    weights = weights.astype(np.float32)
    for begin in range(0, speed.size, BLOCK):
        part = slice(begin, begin + BLOCK)
        yield part, np.tanh(weights @ inputs[:, part]).astype(float)


class Places(NamedTuple):
    """Places of steps on the grid; arrays of any shape, numpy or torch.

    Attributes:
        speed: number of the node of speed below, a float.
        force: number of the node of force below, a float.
        faster: share of the way from there to the next node of speed, 0..1.
        stronger: share of the way to the next node of force, 0..1.
    """

    speed: Any
    force: Any
    faster: Any
    stronger: Any

    def shares(self, way: Any) -> Iterator[tuple[int, int, Any]]:
        """Yields (shift of speed, shift of force, metres of each step) for the four nodes."""
        faster, stronger = way * self.faster, way * self.stronger
        both = faster * self.stronger
        yield 0, 0, way - stronger - faster + both
        yield 0, 1, stronger - both
        yield 1, 0, faster - both
        yield 1, 1, both


def places_of(wheels: Wheels) -> Places:
    """Places of steps on the grid, clipped to its ends."""
    floor = namespace(wheels.speed).floor
    speed, force = wheels.speed, wheels.force - float(GRID_FORCE[0])
    x, y = (
        within(values * (1.0 / step), -math.inf, count - 1.001)
        for values, step, count in ((speed, SPEED_STEP, SPEEDS), (force, FORCE_STEP, FORCES))
    )
    below_x, below_y = floor(x), floor(y)
    return Places(below_x, below_y, x - below_x, y - below_y)


def looked_up(wheels: Wheels, distance: Any, table: np.ndarray) -> Any:
    """Energy of the network before the share of the terms is subtracted, (batch, NETWORK).

    Each step is spread over the four nodes around it, so a trip is one row of weights, over the
    part of the grid where any trip drives.
    """
    batch, places = len(distance), places_of(wheels)
    (i, slow), (j, weak) = ((axis, int(axis.min())) for axis in places[:2])
    speeds, forces = (int(axis.max()) - low + 2 for axis, low in ((i, slow), (j, weak)))
    first = speeds * forces * np.arange(batch) - (slow * forces + weak)
    node = whole(i * forces + j + like(first.astype(float), i)[:, None]).ravel()
    count = batch * speeds * forces
    weights = zeros((count,), distance)
    for faster, stronger, share in places.shares(abs(distance)):
        shift = faster * forces + stronger
        weights[shift:] += sums_at(node, share.ravel(), count - shift)
    table = table[slow : slow + speeds, weak : weak + forces]
    return weights.reshape(batch, -1) @ like(table.reshape(-1, table.shape[2]), distance)
