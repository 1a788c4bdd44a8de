"""Tables, edges and numbers from Python: what does not fit is told, and numpy's numbers fit."""

import numpy as np
import pandas as pd
import pytest

import evpinn_ros as ev

PLAN = {"t_s": [0.0, 9.0], "speed_mps": [9.0, 9.0]}


@pytest.mark.parametrize("columns", ["rows", "legs", "edges"])
def test_columns_of_different_lengths_are_told(columns):
    with pytest.raises(ev.InputError, match=r"length|rows|shape|points"):
        if columns == "rows":
            ev.forecast({"t_s": [0.0, 5.0, 9.0], "speed_mps": [9.0, 9.0]})
        elif columns == "legs":
            ev.forecast({"length_m": [5.0, 9.0, 9.0], "duration_s": [9.0, 9.0]})
        else:
            ev.edge_energies({"length_m": [5.0, 9.0, 9.0], "speed_kmh": [9.0, 9.0]})


@pytest.mark.parametrize("kind", [float, np.float32, np.float64])
def test_every_kind_of_number_is_one(kind):
    assert ev.forecast(PLAN, head_wind=kind(2)).equals(ev.forecast(PLAN, head_wind=2))
    assert ev.Estimator().add(kind(1), kind(9)).power_w == ev.Estimator().add(1, 9).power_w


EDGES = pd.DataFrame(
    {
        "length_m": [500.0, 500.0, 800.0, 600.0],
        "speed_kmh": [50.0, 50.0, 80.0, 30.0],
        "climb_m": [25.0, -25.0, 0.0, np.nan],
    },
    index=pd.MultiIndex.from_tuples([("a", "b"), ("b", "a"), ("b", "c"), ("a", "c")]),
)


def test_a_route_is_the_forecast_of_its_edges():
    route = [("a", "b"), ("b", "c"), ("a", "c")]
    for conditions in ({}, {"temperature_c": -5.0, "head_wind": 4.0, "payload_kg": 90.0}):
        network = ev.edge_energies(EDGES, "bmw_i3", **conditions)
        trip = ev.forecast(EDGES.loc[route], "bmw_i3", **conditions)
        assert network.route(route).value == pytest.approx(trip.energy_j.iloc[-1], rel=1e-9)
        assert network.route(route).sigma == pytest.approx(trip.sigma_j.iloc[-1], rel=1e-9)


def test_a_route_over_no_such_edge_is_refused():
    with pytest.raises(ev.InputError, match="not in the table"):
        ev.edge_energies(EDGES, "bmw_i3").route([("c", "a")])
