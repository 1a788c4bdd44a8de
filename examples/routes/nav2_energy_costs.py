#!/usr/bin/env python3
"""Writes the energy of each edge into the GeoJSON graph of Nav2's route server, as its cost.

    python examples/routes/nav2_energy_costs.py graph.geojson energy.geojson --car bmw_i3

Nav2 then takes the route of least energy without a plugin: the costs cannot be overridden by its
edge scorers. A node is a point x, y, z in m, z upwards; an edge is driven at the `abs_speed_limit`
of its `metadata`, m/s, else at `--speed`. Nav2 refuses costs that are not above 0, and downhill
energy comes back, so an edge costs its energy plus the potential of its begin less that
of its end (Johnson 1977): between two nodes that adds the same to every route.
"""

import argparse
from collections.abc import Mapping, Sequence
import json
import math
from pathlib import Path
from typing import Any

import evpinn_ros as ev

KWH = 3.6e6  # J
LEAST = 1e-6  # kWh


def potentials(pairs: Sequence[tuple[int, int]], energies: Sequence[float]) -> dict[int, float]:
    """Potential of each node, J, with which no edge costs less than nothing (Bellman-Ford)."""
    least = {node: 0.0 for pair in pairs for node in pair}
    for _ in least:
        before = dict(least)
        for (begin, end), energy in zip(pairs, energies, strict=True):
            least[end] = min(least[end], least[begin] + energy)
        if least == before:
            return least
    raise SystemExit("a round trip of the graph gains energy: are its heights right?")


def with_costs(graph: Mapping[str, Any], car: str, speed: float) -> dict[str, Any]:
    """The graph, whose edges cost kWh at the speed, m/s, where they have none of their own."""
    points, edges = {}, []
    for feature in graph["features"]:
        if feature["geometry"]["type"] == "Point":
            x, y, *z = feature["geometry"]["coordinates"]
            points[feature["properties"]["id"]] = x, y, *(z or [0.0])
        else:
            edges.append(feature["properties"])
    pairs = [(edge["startid"], edge["endid"]) for edge in edges]
    speeds = [edge.get("metadata", {}).get("abs_speed_limit", speed) for edge in edges]
    table = {
        "length_m": [math.dist(points[begin], points[end]) for begin, end in pairs],
        "speed_kmh": [3.6 * value for value in speeds],
        "climb_m": [points[end][2] - points[begin][2] for begin, end in pairs],
    }
    energies = ev.edge_energies(table, car).table.energy_j.tolist()
    potential = potentials(pairs, energies)
    for edge, (begin, end), energy in zip(edges, pairs, energies, strict=True):
        cost = max(LEAST, (energy + potential[begin] - potential[end]) / KWH)
        edge.update(cost=cost, overridable=False)
    return dict(graph)


def main() -> None:
    """Read a graph and write it with costs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("graph", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--car", default="generic", help="a vehicle, or the file of one")
    parser.add_argument("--speed", type=float, default=8.0, help="m/s, where an edge has none")
    given = parser.parse_args()
    graph = with_costs(json.loads(given.graph.read_text()), given.car, given.speed)
    given.out.write_text(json.dumps(graph))


if __name__ == "__main__":
    main()
