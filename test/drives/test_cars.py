"""Tables of several cars, and of several drives of one car, as published data sets are."""

import numpy as np
import pytest

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.drives.clock import PAUSE_NS
from evpinn_ros.drives.read_options import ReadOptions
from evpinn_ros.drives.sources import open_source
from evpinn_ros.drives.trips import split
from evpinn_ros.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.vehicle.files import load_vehicle
from test.drives.test_columns import drive_of, rows, speed_at

# As the Vehicle Energy Dataset has it (gsoh/VED, "VED_171101_week.csv").
HEADER = "VehId,Trip,Timestamp(ms),Vehicle Speed[km/h],HV Battery Current[A],HV Battery Voltage[V]"


def lines_of(car: str, trip: int, count: int = 1200) -> list[str]:
    return [
        f"{car},{trip},{1000 * t:.0f},{3.6 * v:.3f},{-i:.3f},{u}" for t, v, u, i in rows(count)
    ]


def speeds(drive) -> list[SpeedReading]:
    return [each for each in drive.readings() if isinstance(each, SpeedReading)]


def test_one_car_of_a_fleet_is_read(tmp_path):
    table = lines_of("455", 1605) + lines_of("541", 1700, 900) + lines_of("455", 1610)
    drive = drive_of(tmp_path, HEADER, table, car="541")
    found = speeds(drive)
    assert len(found) == 900 and not drive.dropped
    assert found[-1].speed == pytest.approx(speed_at(89.9), abs=1e-3)
    assert len(speeds(drive_of(tmp_path, HEADER, table, car="455"))) == 2400


def test_of_several_cars_one_is_asked_for(tmp_path):
    table = lines_of("455", 1605) + lines_of("541", 1700)
    with pytest.raises(InputError, match="2 cars; column 'VehId' has 455, 541; say --car NAME"):
        drive_of(tmp_path, HEADER, table)
    with pytest.raises(InputError, match="no row of the car '54'; did you mean 541"):
        drive_of(tmp_path, HEADER, table, car="54")
    with pytest.raises(InputError, match="no column tells cars apart"):
        drive_of(tmp_path, HEADER.replace("VehId", "Row"), table, car="541")


def test_torn_rows_are_no_cars(tmp_path):
    torn = [f"{number},1,{100 * number},30,5,360" for number in range(1201, 1215)]
    assert speeds(drive_of(tmp_path, HEADER, lines_of("455", 1) + torn))


def test_drives_whose_clock_begins_anew_follow_each_other(tmp_path):
    table = lines_of("455", 1605) + lines_of("455", 1610, 900) + lines_of("455", 1611)
    drive = drive_of(tmp_path, HEADER, table)
    found = speeds(drive)
    assert len(found) == 3300 and not drive.dropped
    steps = np.diff([each.stamp_ns for each in found])
    assert np.flatnonzero(steps > NANOSECONDS).tolist() == [1199, 2099]
    assert set(steps[[1199, 2099]].tolist()) == {PAUSE_NS}
    assert drive.seconds == pytest.approx(119.9 + 89.9 + 119.9 + 7200.0)
    trips, _ = split(drive)
    assert [len(speeds(trip)) for trip in trips] == [1200, 900, 1200]


def test_a_wrong_time_is_no_new_drive(tmp_path):
    table = lines_of("455", 1605)
    table[600] = table[600].replace(",60000,", ",9960000,")
    table[900] = table[900].replace(",90000,", ",0,")
    drive = drive_of(tmp_path, HEADER, table)
    found = speeds(drive)
    assert len(found) == 1198 and drive.dropped == {"time_not_increasing": 2}
    assert found[-1].stamp_ns - found[0].stamp_ns == 119_900_000_000


def test_one_car_of_a_bag_is_read(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        write_readings([SpeedReading(NANOSECONDS, 1.0)], writer, "/one")
        write_readings([SpeedReading(NANOSECONDS, 2.0)], writer, "/fleet/two")
    vehicle = load_vehicle("generic")
    with pytest.raises(InputError, match="topics of 2 cars, /fleet/two, /one; say --car NAME"):
        open_source(tmp_path / "bag", vehicle)
    for name in ("fleet/two", "/fleet/two"):
        found = speeds(open_source(tmp_path / "bag", vehicle, ReadOptions(car=name)))
        assert [each.speed for each in found] == [2.0]
