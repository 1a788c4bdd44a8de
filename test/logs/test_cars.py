"""Tables of several cars, and of several drives of one car, as published data sets are."""

import numpy as np
import pytest

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.clock import PAUSE_NS
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_source
from evpinn_ros.logs.trips import split
from test.logs.test_columns import drive_of, rows, speed_at

# As the Vehicle Energy Dataset has it (gsoh/VED, "VED_171101_week.csv").
HEADER = "VehId,Trip,Timestamp(ms),Vehicle Speed[km/h],HV Battery Current[A],HV Battery Voltage[V]"


def lines_of(car: str, trip: int, count: int = 1200) -> list[str]:
    return [
        f"{car},{trip},{1000 * t:.0f},{3.6 * v:.3f},{-i:.3f},{u}" for t, v, u, i in rows(count)
    ]


def speeds(drive) -> list[SpeedReading]:
    return [reading for reading in drive.readings() if isinstance(reading, SpeedReading)]


def test_one_car_of_a_fleet_is_read(tmp_path):
    table = lines_of("455", 1605) + lines_of("541", 1700, 900) + lines_of("455", 1610)
    drive = drive_of(tmp_path, HEADER, table, car="541")
    readings = speeds(drive)
    assert len(readings) == 900 and not drive.dropped
    assert readings[-1].speed == pytest.approx(speed_at(89.9), abs=1e-3)
    assert len(speeds(drive_of(tmp_path, HEADER, table, car="455"))) == 2400


def test_of_several_cars_one_is_asked_for(tmp_path):
    table = lines_of("455", 1605) + lines_of("541", 1700)
    with pytest.raises(InputError, match="2 cars; column 'VehId' has 455, 541; say --car NAME"):
        drive_of(tmp_path, HEADER, table)
    with pytest.raises(InputError, match="no row of the car '54'; did you mean 541"):
        drive_of(tmp_path, HEADER, table, car="54")
    with pytest.raises(InputError, match="no column names cars"):
        drive_of(tmp_path, HEADER.replace("VehId", "Row"), table, car="541")


@pytest.mark.parametrize("name", ["vehicle_name", "deviceId", "Car No", "Fahrzeug", "车牌号"])
def test_cars_of_few_rows_are_told_apart_by_any_name(tmp_path, name):
    table = [line for car in "abc" for line in lines_of(car, 1, 15)]
    with pytest.raises(InputError, match=f"3 cars; column '{name}' has a, b, c"):
        drive_of(tmp_path, HEADER.replace("VehId", name), table)


def test_a_fleet_with_one_signal_a_row_is_no_car(tmp_path):
    table = [
        f"{car},{t:.1f},{name},{value}"
        for car, phase in (("one", 0), ("two", 7))
        for t, v, u, i in rows()
        for name, value in (("speed", speed_at(t + phase)), ("pack volts", u), ("pack amps", i))
    ]
    header = "vehicle,time,name,value"
    with pytest.raises(InputError, match="column 'vehicle' has one, two; say --car NAME"):
        drive_of(tmp_path, header, table)
    readings = speeds(drive_of(tmp_path, header, table, car="two"))
    assert len(readings) == 1200 and readings[0].speed == pytest.approx(speed_at(7.0))


def test_cars_are_told_apart_where_a_model_has_a_column_too(tmp_path):
    table = [f"Leaf,{line}" for car in ("455", "541") for line in lines_of(car, 1)]
    for car in (None, "Leaf"):
        with pytest.raises(InputError, match="column 'VIN' has 455, 541"):
            drive_of(tmp_path, f"Vehicle,{HEADER.replace('VehId', 'VIN')}", table, car=car)


def test_a_car_that_begins_late_in_the_table_is_seen(tmp_path):
    table = ["455"] * 300_000 + lines_of("541", 1)
    with pytest.raises(InputError, match="rows of 2 cars"):
        drive_of(tmp_path, HEADER, table)


@pytest.mark.parametrize("name", ["Vin [V]", "Vin", "Vehicle (km/h)"])
def test_a_measured_value_is_no_car(tmp_path, name):
    table = [f"{12 + t % 2:.1f},{line}" for t, line in enumerate(lines_of("455", 1))]
    if name == "Vin":
        table = [line.replace(".0,", ".4,", 1) for line in table]
    drive = drive_of(tmp_path, f"{name},{HEADER.replace('VehId', 'Row')}", table)
    assert len(speeds(drive)) == 1200


def test_drives_whose_clock_begins_anew_follow_each_other(tmp_path):
    table = lines_of("455", 1605) + lines_of("455", 1610, 900) + lines_of("455", 1611)
    drive = drive_of(tmp_path, HEADER, table)
    readings = speeds(drive)
    assert len(readings) == 3300 and not drive.dropped
    steps = np.diff([reading.stamp_ns for reading in readings])
    assert np.flatnonzero(steps > NANOSECONDS).tolist() == [1199, 2099]
    assert set(steps[[1199, 2099]].tolist()) == {PAUSE_NS}
    assert drive.seconds == pytest.approx(119.9 + 89.9 + 119.9 + 7200.0)
    trips, _ = split(drive)
    assert [len(speeds(trip)) for trip in trips] == [1200, 900, 1200]


def in_blocks(begin: float) -> list[str]:
    """A drive whose speeds stand before its voltages and currents."""
    speed = [f"{begin + t:.1f},{v:.3f},," for t, v, *_ in rows()]
    return speed + [f"{begin + t:.1f},,{u},{i:.3f}" for t, _, u, i in rows()]


@pytest.mark.parametrize("begins", [(0,), (1.7e9,), (0, 5000), (1.7e9, 1.7e9 + 5000)])
def test_columns_that_follow_each_other_are_no_drives(tmp_path, begins):
    table = [line for begin in begins for line in in_blocks(begin)]
    drive = drive_of(tmp_path, "time,speed [m/s],pack volts,pack amps", table)
    readings = speeds(drive)
    assert len(readings) == 1200 * len(begins) and not drive.dropped and not drive.in_order
    seconds = (readings[-1].stamp_ns - readings[0].stamp_ns) / NANOSECONDS
    assert seconds == pytest.approx(begins[-1] - begins[0] + 119.9)
    assert "anew" not in drive.clock.why


def test_a_sign_is_told_by_signals_that_stand_far_down(tmp_path, monkeypatch):
    monkeypatch.setattr("evpinn_ros.logs.table_drive.MOST_ROWS", 1000)
    signals = {"speed [m/s]": 1, "pack volts": 2, "pack amps": 3}
    moments = [(t, v, u, -i) for t, v, u, i in rows()]
    table = [
        f"{moment[0]:.1f},{name},{moment[at]}"
        for name, at in signals.items()
        for moment in moments
    ]
    current = drive_of(tmp_path, "time,name,value", table).rules[-1]
    assert current.quantity == "current" and "negative while it discharges" in current.why


def test_a_wrong_time_is_no_new_drive(tmp_path):
    table = lines_of("455", 1605)
    table[600] = table[600].replace(",60000,", ",9960000,")
    table[900] = table[900].replace(",90000,", ",0,")
    drive = drive_of(tmp_path, HEADER, table)
    readings = speeds(drive)
    assert len(readings) == 1198 and drive.dropped == {"time_not_increasing": 2}
    assert readings[-1].stamp_ns - readings[0].stamp_ns == 119_900_000_000


def test_one_car_of_a_bag_is_read(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        write_readings([SpeedReading(NANOSECONDS, 1.0)], writer, "/one")
        write_readings([SpeedReading(NANOSECONDS, 2.0)], writer, "/fleet/two")
    vehicle = load_vehicle("generic")
    with pytest.raises(InputError, match="topics of 2 cars, /fleet/two, /one; say --car NAME"):
        open_source(tmp_path / "bag", vehicle)
    for name in ("fleet/two", "/fleet/two"):
        readings = speeds(open_source(tmp_path / "bag", vehicle, ReadOptions(car=name)))
        assert [reading.speed for reading in readings] == [2.0]
