#!/usr/bin/env python3
"""Writes the energy of each edge into the GeoJSON graph of Nav2's route server, as its penalty.

    python examples/routes/nav2_energy_costs.py graph.geojson energy.geojson --car bmw_i3

With `edge_cost_functions: [DynamicEdgesScorer, PenaltyScorer]`, Nav2 takes the route of least
energy that is not closed. A node is a point x, y, z in m, z upwards; an edge is driven at the
`abs_speed_limit` of its `metadata`, m/s, else at `--speed`. Nav2's search needs costs >= 0, but
downhill energy may be negative. So an edge costs its energy plus the potential of its start minus
that of its end (Johnson 1977), which adds the same to every route between two nodes.
"""

import argparse
from collections.abc import Mapping, Sequence
import json
import math
from pathlib import Path
from typing import Any

import evpinn_ros as ev

KWH = 3.6e6  # J


def potentials(pairs: Sequence[tuple[int, int]], energies: Sequence[float]) -> dict[int, float]:
    """Potential of each node, J, with which no edge has a negative cost (Bellman-Ford)."""
    least = {node: 0.0 for pair in pairs for node in pair}
    for _ in least:
        before = dict(least)
        for (begin, end), energy in zip(pairs, energies, strict=True):
            least[end] = min(least[end], least[begin] + energy)
        if least == before:
            return least
    raise SystemExit("a round trip of the graph gains energy: are its heights right?")


def with_penalties(graph: Mapping[str, Any], car: str, speed: float) -> dict[str, Any]:
    """The graph, with kWh as penalties; edges without a speed limit are driven at `speed`, m/s."""
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
        penalty = max(0.0, (energy + potential[begin] - potential[end]) / KWH)
        edge["metadata"] = edge.get("metadata", {}) | {"penalty": penalty}
        edge.pop("overridable", None)  # false would keep scorers from changing the cost
    return dict(graph)


def main() -> None:
    """Read a graph and write it with penalties."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("graph", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--car", default="generic", help="name of a vehicle, or vehicle file")
    parser.add_argument("--speed", type=float, default=8.0, help="m/s, of edges without a limit")
    given = parser.parse_args()
    graph = with_penalties(json.loads(given.graph.read_text()), given.car, given.speed)
    given.out.write_text(json.dumps(graph))


if __name__ == "__main__":
    main()
