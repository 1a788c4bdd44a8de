"""Several drives of one car: their total, and where the energy of all drives went."""

from pathlib import Path
import re

import pytest

from evpinn_ros.replays.car import CarReplay
from evpinn_ros.replays.run import ReplayOptions
from evpinn_ros.report.drive_page import write_replayed
from evpinn_ros.report.owner_text import drives_rows
from test.recorded import Recorded

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def car(vehicle, readings) -> CarReplay:
    """Two drives, the second without a battery in its last quarter."""
    car = CarReplay(vehicle, ReplayOptions(warm_up=30.0))
    end = len(readings) * 3 // 4
    for name, some in (("one", readings), ("two", readings[:end])):
        car.replay(Recorded(list(some), Path(name)))
    return car


def test_the_breakdown_of_all_is_the_sum_of_those_of_the_drives(car):
    whole, drives = car.breakdown(), [replayed.metrics["breakdown"] for replayed in car.results]
    for key in ("distance_m", "duration_s"):
        assert whole[key] == pytest.approx(sum(drive[key] for drive in drives))
    measured = whole["measured"]["kwh"]
    assert measured == pytest.approx(sum(drive["measured"]["kwh"] for drive in drives))
    parts = ("air", "tyres", "slope", "speed", "brakes", "drivetrain", "climate", "standing")
    assert measured == pytest.approx(
        sum(whole[part]["kwh"] for part in (*parts, "unexplained")), abs=1e-9
    )
    # What is not known of the car is the same in both drives, so it does not average out.
    sigmas = [drive["tyres"]["sigma_kwh"] for drive in drives]
    assert whole["tyres"]["sigma_kwh"] > 0.5 * max(sigmas)
    assert whole["tyres"]["kwh"] == pytest.approx(
        sum(drive["tyres"]["kwh"] for drive in drives), abs=2.0 * sum(sigmas)
    )


def test_the_last_row_and_the_page_have_the_totals(car, tmp_path):
    named = [(d.metrics["input"]["path"], d.drive, d.metrics) for d in car.results]
    *rows, total = drives_rows(named, car.breakdown())
    assert total[0] == "all 2" and len(rows) == 2
    for column in (1, 3):  # kWh and km
        assert float(total[column]) == pytest.approx(
            sum(float(row[column]) for row in rows), abs=0.11
        )
    assert len(drives_rows(named[:1], None)) == 1  # one drive is its own total
    page = tmp_path / "all.html"
    gauge, whole = car.chain.account.gauge, car.breakdown()
    write_replayed(page, car.results, car.vehicle, car.options, "x", breakdown=whole, gauge=gauge)
    text = re.sub(r"<[^>]*>", " ", page.read_text().partition("<details")[0])
    assert car.vehicle.name in text and "State of health of the battery: not known yet" in text
    # On a narrow screen the first columns are seen: energy, and that over distance.
    assert re.search(r"drive\s+kWh\s+kWh/100 km\s+km\s+min\s+began", text)
    assert (
        "all 2" in text and "Where the energy of all drives went" in text and "kWh/100 km" in text
    )
