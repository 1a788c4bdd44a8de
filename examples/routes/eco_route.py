"""Finds the route of least energy over a ridge, and compares it with SUMO's model of the car.

A grid of roads has a fast road over a ridge of 400 m, and a pass beside it. `ev.edge_energies`
gives the energy of every road, and the Bellman-Ford algorithm the route of least energy (a road
downhill may return energy). The sigma of the difference shows how certain it is to take less than
the fastest. If SUMO is installed (`pip install eclipse-sumo libsumo`), it drives both routes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import importlib.util
from itertools import pairwise
import math
from pathlib import Path
import subprocess
import tempfile
from typing import NamedTuple

import pandas as pd

import evpinn_ros as ev

SIDE, SPACING = 16, 400.0  # crossings a side, m between them
RIDGE, PASS = 400.0, 10  # m; row of the pass through it
CROSSROADS = 5  # every fifth column has roads between north and south
FAST_ROW, FAST, SLOW = 8, 70.0, 50.0  # row of the fast road, km/h there and elsewhere
VEHICLE, SUMO_VEHICLE = "bmw_i3", "BMW_i3.xml"  # SUMO's of doi 10.1109/ITSC48978.2021.9564463
KWH = 3.6e6  # J

Crossing = tuple[int, int]
Road = tuple[Crossing, Crossing]


class Way(NamedTuple):
    """A route."""

    roads: list[Road]  # in order
    minutes: float
    energy: float  # kWh
    sigma: float  # of the energy, kWh


def height(x: float, y: float) -> float:
    """Height of a crossing, m: a ridge between west and east, and the pass."""
    ridge = math.exp(-(((x - (SIDE - 1) / 2) / 4.5) ** 2))
    return RIDGE * ridge * (1.0 - math.exp(-((y - PASS) ** 2)))


def roads() -> pd.DataFrame:
    """A grid, its roads both ways: length, speed and climb, by the crossings at their ends."""
    crossings = [(x, y) for x in range(SIDE) for y in range(SIDE)]
    ends = [(a, b) for a in crossings for b in crossings if math.dist(a, b) == 1.0]
    ends = [(a, b) for a, b in ends if a[0] != b[0] or a[0] % CROSSROADS == 0]
    columns = {
        "length_m": SPACING,
        "speed_kmh": [FAST if a[1] == b[1] == FAST_ROW else SLOW for a, b in ends],
        "climb_m": [height(*b) - height(*a) for a, b in ends],
    }
    return pd.DataFrame(columns, index=pd.MultiIndex.from_tuples(ends))


def ways(edges: pd.DataFrame) -> tuple[Way, Way, ev.EdgeEnergies]:
    """The fastest and the cheapest way from west to east, and the energies of all roads."""
    energies = ev.edge_energies(edges, VEHICLE, temperature_c=20.0)
    seconds = (3.6 * edges.length_m / edges.speed_kmh).to_dict()
    ends = (0, FAST_ROW), (SIDE - 1, FAST_ROW)

    def way(costs: Mapping[Road, float]) -> Way:
        roads = least(costs, *ends)
        energy, sigma = energies.route(roads)
        return Way(roads, sum(map(seconds.get, roads)) / 60.0, energy / KWH, sigma / KWH)

    return way(seconds), way(energies.table.energy_j.to_dict()), energies


def least(costs: Mapping[Road, float], start: Crossing, goal: Crossing) -> list[Road]:
    """Roads of the route of least cost, by Bellman-Ford: costs may be negative."""
    best, last = {start: 0.0}, dict[Crossing, Crossing]()
    changed = True
    while changed:  # ends, because no round trip gains energy
        changed = False
        for (a, b), cost in costs.items():
            if a in best and best[a] + cost < best.get(b, math.inf) - 1e-6:
                best[b], last[b], changed = best[a] + cost, a, True
    way = [goal]
    while way[-1] != start:
        way.append(last[way[-1]])
    return list(pairwise(reversed(way)))


def sumo_energies(edges: pd.DataFrame, driven: Sequence[Way]) -> list[float]:
    """Energy of ways by SUMO's driver and electric model, kWh."""
    with tempfile.TemporaryDirectory() as folder:
        _write_network(Path(folder), edges)
        return [_drive(Path(folder), way.roads) for way in driven]


def _name(road: Road) -> str:
    return "_".join(str(number) for crossing in road for number in crossing)


def _write_network(folder: Path, edges: pd.DataFrame) -> None:
    import sumo

    crossings = sorted({end for road in edges.index for end in road})
    nodes = (
        f'<node id="{x}_{y}" x="{x * SPACING}" y="{y * SPACING}" z="{height(x, y):.3f}"/>'
        for x, y in crossings
    )
    rows = (
        f'<edge id="{_name((a, b))}" from="{a[0]}_{a[1]}" to="{b[0]}_{b[1]}" '
        f'speed="{speed / 3.6:.3f}"/>'
        for (a, b), speed in edges.speed_kmh.items()
    )
    (folder / "nodes.xml").write_text(f"<nodes>{''.join(nodes)}</nodes>")
    (folder / "edges.xml").write_text(f"<edges>{''.join(rows)}</edges>")
    tool = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
    files = "-n", "nodes.xml", "-e", "edges.xml", "-o", "net.xml"
    subprocess.run([tool, *files], cwd=folder, check=True, capture_output=True)


def _drive(folder: Path, roads: Sequence[Road]) -> float:
    """Energy of a single car on the roads, kWh."""
    import libsumo
    import sumo

    kind = Path(sumo.SUMO_HOME) / "data" / "emissions" / "MMPEVEM" / SUMO_VEHICLE
    vehicle = kind.read_text().partition("<vType ")[2].partition("</vType>")[0]
    name = vehicle.partition('id="')[2].partition('"')[0]
    (folder / "routes.xml").write_text(
        f"<routes><vType {vehicle}</vType>"
        f'<vehicle id="car" type="{name}" depart="0">'
        f'<route edges="{" ".join(map(_name, roads))}"/></vehicle></routes>'
    )
    files = "-n", str(folder / "net.xml"), "-r", str(folder / "routes.xml")
    libsumo.start(["sumo", *files, "--step-length", "0.1", "--no-step-log", "--no-warnings"])
    energy = 0.0
    try:
        while libsumo.simulation.getMinExpectedNumber():
            libsumo.simulationStep()
            if "car" in libsumo.vehicle.getIDList():
                power = libsumo.vehicle.getElectricityConsumption("car")  # Wh/s
                energy += 0.1 * power / 1e3 if math.isfinite(power) else 0.0
    finally:
        libsumo.close()
    return energy


def main() -> None:
    """Print both routes, and their energies by SUMO."""
    edges = roads()
    fastest, cheapest, energies = ways(edges)
    for name, way in (("fastest", fastest), ("cheapest", cheapest)):
        length = f"{len(way.roads) * SPACING / 1e3:5.1f} km {way.minutes:5.1f} min"
        print(f"{name:9}{length} {way.energy:6.3f} +- {way.sigma:.3f} kWh")
    more, sigma = energies.difference(fastest.roads, cheapest.roads)
    print(f"The fastest takes {more / KWH:.3f} +- {sigma / KWH:.3f} kWh more.")
    if all(importlib.util.find_spec(name) for name in ("sumo", "libsumo")):
        driven = sumo_energies(edges, (fastest, cheapest))
        print(f"By SUMO's model of a BMW i3: {driven[0]:.3f} and {driven[1]:.3f} kWh.")


if __name__ == "__main__":
    main()
