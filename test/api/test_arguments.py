"""Tables and numbers from Python: what does not fit together is told, and numpy's numbers fit."""

import numpy as np
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
