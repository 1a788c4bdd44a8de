"""Energy of the edges of a road network from Python."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evpinn_ros.api.plan import KnownCar, basis_of, columns_of, known_car
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.optional import pandas
from evpinn_ros.core.energy import edges as energy_edges
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.plan import PlanConditions
from evpinn_ros.core.vehicle.files import Vehicle

if TYPE_CHECKING:
    import pandas as pd


class EdgeEnergies:
    """Energies of the edges of a road network, and of routes over them.

    Attributes:
        table: one row for each edge, with the index of the edges that were given: `energy_j`, J,
            negative where the edge returns energy, and its 1-sigma `sigma_j`, J.
    """

    def __init__(self, index: pd.Index, edges: energy_edges.Edges) -> None:
        self.table = pandas().DataFrame({"energy_j": edges.energy, "sigma_j": edges.sigma}, index)
        self._edges = edges

    def route(self, edges: Iterable[Hashable]) -> Uncertain:
        """Energy of a route, J, and its 1-sigma: the `forecast` of its edges as a trip.

        It is more than the sum of the table by the start from standing, cold if the car is, the
        stop at the end, and changes of speed and slope between the edges.

        Args:
            edges: labels of the edges in the index, in the order in which they are driven.

        Raises:
            InputError: there is no such edge, or they are no trip (`PlanError`).
        """
        return self._edges.route(self._places(edges))

    def difference(self, route: Iterable[Hashable], other: Iterable[Hashable]) -> Uncertain:
        """Energy of one route minus that of another, J, and its 1-sigma without shared errors.

        Raises:
            InputError: there is no such edge.
        """
        return self._edges.difference(self._places(route), self._places(other))

    def _places(self, edges: Iterable[Hashable]) -> np.ndarray:
        labels = [*edges]
        places = self.table.index.get_indexer_for(pandas().Index(labels, tupleize_cols=True))
        if len(places) != len(labels) or (places < 0).any():
            raise InputError("a route has an edge that is not in the table, or is in it twice")
        return np.asarray(places)


def edge_energies(
    edges: pd.DataFrame | Mapping[str, Any],
    car: str | Path | Vehicle | KnownCar = "generic",
    *,
    temperature_c: float | None = None,
    heating_w: float | None = None,
    head_wind: float = 0.0,
    payload_kg: float | None = None,
    air_density: float | None = None,
) -> EdgeEnergies:
    """Energies of all edges of a road network at once, for a router.

    Each edge is driven at its mean speed; the energy for speeding up and braking that is usual on
    such legs is added. In the table tyres and cabin are warm, and before and after an edge the car
    goes on as on it. A downhill edge may return energy, so a router needs the Bellman-Ford
    algorithm, or potentials.

    Example:
        >>> import evpinn_ros as ev
        >>> edges = {"length_m": [500.0, 500.0], "speed_kmh": [50.0, 50.0], "climb_m": [25, -25]}
        >>> energies = ev.edge_energies(edges, "bmw_i3")
        >>> bool(energies.table.energy_j[0] > 0 > energies.table.energy_j[1])
        True

    Args:
        edges: one row for each edge. Columns, with the unit in each name: two of `length_m`,
            `duration_s` and `speed_kmh`; and `climb_m`, or `start_elevation_m` and
            `end_elevation_m`. Without heights the sigma includes an unknown climb.
        car: name or file of a vehicle, or a `Vehicle`, of which nothing was learned; or the
            `Result` or `Estimator` that learned the car.
        temperature_c: outside temperature, degrees Celsius; if not given, the last that the car
            measured.
        heating_w: power of heating and air conditioning, W; if not given, what the temperature
            makes likely.
        head_wind: head wind on every edge, m/s over ground.
        payload_kg: people and luggage in addition to those when the car was learned, kg.
        air_density: kg/m^3; if not given, that of the vehicle file, at `temperature_c` if given.

    Raises:
        InputError: a column is missing, the vehicle does not exist, or an edge is impossible
            (`PlanError`).
    """
    # Here, for polars, which reads tables, takes a quarter of a second to import.
    from evpinn_ros.logs.plans.table import edges_of_columns

    _, model, _ = known_car(car)
    given = PlanConditions(temperature_c, heating_w, head_wind, payload_kg)
    legs = edges_of_columns(columns_of(edges))
    basis = basis_of(model, given, air_density)
    of_edges = energy_edges.edge_energies(legs, basis.model, basis.weather, basis.head_wind)
    counted = pandas().RangeIndex(len(legs.length))
    index = counted if isinstance(edges, Mapping) else edges.index
    return EdgeEnergies(index, of_edges)
