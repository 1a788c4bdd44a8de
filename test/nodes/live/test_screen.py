import json
import math

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import pytest
from rich.cells import cell_len

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.common.json_text import json_text
from evpinn_ros.core.signals.readings import BatteryReading
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.nodes.live.data import NOTHING, LiveData
from evpinn_ros.nodes.live.screen import as_json, plain_line, problem_lines, screen
from evpinn_ros.topics.messages import Level, diagnostics, named_vector
from evpinn_ros.topics.readings import battery_message


def lines(data, now, width, height):
    return [line.rstrip() for line in screen(data, now, width, height).plain.splitlines()]


def without_dots(found):
    """The screen but for the lines of power."""
    return [line for line in found if not any("⠀" <= char <= "⣿" for char in line)]


def test_80_by_24_shows_everything(well):
    found = lines(well(160.0), 160.0, 80, 24)
    assert len(found) == 24
    assert without_dots(found) == [
        " evpinn  learning: 3 of 4 updates accepted       352 V  41.5 A drawn  45.0 km/h",
        "charge  61 %  range 245 km (210-290)  163 Wh/km  used 1100 Wh  regained - Wh",
        "Wh went to  tyres 400+-50  air 200+-30  drivetrain 180+-20  slope -30+-10",
        "            unexplained 5+-10",
        "      meaning          value  1-sigma             bounds prior  data state",
        "eta   motor            0.912    0.046     0.456 .. 1.824  25 %  87 % valid",
        "mu    regeneration     0.640    0.032     0.320 .. 1.280  25 %     - -",
        "mass  all aboard     1847 kg    92 kg        924 .. 3694  25 %     - -",
        "c_rr  rolling        0.00920  0.00046 0.00460 .. 0.01840  25 %     - -",
        "c_d   drag            0.2312   0.0116   0.1156 .. 0.4624  25 %     - -",
        "p_aux auxiliary        412 W     21 W         206 .. 824  25 %     - -",
        "kW drawn  measured 14.6  predicted 13.9 +- 1.2  89 % in band  74 s",
        "samples km/h     <30     <60     <90    <120    >120    speed 10.0/s",
        "braking          ▁12       -       -       -       -    battery 10.0/s",
        "steady             -       -       -       -   █3.4k    predicted 10.0/s",
        "accelerating       -       -       -       -       -    parameters 10.0/s",
    ]


def test_60_by_20_leaves_out_what_can_be_missed(well):
    data = well(160.0)
    warning = ("/ev/energy: meter", Level.WARN, "predicting: no power/measured", {})
    data.take(topics.DIAGNOSTICS, diagnostics(new_message, 10**9, [warning]), 160.0)
    found = lines(data, 160.0, 60, 20)
    assert len(found) == 19  # a row that both lines of power cannot share
    assert without_dots(found) == [
        " evpinn  learning: 3 of 4 up 352 V  41.5 A drawn  45.0 km/h",
        "charge  61 %  range 245 km (210-290)  163 Wh/km  used 1100 …",
        "Wh went to  tyres 400+-50  air 200+-30  drivetrain 180+-20",
        "            slope -30+-10  unexplained 5+-10",
        "          value  1-sigma prior  data state",
        "eta       0.912    0.046  25 %  87 % valid",
        "mu        0.640    0.032  25 %     - -",
        "mass    1847 kg    92 kg  25 %     - -",
        "c_rr    0.00920  0.00046  25 %     - -",
        "c_d      0.2312   0.0116  25 %     - -",
        "p_aux     412 W     21 W  25 %     - -",
        "kW drawn  measured 14.6  predicted 13.9 +- 1.2  89 % in ban…",
        "samples km/h   <30   <60   <90  <120  >120 speed 10.0/s",
        "braking        ▁12     -     -     -     - battery 10.0/s",
        "steady           -     -     -     - █3.4k predicted 10.0/s",
        "accelerating     -     -     -     -     - parameters 10.0/s",
        "! energy: meter: predicting: no power/measured",
    ]


def test_nothing_heard_is_a_screen_too():
    found = lines(LiveData(), 0.0, 80, 24)
    assert found[0] == f" evpinn  no nodes{'- km/h':>62}"
    assert found[-1] == f"! {NOTHING}"
    assert found[1:3] == [
        "charge  -  range -  - Wh/km  used - Wh  regained - Wh",
        "Wh went to  -",
    ]
    assert "eta   motor                -        -                  -     -     - -" in found


@pytest.mark.parametrize(
    ("height", "kept"),
    [
        (1, "evpinn"),
        (2, "! nothing"),
        (3, "charge"),
        (4, "Wh went"),
        (11, "p_aux"),
        (14, "kW drawn"),
        (18, "steady"),
    ],
)
def test_the_weightiest_is_kept_when_there_is_little_room(height, kept):
    assert any(kept in line for line in lines(LiveData(), 0.0, 80, height))
    assert not any(kept in line for line in lines(LiveData(), 0.0, 80, height - 1))


TEXT = st.text(max_size=60)
NUMBER = st.floats(allow_nan=False, allow_infinity=False)


@given(
    width=st.integers(1, 130),
    height=st.integers(0, 40),
    values=st.lists(NUMBER, min_size=6, max_size=6),
    power=NUMBER,
    statuses=st.lists(st.tuples(st.sampled_from(Level), TEXT, TEXT, TEXT), max_size=6),
)
@settings(max_examples=50, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_never_wider_or_higher_than_asked(width, height, values, power, statuses):
    data = LiveData()
    for topic, names, numbers in (
        (topics.PARAMETERS, PARAMETER_NAMES, values),
        (topics.BOUNDS, [f"{name}_lower" for name in PARAMETER_NAMES], values),
        (topics.BOUNDS, [f"{name}_prior_share" for name in PARAMETER_NAMES], values),
        (topics.POWER_MEASURED, ["power"], [power]),
        (topics.ENERGY_STATE, ["consumed"], [power]),
        (topics.ENERGY_BREAKDOWN, ["air", "a\nb", "x" * 90, "slope", "e", "f"], values),
        (topics.ENERGY_RANGE, ["distance_to_empty"], [power]),
    ):
        data.take(topic, named_vector(new_message, 10**9, list(names), numbers), 1.0)
    found = [
        (
            f"/ev/estimator: {name}",
            level,
            text,
            {"state.eta": state_, "seen.0_30_kmh_steady": state_},
        )
        for level, name, text, state_ in statuses
    ]
    found += [
        ("/ev/estimator: estimate", Level.OK, text, {"state.mu": text})
        for _, _, text, _ in statuses
    ]
    message = diagnostics(new_message, 10**9, found)
    data.take(topics.DIAGNOSTICS, message, 1.0)
    drawn = screen(data, 1.0, width, height).plain
    rows = drawn.split("\n") if drawn else []
    assert len(rows) <= height
    assert all(cell_len(row) <= width for row in rows)
    assert all(char.isprintable() or char == "\n" for char in drawn)
    assert "\n" not in plain_line(data, 1.0)
    assert all(line.isprintable() for line in problem_lines(data, 1.0))


def test_a_plain_line_says_the_same(well):
    assert plain_line(well(110.0), 110.0) == (
        "45.0 km/h; charge  61 %  range 245 km (210-290)  163 Wh/km  used 1100 Wh  regained - Wh;"
        " measured 14.6 kW drawn; predicted 13.9 +- 1.2 kW drawn; Wh went to tyres 400+-50,"
        " air 200+-30, drivetrain 180+-20, slope -30+-10, unexplained 5+-10;"
        " eta 0.912 +- 0.046 valid; mu 0.640 +- 0.032; mass 1847 kg +- 92 kg;"
        " c_rr 0.00920 +- 0.00046; c_d 0.2312 +- 0.0116; p_aux 412 W +- 21 W"
    )


def test_what_rounds_to_nothing_has_no_sign(well):
    data = well(110.0)
    parts = ["air", "slope"], [-700.0, -7200.0], [3600.0, 3600.0]
    data.take(topics.ENERGY_BREAKDOWN, named_vector(new_message, 110 * 10**9, *parts), 110.0)
    assert "Wh went to slope -2+-1, air 0+-1" in plain_line(data, 110.0)


def test_a_plain_line_knows_what_is_not_known():
    assert plain_line(LiveData(), 0.0) == NOTHING
    data = LiveData()
    data.take(topics.DIAGNOSTICS, diagnostics(new_message, 10**9, []), 0.0)
    assert plain_line(data, 0.0).startswith("- km/h; charge  -  range -  - Wh/km  used")


def test_what_is_drawn_has_one_sign_on_screen(well):
    """Current and power of a car that brakes are both negative, and both are said to be drawn."""
    data = well(110.0)
    braking = BatteryReading(110 * 10**9, 352.0, 80.0)  # of BatteryState: + charges
    data.take(topics.BATTERY, battery_message(new_message, braking), 110.0)
    power = named_vector(new_message, 110 * 10**9, ["power"], [-28160.0])
    data.take(topics.POWER_MEASURED, power, 110.0)
    found = lines(data, 110.0, 80, 24)
    assert "-80.0 A drawn" in found[0]
    assert any(line.startswith("kW drawn  measured -28.2") for line in found)


def test_consumption_of_the_first_kilometre_is_shown(well):
    data = well(110.0)
    for metres, shown in ((60.0, math.nan), (550.0, 2000.0)):
        trip = named_vector(new_message, 110 * 10**9, ["distance_trip"], [metres])
        data.take(topics.ENERGY_CONSUMPTION, trip, 110.0)
        assert data.consumption() == pytest.approx(shown, nan_ok=True)


def test_charge_is_that_of_the_battery_until_the_node_projects_it():
    data = LiveData()
    reading = BatteryReading(10**9, 352.0, 1.0, 0.5)
    data.take(topics.BATTERY, battery_message(new_message, reading), 1.0)
    assert data.charge() == 0.5
    message = named_vector(new_message, 10**9, ["state_of_charge"], [0.49])
    data.take(topics.ENERGY_RANGE, message, 1.0)
    assert data.charge() == 0.49
    assert "range from 10 km on" in lines(data, 1.0, 80, 24)[1]  # what it costs is not known yet


def test_what_others_write_cannot_move_the_cursor(well):
    data = well(110.0)
    evil = ("/ev/estimator: x", Level.ERROR, "\x1b[2J\x1b]0;owned\a\r\nhello", {})
    data.take(topics.DIAGNOSTICS, diagnostics(new_message, 10**9, [evil]), 110.0)
    for text in (*lines(data, 110.0, 80, 24), *problem_lines(data, 110.0)):
        assert text.isprintable()


def test_values_beyond_reason_stay_in_their_columns():
    data = LiveData()
    names, huge = list(PARAMETER_NAMES), 6 * [-1.7e308]
    data.take(topics.PARAMETERS, named_vector(new_message, 10**9, names, huge), 1.0)
    assert math.isclose(data.parameters()[0].value, -1.7e308)
    row = next(line for line in lines(data, 1.0, 80, 24) if line.startswith("eta"))
    assert row == "eta   motor        -1.7e+308        -                  -     -     - -"


def test_a_script_reads_the_same(well):
    found = json.loads(json_text(as_json(well(160.0), 160.0)))
    assert (found["speed_mps"], found["voltage_v"], found["current_a"]) == (12.5, 352.0, -41.5)
    assert found["power_w"]["predicted"] == {"value": 13900.0, "std": 1200.0}
    assert found["power_w"]["measured"] == {"value": 14600.0, "std": None}
    assert found["energy_j"]["consumed"] == 3.96e6
    assert found["breakdown_j"]["tyres"] == {"value": 1.44e6, "std": 0.18e6}
    assert (found["receiving"], found["state_of_charge"], found["wh_per_km"]) == (
        True,
        0.614,
        163.0,
    )
    assert found["parameters"]["mass"] == {
        "value": 1847.0, "std": pytest.approx(92.35), "prior_share": 0.25,
        "lower": 923.5, "upper": 3694.0, "state": None,
    }  # fmt: skip
    assert found["parameters"]["eta"]["state"] == "valid" and found["problems"] == []


def test_a_script_reads_that_nothing_is_known_and_what_fell_silent(well):
    found = json.loads(json_text(as_json(LiveData(), 0.0)))
    assert found["speed_mps"] is found["voltage_v"] is found["parameters"]["eta"]["value"] is None
    assert found["problems"][0]["level"] == "warn" and found["energy_j"] == {}
    assert found["receiving"] is False and found["problems"][0]["text"] == NOTHING
    later = json.loads(json_text(as_json(well(160.0), 170.0)))
    assert later["speed_mps"] is later["power_w"]["measured"]["value"] is None
    assert {"error"} == {one["level"] for one in later["problems"]}
