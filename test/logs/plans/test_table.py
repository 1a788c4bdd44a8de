"""Tables of plans: speed over time, and legs by the names and units of their columns."""

import warnings

import numpy as np
import pandas as pd
import pytest

import evpinn_ros as ev
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.plan import Plan, PlanError

SPEEDS = "t_s,speed_mps,elevation_m\n0,0,0\n15,20,0\n400,20,60\n420,0,60\n"
LEGS = "length_m,duration_s,climb_m\n1200,150,10\n12000,480,100\n3000,240,\n"


def test_speed_over_time_is_a_plan_of_its_points(read):
    plan = read(SPEEDS)
    assert isinstance(plan, Plan)
    assert plan.time.tolist() == [0, 15, 400, 420] and plan.speed.tolist() == [0, 20, 20, 0]
    assert plan.elevation.tolist() == [0, 0, 60, 60] and plan.distance[-1] == 8050.0


@pytest.mark.parametrize(
    "table",
    [
        SPEEDS.replace(",", ";"),
        SPEEDS.replace(",", "\t").replace("20", "20.0"),
        SPEEDS.replace(",", ";").replace(";20;", ";20,0;").encode("utf-16"),
        "# by hand\n" + SPEEDS,
        SPEEDS.replace("\n", " \r\n"),
    ],
    ids=["semicolons", "tabs", "decimal commas in utf-16", "comment", "windows"],
)
def test_the_way_a_spreadsheet_writes_it_makes_no_difference(read, table):
    assert read(table).distance[-1] == 8050.0


def test_legs_by_their_columns(read):
    legs = read(LEGS)
    assert legs.length.tolist() == [1200, 12000, 3000]
    assert legs.duration.tolist() == [150, 480, 240]
    assert legs.climb.tolist() == [10, 100, 0]
    assert legs.height_known.tolist() == [True, True, False]


@pytest.mark.parametrize(
    "table",
    [
        "distance [km];travel time [min]\n1,2;2,5\n12;8\n3;4\n",
        "Length (km),Mean speed (km/h)\n1.2,28.8\n12,90\n3,45\n",
        "duration_s,speed_mps\n150,8\n480,25\n240,12.5\n",
        "length_mi,speed_mph,name\n0.745645,17.89549,a\n7.456454,55.92341,b\n1.864114,27.9617,c\n",
    ],
)
def test_units_are_those_of_the_header(read, table):
    legs = read(table)
    assert legs.length == pytest.approx([1200, 12000, 3000], rel=1e-5)
    assert legs.duration == pytest.approx([150, 480, 240], rel=1e-5)


def test_heights_at_the_ends_are_climbs(read):
    both = read(
        "length_m,duration_s,start_elevation_m,end_elevation_m\n900,60,500,510\n900,60,510,490\n"
    )
    assert both.climb.tolist() == [10, -20] and both.height_known.all()
    ends = read("length_m,duration_s,elevation_m\n900,60,510\n900,60,490\n")
    assert ends.climb.tolist() == [0, -20] and ends.height_known.tolist() == [False, True]


def uphill(header, rows):
    return header + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)


@pytest.mark.parametrize("grade", [0.05, -0.05])
@pytest.mark.parametrize(
    ("header", "row", "percent"),
    [
        ("t_s,speed_mps,grade", lambda t, g: (t, 20, g), False),
        ("t_s,speed_mps,grade", lambda t, g: (t, 20, g), True),
        ("t_s,speed_mps,grade_fraction", lambda t, g: (t, 20, g), False),
        ("t_s,speed_mps,grade_percent", lambda t, g: (t, 20, g), True),
        ("cycSecs,cycMps,cycGrade,cycRoadType", lambda t, g: (t, 20, g, 0), False),
        ("time [min],Speed (mph),distance_mi,Slope [%]",
         lambda t, g: (t / 60, 20 / 0.44704, 20 * t / 1609.344, g), True),
        ("length_km,speed_kmh,road_grade_pct", lambda t, g: (0.2, 72, g), True),
        ("distance_mi,speed_mph,grade", lambda t, g: (0.2 / 1.609344, 72 / 1.609344, g), False),
    ],
)  # fmt: skip
def test_grades_are_climbs(read, header, row, percent, grade):
    """Fractions or percent, by their name or their size, which is said then."""
    rows = [row(10 * i, 100 * grade if percent else grade) for i in range(51)]
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        plan = read(uphill(header, rows))
    texts = [str(warning.message) for warning in warned]
    said = any(unit in header for unit in ("_pct", "[%]", "_percent", "_fraction"))
    unit = "percent" if percent else "fractions"
    assert any(f"assumed to be in {unit}" in text for text in texts) == (not said)
    if isinstance(plan, Plan):
        length, climb = plan.distance[-1], np.ptp(plan.elevation) * np.sign(plan.elevation[-1])
    else:
        length, climb = plan.length.sum(), plan.climb.sum()
        assert plan.height_known.all()
    assert length == pytest.approx(10_000.0, rel=0.021)
    assert climb / length == pytest.approx(np.sin(np.arctan(grade)))


def test_a_grade_beside_heights_is_not_used_nor_is_a_drive_with_one_a_plan(read):
    with pytest.warns(UserWarning, match="not used: grade, wind"):
        plan = read(
            "t_s,speed_mps,elevation_m,grade,wind\n0,0,0,9,1\n400,20,60,9,1\n420,0,60,9,1\n"
        )
    assert plan.elevation.tolist() == [0, 60, 60]
    rows = [(t, 20, 350, 10, 0.05) for t in range(100)]
    drive = read(uphill("time_s,speed_mps,voltage (V),current (A),grade", rows), "drive.csv")
    assert not np.ptp(drive.elevation)


def test_columns_that_are_not_used_are_named():
    with pytest.warns(UserWarning, match="not used: height, 7, road$"):
        ev.forecast({"t_s": [0, 9], "speed_mps": [9, 9], "height": [1, 2], 7: 0, "road": "A"})
    with pytest.warns(UserWarning, match="not used: .*and 2 more$"):
        ev.forecast({"length_m": [900], "speed_kmh": [50]} | {f"x{i}": 0 for i in range(10)})


def test_a_leg_without_length_is_a_stop(read):
    legs = read("length_km,speed_kmh,duration_s\n3,60,\n0,,300\n3,60,\n")
    assert legs.length.tolist() == [3000, 0, 3000] and legs.duration.tolist() == [180, 300, 180]


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ("length,duration_s\n1200,150\n", "column 'length' does not say its unit"),
        ("length_m,duration_s\n1.2,150\n12,480\n", "lengths in m, durations in s"),
        ("length_m,duration_s,speed_kmh\n12000,480,900\n", "contradict each other at leg 0"),
        (
            "length_m,duration_s\n900,sixty\n",
            "duration_s holds what is no number, 'sixty' in row 1",
        ),
        ("length_m,duration_s\n" + 50_001 * "9,1\n", "50001 points are more than 50000"),
    ],
)
def test_wrong_legs_are_refused_with_the_reason(read, table, reason):
    with pytest.raises(PlanError if "holds" not in reason else InputError, match=reason) as error:
        read(table, "legs.csv")
    assert "legs.csv: " in str(error.value)


def test_python_takes_the_same_columns_and_files(tmp_path):
    columns = {"length_m": [1200, 12000, 3000], "duration_s": [150, 480, 240],
               "climb_m": [10, 100, np.nan]}  # fmt: skip
    (tmp_path / "legs.csv").write_text(LEGS)
    for plan in (columns, pd.DataFrame(columns)):
        pd.testing.assert_frame_equal(ev.forecast(tmp_path / "legs.csv"), ev.forecast(plan))
    table = ev.forecast(columns, "bmw_i3", charge_pct=80.0)
    assert table.loc[[0, 150, 630, 870], "distance_m"].tolist() == [0, 1200, 13200, 16200]
    assert 0 < table["charge_pct"].iloc[-1] < 80


def test_air_is_denser_when_it_is_cold():
    legs = {"length_km": [20.0], "speed_kmh": [110.0]}
    warm, cold, thin = (
        ev.forecast(legs, "bmw_i3", **given)["energy_j"].iloc[-1]
        for given in ({"temperature_c": 20.0}, {"temperature_c": -15.0}, {"air_density": 1.0})
    )
    assert thin < warm < cold
    assert warm == ev.forecast(legs, "bmw_i3")["energy_j"].iloc[-1]
