"""Refusal of what ranges do not (see `test_state_schema`): nothing changes by it."""

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.battery_model import BatteryModel
from evpinn_ros.core.energy.charge import ChargeGauge
from evpinn_ros.core.energy.trip import TripLog
from test.core.energy import test_battery_model, test_charge, test_meter, test_trip

METRE = [[0.0, 0.0]]
CASES = [
    ("trip", {"windows": [METRE]}),
    ("trip", {"windows": [[], [], []]}),
    ("trip", {"windows": [METRE, [["far", 0.0]], METRE]}),
    ("trip", {"windows": [METRE, METRE, [[-1.0, 0.0]]]}),
    ("meter", {"bridged": [0.0] * 5}),
    ("charge", {"capacity": [1e12, 1.0]}),
    ("battery", {"state": [1e5, 50.0, 0.1]}),
    ("battery", {"covariance": [-1.0, 0, 0, 0, 1, 0, 0, 0, 1]}),
    ("battery", {"covariance": [1.0, 5, 0, 0, 1, 0, 0, 0, 1]}),
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
    with pytest.raises(InputError, match="saved"):
        counted.restore({**before, **wrong})
    assert counted.export() == before
