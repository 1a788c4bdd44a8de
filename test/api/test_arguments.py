"""Whatever is given from Python in place of an argument, the error is one line with its name."""

from collections.abc import Callable
from decimal import Decimal
from typing import Any

import numpy as np
import pandas as pd
import pytest

import evpinn_ros as ev

pytestmark = pytest.mark.slow

WRONG = {
    "huge": 10**400,
    "frame": pd.DataFrame({"a": [1, 2]}),
    "ragged": [1, [2, 3]],
    "matrix": np.ones((2, 2)),
    "bytes": b"\xff\xfe",
    "mapping": {1: 2},
    "complex": 1 + 2j,
    "object": object(),
}
PLAN = {"t_s": [0.0, 9.0], "speed_mps": [9.0, 9.0]}
EDGES = {"length_m": [500.0], "speed_kmh": [50.0]}
CALLS: dict[str, Callable[[Any], Any]] = {
    "plan": ev.forecast,
    "t_s": lambda x: ev.forecast(PLAN | {"t_s": x}),
    "speed_mps": lambda x: ev.forecast(PLAN | {"speed_mps": [9.0, x]}),
    "elevation_m": lambda x: ev.forecast(PLAN | {"elevation_m": x}),
    "car": lambda x: ev.forecast(PLAN, x),
    "edges": ev.edge_energies,
    "length_m": lambda x: ev.edge_energies(EDGES | {"length_m": [x]}),
    "head_wind": lambda x: ev.edge_energies(EDGES, head_wind=x),
    "vehicle": ev.load_vehicle,
    "text": ev.find_vehicles,
    "mode": lambda x: ev.Estimator(mode=x),
    "state": lambda x: ev.Estimator(state=x),
    "path": lambda x: ev.Estimator().save(x),
    "drive": ev.replay,
}
CALLS |= {
    name: lambda x, name=name: ev.forecast(PLAN, **{name: x})
    for name in (
        "charge_pct",
        "temperature_c",
        "heating_w",
        "payload_kg",
        "air_density",
        "stood_h",
    )
}
CALLS["prewarmed"] = lambda x: ev.forecast(PLAN, prewarmed=x)
CALLS |= {
    name: lambda x, name=name: ev.replay("no.csv", **{name: x})
    for name in (
        "params",
        "withhold_battery_after",
        "warm_up",
        "start",
        "duration",
        "columns",
        "trust_profile",
    )
}
SAMPLE = ("voltage_v", "current_a", "soc_pct", "ambient_c", "heating_w", "aircon_w")
CALLS |= {
    f"sample's {name}": lambda x, name=name: ev.Estimator().add(1.0, 9.0, **{name: x})
    for name in SAMPLE
}


@pytest.mark.parametrize("kind", WRONG)
@pytest.mark.parametrize("name", CALLS)
def test_what_is_no_such_argument_is_told_by_its_name(name, kind):
    with pytest.raises(ev.InputError) as told:
        CALLS[name](WRONG[kind])
    assert name.split()[-1] in str(told.value) and len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize("columns", ["rows", "legs", "edges"])
def test_columns_of_different_lengths_are_told(columns):
    with pytest.raises(ev.InputError, match=r"length|rows|shape|points"):
        if columns == "rows":
            ev.forecast({"t_s": [0.0, 5.0, 9.0], "speed_mps": [9.0, 9.0]})
        elif columns == "legs":
            ev.forecast({"length_m": [5.0, 9.0, 9.0], "duration_s": [9.0, 9.0]})
        else:
            ev.edge_energies({"length_m": [5.0, 9.0, 9.0], "speed_kmh": [9.0, 9.0]})


@pytest.mark.parametrize("kind", [float, np.float32, np.float64, Decimal])
def test_every_kind_of_number_is_one(kind):
    assert ev.forecast(PLAN, head_wind=kind(2)).equals(ev.forecast(PLAN, head_wind=2))
    assert ev.Estimator().add(kind(1), kind(9)).power_w == ev.Estimator().add(1, 9).power_w
