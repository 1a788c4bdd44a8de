"""Drives of one car compared: from recordings to rows, sentences, curves and a page."""

from contextlib import nullcontext
from dataclasses import replace
from html import unescape
from pathlib import Path
import re

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.units import METRIC, US
from evpinn_ros.core.signals.readings import AltitudeReading, BatteryReading, SpeedReading
from evpinn_ros.replays.car import CarReplay
from evpinn_ros.replays.comparison import Comparison, compare, distance_until, over_distance
from evpinn_ros.replays.driven import travelled
from evpinn_ros.replays.run import ReplayOptions
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from evpinn_ros.report.compare_page import part_rows, sentences, trip_rows, write_comparison
from test.recorded import Recorded

pytestmark = pytest.mark.slow

LOAD = 3000.0  # W more in the second drive


def heated(readings, watts: float):
    """A drive with a load that nothing tells of."""
    for reading in readings:
        if isinstance(reading, BatteryReading):
            yield replace(reading, current=reading.current - watts / reading.voltage)
        else:
            yield reading


def compared(vehicle, *drives, **given) -> Comparison:
    car = CarReplay(vehicle, ReplayOptions(), keep_drives=True, **given)
    sources = [Recorded(list(readings), Path(f"drive{i}")) for i, readings in enumerate(drives)]
    return compare(car, sources, progress=lambda _: nullcontext(lambda _: None))


@pytest.fixture(scope="module")
def winter(vehicle, readings) -> Comparison:
    return compared(vehicle, readings, heated(readings, LOAD))


def test_no_drive_has_more_road_than_was_driven(winter):
    for drive, parts in zip(winter.drives, winter.parts(), strict=True):
        assert parts.distance <= 1.01 * travelled(drive).distance.sum()


def test_a_load_is_found_as_what_explains_the_difference(vehicle):
    """Same road, same driver: the load and nothing else differs, and it is known how much.

    With a barometer, for without heights a load may as well be a climb.
    """
    drive = simulate(DriveKind.URBAN, vehicle, 120.0, seed=11, altitude=True)
    known = SpeedReading | BatteryReading | AltitudeReading
    readings = [reading for reading in drive.readings if isinstance(reading, known)]
    winter = compared(vehicle, readings, heated(readings, LOAD))
    (difference,) = winter.differences()
    unloaded = winter.parts()[0]
    true = LOAD * unloaded.seconds / unloaded.distance * 1e5 / 3.6e6
    standing = difference.amounts()["standing"]
    assert abs(standing.kwh - true) < 3.0 * standing.sigma_kwh
    assert standing.sigma_kwh < 0.25 * true
    for name, part in difference.amounts().items():
        if name not in ("standing", "unexplained"):
            assert abs(part.kwh) < 0.1 * true, name
    first, second = sentences(winter)
    assert first.startswith("drive1 took") and "more than drive0" in first
    assert second.startswith("Explained by other standing load (")


def test_miles_are_the_same_roads(winter, tmp_path):
    """Each figure is the metric one in other units; no kilometre is left on the page."""
    metric, us = (
        {name: cells for name, *cells in trip_rows(winter, u) + part_rows(winter.parts(), units=u)}
        for u in (METRIC, US)
    )
    far, miles = (float(rows["length"][1].split()[0]) for rows in (metric, us))
    assert miles == pytest.approx(far / 1.609344, abs=0.1) and us["length"][1].endswith(" mi")
    kwh, wh = (float(rows["measured"][1].split()[0]) for rows in (metric, us))
    assert wh == pytest.approx(16.09344 * kwh, abs=0.2)
    more = re.search(r"took (\S+) Wh/mi more", next(iter(sentences(winter, US))))[1]
    total = winter.differences()[0].total().kwh
    assert float(more) == pytest.approx(16.09344 * total, abs=0.06)
    course = over_distance(winter.drives[0], 50, US)
    assert course.distance[-1] == pytest.approx(distance_until(winter.drives[0])[1][-1] / 1609.344)
    write_comparison(tmp_path / "us.html", winter, "evpinn compare a b", US)
    words = re.sub(
        r"<style.*?</style>|<[^>]+>", " ", (tmp_path / "us.html").read_text(), flags=re.S
    )
    assert "Wh/mi" in words and "mph" in words and not re.search(r"\bkm\b|km/h|100 km", words)


def test_a_charge_on_the_way_is_no_energy_of_the_road(winter):
    drive = winter.drives[0]
    end = drive.speed[-1, 0]
    time = end + np.arange(1.0, 601.0)
    plugged = replace(
        drive,
        speed=np.vstack([drive.speed, np.column_stack([time, 0 * time])]),
        measured=np.vstack([drive.measured, np.column_stack([time, 0 * time - 7000.0])]),
    )
    before, after = (over_distance(driven, 50).energy[-1] for driven in (drive, plugged))
    assert after == pytest.approx(before, abs=0.002)


def test_a_drive_without_battery_is_refused_by_name(vehicle, readings):
    minute = readings[: len(readings) // 2]
    speeds = [reading for reading in minute if isinstance(reading, SpeedReading)]
    with pytest.raises(InputError, match="drive1: where its energy went is unknown"):
        compared(vehicle, minute, speeds)


def test_parameters_of_the_nodes_hold_here_too(vehicle, readings, tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text("estimator: {ros__parameters: {mode: paper}}")
    with pytest.raises(InputError, match=r"nothing to compare: .* because mode paper"):
        compared(vehicle, readings, params=file)
    file.write_text("estimator: {ros__parameters: {time_jump_policy: reset}}")
    minute = readings[: len(readings) // 2]
    again = [*minute, *minute]  # starts over, which must not forget the drive before
    once, twice = compared(vehicle, minute, again, params=file).parts()
    assert twice.distance == pytest.approx(2 * once.distance, rel=0.05)


def test_the_page_loads_and_runs_nothing_and_escapes_names(winter, tmp_path):
    hostile = replace(winter, names=("<script>alert(1)</script>", "b"))
    page = tmp_path / "deep" / "c.html"
    write_comparison(page, hostile, "evpinn compare <a> b")
    text = page.read_text()
    assert "<script" not in text and "&lt;script&gt;" in text
    assert "default-src 'none'" in unescape(text) and not re.search(r"(src|href)=", text)
    assert text.count("<polyline") == 2 * 2  # energy and speed of both drives, no height
    assert "+-" not in text and text.count("±") > 20
    assert [f'<polyline class="drive{i}"' in text for i in range(3)] == [True, True, False]
    assert "other standing load" in text and "&lt;a&gt; b" in text


def test_no_distance_is_driven_across_a_gap(winter):
    """An hour without a reading at 30 m/s is no hundred kilometres."""
    drive = winter.drives[0]
    metres = distance_until(drive)[1]
    late = drive.speed.copy()
    late[len(late) // 2 :, 0] += 3600.0
    far = distance_until(replace(drive, speed=late))[1]
    step = metres[len(late) // 2] - metres[len(late) // 2 - 1]
    assert far[-1] == pytest.approx(metres[-1] - step)
    assert travelled(drive).distance.sum() == pytest.approx(metres[-1])
