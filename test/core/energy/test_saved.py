"""Refusal of what was saved and is wrong: nothing changes by it."""

import math

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import ChargeGauge
from evpinn_ros.core.energy.trip import TripLog
from test.core.energy import test_battery_model, test_charge, test_meter, test_trip

METRE = [[0.0, 0.0]]
CASES = [
    ("trip", {"windows": None}),
    ("trip", {"windows": [METRE]}),
    ("trip", {"windows": [[], [], []]}),
    ("trip", {"windows": [METRE, [["far", 0.0]], METRE]}),
    ("trip", {"windows": [METRE, METRE, [[-1.0, 0.0]]]}),
    ("trip", {"energy": None}),
    ("trip", {"speed": {"drawn": math.nan}}),
    ("trip", {"speed": {"gaps": -1}}),
    ("trip", {"speed": {"regenerated": "x"}}),
    ("meter", {"measured": None}),
    ("meter", {"rknn": "many"}),
    ("meter", {"rknn": math.inf}),
    ("meter", {"unmeasured_s": math.nan}),
    ("meter", {"predicted": []}),
    ("meter", {"bridged": [0.0] * 5}),
    ("meter", {"bridged_sigma": "wide"}),
    ("charge", {"capacity": [math.nan, 1.0]}),
    ("charge", {"capacity": [1e7]}),
    ("charge", {"capacity": "large"}),
    ("charge", {"capacity": [1e12, 1.0]}),
    ("charge", {"learned": -1}),
    ("charge", {"step": 0.5}),
    ("battery", {"samples": -1}),
    ("battery", {"samples": math.inf}),
    ("battery", {"state": [370.0, 50.0]}),
    ("battery", {"state": [1e5, 50.0, 0.1]}),
    ("battery", {"state": [370.0, 50.0, 1e300]}),
    ("battery", {"covariance": [-1.0, 0, 0, 0, 1, 0, 0, 0, 1]}),
    ("battery", {"covariance": [1.0, 5, 0, 0, 1, 0, 0, 0, 1]}),
    ("battery", {"covariance": [1e300] * 9}),
    ("battery", {"full_charge": None}),
]


@pytest.fixture(scope="module")
def driven():
    gauge, battery = ChargeGauge(test_charge.CAPACITY), BatteryModel(test_battery_model.CAPACITY)
    test_charge.discharge(gauge, 0.9, 0.5)
    test_battery_model.drive(battery.add_reading, 100)
    meter = test_meter.drive(test_meter.meter(), range(10))
    trip = test_trip.drive(TripLog(), 100.0)
    return {"trip": trip, "meter": meter, "charge": gauge, "battery": battery}


@pytest.mark.parametrize(("what", "wrong"), CASES)
def test_it_is_refused_and_changes_nothing(driven, what, wrong):
    counted = driven[what]
    before = counted.export()
    if what == "trip" and wrong.get("speed"):
        wrong = {"speed": before["speed"] | wrong["speed"]}
    with pytest.raises(InputError, match="saved"):
        counted.restore({**before, **wrong})
    assert counted.export() == before
