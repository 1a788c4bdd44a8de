"""Tables and page of a fleet, from drives that were learned."""

import pytest

from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.extras.fleet.car import CarTask, learn_car
from evpinn_ros.extras.fleet.manifest import CarDrives
from evpinn_ros.extras.fleet.page import write_fleet_page
from evpinn_ros.extras.fleet.run import car_folder
from evpinn_ros.extras.fleet.tables import DRIVES, write_tables
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.output import write
from evpinn_ros.replays.simulation.simulate import simulate

MONDAY = 1_700_438_400 * NANOSECONDS  # 2023-11-20
WEEK = 7 * 86_400 * NANOSECONDS


@pytest.mark.nightly
def test_drives_of_two_weeks_and_a_broken_one_have_trends(tmp_path, leaf):
    parquet = pytest.importorskip("pyarrow.parquet")
    paths = [tmp_path / name for name in ("a", "b", "c", "broken")]
    for start_ns, path in zip((MONDAY, MONDAY, MONDAY + WEEK), paths, strict=False):
        write(simulate(DriveKind.HIGHWAY, leaf, 120.0, 1, start_ns=start_ns), path)
    paths[-1].write_text("nothing")
    car, out = CarDrives("car", leaf, tuple(paths)), tmp_path / "out"
    learn_car(CarTask(car, car_folder(out, car), tmp_path / "stop"))
    summary = write_tables(out, [car], {})
    rows = parquet.read_table(out / DRIVES).to_pylist()
    assert sorted({row["week"] for row in rows if row["week"]}) == ["2023-11-20", "2023-11-27"]
    assert [row["distance_m"] is None for row in rows] == [False, False, False, True]
    write_fleet_page(tmp_path / "page.html", summary, "evpinn fleet")
    page = (tmp_path / "page.html").read_text()
    assert "Trends" in page and "Consumption, kWh/100 km by week" in page
