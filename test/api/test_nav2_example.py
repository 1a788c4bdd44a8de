"""The example for Nav2's route server: its penalties lead along the least energy."""

import heapq
import itertools
import json
import subprocess
import sys

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from test.conftest import ROOT, load_example

EXAMPLE = load_example("routes/nav2_energy_costs.py")
SIDE = 4  # nodes of a grid


def grid(heights, speeds):
    """A graph as Nav2 reads it, of streets in both directions."""
    nodes = list(itertools.product(range(SIDE), repeat=2))
    number = {node: index for index, node in enumerate(nodes)}
    points = [[100.0 * x, 100.0 * y, heights[number[x, y]]] for x, y in nodes]
    pairs = [
        (number[node], number[beside])
        for node in nodes
        for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1))
        if (beside := (node[0] + dx, node[1] + dy)) in number
    ]
    features = [
        {"type": "Feature", "properties": {"id": index, "frame": "map"},
         "geometry": {"type": "Point", "coordinates": point}}
        for index, point in enumerate(points)
    ] + [
        {"type": "Feature",
         "properties": {"id": 1000 + index, "startid": begin, "endid": end, "overridable": False,
                        "metadata": {"abs_speed_limit": speeds[index % len(speeds)]}},
         "geometry": {"type": "MultiLineString", "coordinates": [[points[begin], points[end]]]}}
        for index, (begin, end) in enumerate(pairs)
    ]  # fmt: skip
    return {"type": "FeatureCollection", "features": features}


def edges_of(graph):
    shapes = (
        (feature["geometry"]["type"], feature["properties"]) for feature in graph["features"]
    )
    return [properties for shape, properties in shapes if shape != "Point"]


def dijkstra(edges, start, end, shut=()):
    """Nav2's search, with its scorers of penalties and of closed edges: the cheapest route."""
    queue, closed, order = [(0.0, 0, start, [])], set(), itertools.count(1)
    while queue:
        cost, _, node, route = heapq.heappop(queue)
        if node == end:
            return route
        if node not in closed:
            closed.add(node)
            for edge in (edge for edge in edges if edge["startid"] == node):
                if edge["id"] not in shut:
                    dearer = cost + edge["metadata"]["penalty"]
                    heapq.heappush(queue, (dearer, next(order), edge["endid"], [*route, edge]))
    raise AssertionError("no route")


@settings(max_examples=15, deadline=None)
@given(
    heights=st.lists(st.floats(0.0, 8.0), min_size=SIDE**2, max_size=SIDE**2),
    speeds=st.lists(st.floats(4.0, 14.0), min_size=1, max_size=7),
)
def test_no_route_takes_less_than_the_one_that_costs_least(heights, speeds):
    graph = EXAMPLE.with_penalties(grid(heights, speeds), "bmw_i3", 8.0)
    edges = edges_of(graph)
    assert all(edge["metadata"]["penalty"] >= 0.0 and "overridable" not in edge for edge in edges)
    table = {"length_m": [], "speed_kmh": [], "climb_m": []}
    points = [feature["geometry"]["coordinates"] for feature in graph["features"][: SIDE**2]]
    for edge in edges:
        begin, end = points[edge["startid"]], points[edge["endid"]]
        table["length_m"].append(EXAMPLE.math.dist(begin, end))
        table["speed_kmh"].append(3.6 * edge["metadata"]["abs_speed_limit"])
        table["climb_m"].append(end[2] - begin[2])
    energies = EXAMPLE.ev.edge_energies(table, "bmw_i3").table.energy_j.tolist()
    energy = {edge["id"]: value for edge, value in zip(edges, energies, strict=True)}
    least = {node: float("inf") for node in range(SIDE**2)} | {0: 0.0}
    for _ in least:
        for edge in edges:
            reached = least[edge["startid"]] + energy[edge["id"]]
            least[edge["endid"]] = min(least[edge["endid"]], reached)
    route = dijkstra(edges, 0, SIDE**2 - 1)
    taken = sum(energy[edge["id"]] for edge in route)
    assert taken == pytest.approx(least[SIDE**2 - 1], rel=1e-9, abs=1e-3)


def test_the_command_writes_a_graph(tmp_path):
    graph, out = tmp_path / "graph.geojson", tmp_path / "energy.geojson"
    hill = [20.0 * (node == 5) for node in range(SIDE**2)]
    graph.write_text(json.dumps(grid(hill, [8.0])))
    command = [sys.executable, EXAMPLE.__file__, graph, out, "--car", "bmw_i3"]
    subprocess.run([*map(str, command)], check=True, cwd=ROOT)
    text = out.read_text()
    assert '"penalty": 0,' not in text  # Nav2 reads it as a number with a point
    edges = edges_of(json.loads(text))
    route = dijkstra(edges, 1, 9)
    assert 5 not in [edge["endid"] for edge in route], "over the hill is the shortest way"
    closed = dijkstra(edges, 1, 9, {route[1]["id"]})
    assert route[1] not in closed and closed[-1]["endid"] == 9
