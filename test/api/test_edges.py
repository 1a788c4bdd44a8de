"""Energies of the edges of a road network from Python."""

import numpy as np
import pandas as pd
import pytest

import evpinn_ros as ev

pytestmark = pytest.mark.slow

EDGES = pd.DataFrame(
    {
        "length_m": [500.0, 500.0, 800.0, 600.0],
        "speed_kmh": [50.0, 50.0, 80.0, 30.0],
        "climb_m": [25.0, -25.0, 0.0, np.nan],
    },
    index=pd.MultiIndex.from_tuples([("a", "b"), ("b", "a"), ("b", "c"), ("a", "c")]),
)
FOUND = ev.edge_energies(EDGES, "bmw_i3")


def test_a_route_is_the_forecast_of_its_edges():
    route = [("a", "b"), ("b", "c"), ("a", "c")]
    for conditions in ({}, {"temperature_c": -5.0, "head_wind": 4.0, "payload_kg": 90.0}):
        network = ev.edge_energies(EDGES, "bmw_i3", **conditions)
        trip = ev.forecast(EDGES.loc[route], "bmw_i3", **conditions)
        assert network.route(route).value == pytest.approx(trip.energy_j.iloc[-1], rel=1e-9)
        assert network.route(route).sigma == pytest.approx(trip.sigma_j.iloc[-1], rel=1e-9)


def test_a_route_over_no_such_edge_is_refused():
    with pytest.raises(ev.InputError, match="not in the table"):
        FOUND.route([("c", "a")])
