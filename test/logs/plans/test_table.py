"""Tables of plans: speed over time, and legs by the names and units of their columns."""

from dataclasses import replace
import math
import warnings

import numpy as np
import pandas as pd
import polars as pl
import pytest

import evpinn_ros as ev
from evpinn_ros.api.plan import planned_energy
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.plan import Plan, PlanError
from evpinn_ros.logs.plans import read_plan
from evpinn_ros.logs.read_options import ReadOptions

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


@pytest.mark.parametrize(
    ("header", "row", "level"),
    [
        ("t_s,speed_mps,elevation_m", "{0},15,212.5", True),
        ("t_s,speed_mps,grade_percent", "{0},15,0", True),
        ("t_s,speed_mps,voltage_v,current_a,elevation_m", "{0},15,350,20,212.5", True),
        ("length_m,duration_s,start_elevation_m,end_elevation_m", "900,60,212.5,212.5", True),
        ("length_m,duration_s,climb_m", "900,60,0", True),
        ("t_s,speed_mps", "{0},15", False),
        ("time [s],Speed [km/h],Altitude [m]", "{0},54,0", False),  # may have no fix
        ("length_m,duration_s", "900,60", False),
        ("t_s,speed_mps,elevation_m", "{0},15,", False),
        ("t_s,speed_mps,grade_percent", "{0},15,", False),
        ("t_s,speed_mps,voltage_v,current_a,elevation_m", "{0},15,350,20,", False),
        ("time [s],Speed [km/h],Altitude [m]", "{0},54,", False),
        ("length_m,duration_s,climb_m", "900,60,", False),
        ("length_m,duration_s,grade_percent", "900,60,", False),
        ("length_m,duration_s,start_elevation_m,end_elevation_m", "900,60,,", False),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_heights_that_never_change_say_that_the_road_is_level(read, header, row, level):
    """Of a plan as of a drive; without heights, hills like those of earlier drives may come."""
    rows = (row.format(second) for second in range(400))
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        planned = planned_energy(read("\n".join((header, *rows)), "plan.csv"), "bmw_i3")
    assert (planned.no_heights() is None) == level
    unseen = 0.0 if level else planned.trip.distance[-1]
    assert planned.energies.end.unseen == pytest.approx(unseen, abs=0.0)
    assert planned.trip.level == level
    said = any("the road is assumed to be level" in str(note.message) for note in notes)
    assert said == (level and "elevation" in header)


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


def test_a_grade_beside_heights_is_not_used_but_that_of_a_drive_is(read):
    with pytest.warns(UserWarning, match="not used: grade, wind"):
        plan = read(
            "t_s,speed_mps,elevation_m,grade,wind\n0,0,0,9,1\n400,20,60,9,1\n420,0,60,9,1\n"
        )
    assert plan.elevation.tolist() == [0, 60, 60]
    rows = [(t, 20, 350, 10, 0.05) for t in range(100)]
    with pytest.warns(UserWarning, match="'grade' is assumed to be in fraction, and could be in"):
        drive = read(uphill("time_s,speed_mps,voltage (V),current (A),grade", rows), "drive.csv")
    assert drive.elevation[-1] == pytest.approx(99 * 20 * 0.05, rel=0.07)


TRACE = [(t, min(t, 20.0, 0.5 * (300 - t))) for t in range(301)]  # s and m/s: 5.6 km
SUMO = ("timestep_time", "vehicle_id", "vehicle_pos", "vehicle_slope", "vehicle_speed")


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("t_s,speed_mps,grade", lambda t, v, g: (t, v, g)),
        ("cycSecs,cycMps,cycGrade,cycRoadType", lambda t, v, g: (t, v, g, 0)),
        ("time_seconds,speed_meters_per_second,grade", lambda t, v, g: (t, v, g)),
        ("time [min],Speed (mph),Slope [%]", lambda t, v, g: (t / 60, v / 0.44704, 100 * g)),
        ("t_s,speed_mps,slope_deg", lambda t, v, g: (t, v, math.degrees(math.atan(g)))),
        ("time,Vehicle Speed (km/h),Slope (%)", lambda t, v, g: (t, 3.6 * v, 100 * g)),
        ("Elapsed time (s),velocity (m/s),Road gradient (rad)",
         lambda t, v, g: (t, v, math.atan(g))),
        (";".join(SUMO), lambda t, v, g: (t, "car", 0, math.degrees(math.atan(g)), v)),
        (";".join((*SUMO, "vehicle_z")),
         lambda t, v, g: (t, "car", 0, 0, v, 300 + g / math.hypot(1, g) * way(t))),
        ("Time (s),Speed (km/h),voltage (V),current (A),grade_percent",
         lambda t, v, g: (t, 3.6 * v, 350 - t % 7, t % 11, 100 * g)),
        ("Time (s),Speed (km/h),Altitude (ft)",
         lambda t, v, g: (t, 3.6 * v, (300 + g / math.hypot(1, g) * way(t)) / 0.3048)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("grade", [0.05, -0.03])
def test_a_trace_takes_the_same_whatever_its_columns_are_called(read, grade, header, row):
    """Slopes in percent, fractions and angles, heights in feet, speeds in mph: one road."""
    rows = [row(t, v, grade) for t, v in TRACE]
    table = uphill(header, rows)
    plan = read(table.replace(",", ";") if ";" in header else table, "trace.csv")
    assert plan.commanded
    assert plan.distance[-1] == pytest.approx(way(300), rel=1e-3)
    climb = np.sin(np.arctan(grade)) * way(300)
    assert plan.elevation[-1] - plan.elevation[0] == pytest.approx(climb, abs=5.0)
    exact = replace(plan, elevation=plan.distance * np.sin(np.arctan(grade)))
    kwh = [ev.forecast(road, "bmw_i3")["energy_j"].iloc[-1] / 3.6e6 for road in (plan, exact)]
    assert kwh[0] == pytest.approx(kwh[1], abs=0.03)


def way(time):
    """Distance of `TRACE` after so many seconds, m."""
    at, speed = np.array(TRACE, float).T
    return float(np.interp(time, at, np.concatenate(([0], np.cumsum(speed[1:] + speed[:-1]) / 2))))


def test_what_a_drive_s_columns_are_taken_for_is_said(read):
    """Speeds to 45 without a unit might be m/s, km/h or mph; heights m or feet."""
    rows = [(t, 2.237 * v, 300 + 3 * t, 5) for t, v in TRACE]
    with pytest.warns(UserWarning) as warned:
        read(uphill("time,speed,altitude,wind", rows), "drive.csv")
    texts = [str(warning.message) for warning in warned]
    assert any("speed 'speed', m/s (assumed)" in text for text in texts)
    assert any("speed=speed:" in text and "could be in km/h or mph" in text for text in texts)
    assert any("'altitude' is assumed to be in m, and could be in ft" in text for text in texts)
    assert any(text.endswith("not used: wind") for text in texts)


def test_a_mean_speed_that_no_trip_has_is_said(tmp_path):
    """72 km/h, taken for m/s."""
    (tmp_path / "fast.csv").write_text("t_s,speed_mps\n0,72\n600,72\n")
    for plan in ({"t_s": [0, 600], "speed_mps": [72, 72]}, tmp_path / "fast.csv"):
        with pytest.warns(UserWarning, match=r"259 km/h \(72 m/s\) on the whole"):
            ev.forecast(plan)


@pytest.mark.parametrize("step", [2, 10])
def test_a_table_of_other_names_says_where_it_is_taken_as_driven(read, step):
    """Points 2 s apart at 72 km/h took a fifth less than under our names, without a word."""
    rows = "".join(f"{t},72\n" for t in range(0, 601, step))
    with pytest.warns(UserWarning, match="read as a drive") as warned:
        plan = read(f"t_s,speed_kmh\n{rows}", "drive.csv")
    assert plan.commanded == (step == 2)
    assert any("taken as driven; --expected" in str(w.message) for w in warned) == plan.commanded


def test_a_comma_between_semicolons_is_a_decimal_sign(read):
    """As thousands, 2.75 km in 2.2 min were 2750 km in 37 h."""
    legs = read("length_km;duration_min;slope (%)\n1,250;1,000;5,006\n1,500;1,200;5,006\n")
    assert legs.length.tolist() == [1250.0, 1500.0] and legs.duration.tolist() == [60.0, 72.0]
    assert legs.climb.sum() == pytest.approx(137.5, abs=0.1)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(1, 1), (2, 2), (3, 3)], "the last leg is as long as all before"),
        ([(1, 1), (2, 2), (3, 3), (4, 4)], "as if counted from the start"),
        ([(1, 1), (1, 1)], None),
        ([(1, 1), (2, 2), (3, 3.5)], None),
    ],
)
def test_legs_that_seem_counted_twice_are_said(rows, said):
    columns = dict(zip(("length_km", "duration_min"), zip(*rows, strict=True), strict=True))
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        ev.forecast(columns)
    texts = [str(warning.message) for warning in warned]
    assert bool(texts) == bool(said) and all(said in text for text in texts)


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
        ("length_km,speed_kmh\n1,50\n1,0\n", "speed is 0 at leg 2"),
        ("length_km,speed_kmh\n1,-50\n1,30\n", "speed is negative at leg 1"),
        (
            "length_km,speed_kmh\n-1,50\n1,30\n",
            "(length|duration) is (negative|not above 0) at leg 1",
        ),
        ("t_s,speed_mps\n0,0\n5,9\n5,9\n", "time does not rise at point 3"),
        ("length_km,speed_kmh,grade_percent\n1,50,4\n1,50,5006\n", "no road is so steep at row 2"),
        ("length_m,duration_s\n1.2,150\n12,480\n", "lengths in m, durations in s"),
        ("length_m,duration_s,speed_kmh\n12000,480,900\n", "contradict each other at leg 1"),
        (
            "length_m,duration_s\n900,sixty\n",
            "duration_s: 'sixty' in row 1 is not a number",
        ),
        ("length_m,speed_kmh\n" + "".join(f"{i}000,60\n" for i in range(1, 9)), "from the start"),
        ("length_m,duration_s\n" + "".join(f"900,{60 * i}\n" for i in range(8)), "from the start"),
        ("t_s,speed_mps,elevation_m\n0,0,5\n9,9,-9999\n20,9,6\n", "no road is at .* row 2"),
        ("length_m,speed_kmh,elevation_m\n900,50,5\n900,50,32767\n", "no road is at .* row 2"),
        ("length_m,duration_s\n" + 50_001 * "9,1\n", "50001 points are more than 50000"),
    ],
)
def test_wrong_legs_are_refused_with_the_reason(read, table, reason):
    with pytest.raises(
        InputError if "not a number" in reason else PlanError, match=reason
    ) as error:
        read(table, "legs.csv")
    assert "legs.csv: " in str(error.value)


def test_python_takes_the_same_columns_and_files(tmp_path):
    columns = {"length_m": [1200, 12000, 3000], "duration_s": [150, 480, 240],
               "climb_m": [10, 100, np.nan]}  # fmt: skip
    (tmp_path / "legs.csv").write_text(LEGS)
    frame = pd.DataFrame(columns)
    for plan in (columns, frame, pl.from_pandas(frame)):
        pd.testing.assert_frame_equal(ev.forecast(tmp_path / "legs.csv"), ev.forecast(plan))
    edges = columns | {"climb_m": [10, 100, 0]}
    of_polars, of_dict = (ev.edge_energies(each).table for each in (pl.DataFrame(edges), edges))
    pd.testing.assert_frame_equal(of_polars, of_dict)
    speeds = {"t_s": [0.0, 400.0], "speed_mps": [20.0, 20.0]}
    empty = speeds | {"elevation_m": [None, np.nan]}
    pd.testing.assert_frame_equal(ev.forecast(empty), ev.forecast(speeds))
    with pytest.raises(PlanError, match="elevation is not finite at point 2"):
        ev.forecast(speeds | {"elevation_m": [500.0, None]})
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


def test_a_chosen_unit_holds_for_a_plan_of_our_names_too(tmp_path):
    (tmp_path / "plan.csv").write_text(SPEEDS)
    plan = read_plan(tmp_path / "plan.csv", None, ReadOptions(columns=("speed=speed_mps:km/h",)))
    assert plan.distance[-1] == pytest.approx(8050.0 / 3.6)


@pytest.mark.parametrize(
    "plan",
    [
        {"length_km": [400.0], "speed_kmh": [90.0]},
        {"length_km": [10, 0, 7.3], "duration_min": [9, 5, 8], "climb_m": [90, 0, -50]},
        {"t_s": [0, 15, 400, 420], "speed_mps": [0, 20, 20, 0], "elevation_m": [0, 0, 60, 60]},
    ],
)
@pytest.mark.parametrize("every", [250.0, 1000.0, 1e6])
def test_rows_may_be_so_many_metres_apart(plan, every):
    """Of the road, as a finer plan has them; the last is the end."""
    rows = ev.forecast(plan, "bmw_i3", charge_pct=90.0, every_m=every)
    whole = ev.forecast(plan, "bmw_i3", charge_pct=90.0)
    assert rows.columns.tolist() == whole.columns.tolist()
    kept = [name for name in rows if name != "power_w"]
    assert rows[kept].iloc[-1].to_dict() | {"speed_mps": 0.0} == pytest.approx(
        whole[kept].iloc[-1].to_dict() | {"speed_mps": 0.0}, rel=1e-9
    )
    steps = np.diff(rows["distance_m"])
    assert steps[:-1] == pytest.approx(every) and 0.0 < steps[-1] <= every * (1.0 + 1e-6)
    assert (np.diff(rows.index) > 0.0).all() and (np.diff(rows["energy_j"]) > -5e5).all()
    if whole["distance_m"].iloc[-1] == 400e3 and every < 1e4:
        cut = ev.forecast({"length_km": 40 * [10.0], "speed_kmh": 40 * [90.0]}, "bmw_i3",
                          charge_pct=90.0)  # fmt: skip
        at = rows.iloc[np.searchsorted(rows["distance_m"], cut["distance_m"] - 1e-3)]
        for name in ("energy_j", "sigma_j", "charge_pct", "charge_sigma_pct"):
            assert at[name].to_numpy() == pytest.approx(cut[name].to_numpy(), rel=1e-8, abs=1e-6)


def test_rows_that_are_too_many_are_refused():
    for every in (0.0, -1.0, 1e-3):
        with pytest.raises(PlanError, match="at most 50000 rows"):
            ev.forecast({"length_km": [400.0], "speed_kmh": [90.0]}, every_m=every)
