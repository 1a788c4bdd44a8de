import json

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import pytest
from rich.cells import cell_len

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.common.json_text import json_text
from evpinn_ros.common.units import US
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.nodes.live.data import NOTHING, LiveData
from evpinn_ros.nodes.live.screen import as_json, plain_line, problem_lines, screen
from evpinn_ros.topics.messages import Level, diagnostics, named_vector
from evpinn_ros.topics.readings import battery_message, speed_message


def lines(data, now, width, height):
    return [line.rstrip() for line in screen(data, now, width, height).plain.splitlines()]


TEXT = st.text(max_size=60)
NUMBER = st.floats(allow_nan=False, allow_infinity=False)


@given(
    width=st.integers(1, 130),
    height=st.integers(0, 40),
    values=st.lists(NUMBER, min_size=6, max_size=6),
    power=NUMBER,
    statuses=st.lists(st.tuples(st.sampled_from(Level), TEXT, TEXT, TEXT), max_size=6),
)
@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
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
    statuses_sent = [
        (
            f"/ev/estimator: {name}",
            level,
            text,
            {"state.eta": state_, "seen.0_30_kmh_steady": state_},
        )
        for level, name, text, state_ in statuses
    ]
    statuses_sent += [
        ("/ev/estimator: estimate", Level.OK, text, {"state.mu": text})
        for _, _, text, _ in statuses
    ]
    message = diagnostics(new_message, 10**9, statuses_sent)
    data.take(topics.DIAGNOSTICS, message, 1.0)
    drawn = screen(data, 1.0, width, height).plain
    rows = drawn.split("\n") if drawn else []
    assert len(rows) <= height
    assert all(cell_len(row) <= width for row in rows)
    assert all(char.isprintable() or char == "\n" for char in drawn)
    assert "\n" not in plain_line(data, 1.0)
    assert all(line.isprintable() for line in problem_lines(data, 1.0))


def test_miles_in_place_of_kilometres_in_view_and_line():
    data = LiveData(units=US)
    names = ["distance_to_empty", "distance_lower", "distance_upper"]
    ranges = named_vector(new_message, 10**9, names, [160_934.4, 80_467.2, 321_868.8])
    data.take(topics.ENERGY_RANGE, ranges, 1.0)
    data.take(topics.SPEED, speed_message(new_message, SpeedReading(10**9, 44.704)), 1.0)
    for text in (screen(data, 1.0, 130, 40).plain, plain_line(data, 1.0)):
        assert "100.0 mph" in text and "range 100 mi (50-200)" in text and "Wh/mi" in text
        assert "km" not in text


def test_what_is_drawn_has_one_sign_on_screen(well):
    """Current and power of a car that brakes are both negative, and both are said to be drawn."""
    data = well(110.0)
    braking = BatteryReading(110 * 10**9, 352.0, 80.0)  # of BatteryState: + charges
    data.take(topics.BATTERY, battery_message(new_message, braking), 110.0)
    power = named_vector(new_message, 110 * 10**9, ["power"], [-28160.0])
    data.take(topics.POWER_MEASURED, power, 110.0)
    drawn = lines(data, 110.0, 80, 24)
    assert "-80.0 A drawn" in drawn[0]
    assert any(line.startswith("kW drawn  measured -28.2") for line in drawn)


def test_charge_is_that_of_the_battery_until_the_node_projects_it():
    data = LiveData()
    reading = BatteryReading(10**9, 352.0, 1.0, 0.5)
    data.take(topics.BATTERY, battery_message(new_message, reading), 1.0)
    assert data.charge() == 0.5
    message = named_vector(new_message, 10**9, ["state_of_charge"], [0.49])
    data.take(topics.ENERGY_RANGE, message, 1.0)
    assert data.charge() == 0.49
    assert "range from 10 km on" in lines(data, 1.0, 80, 24)[1]  # what it costs is not known yet


def test_a_script_reads_the_same(well):
    document = json.loads(json_text(as_json(well(160.0), 160.0)))
    assert (document["speed_mps"], document["voltage_v"], document["current_a"]) == (
        12.5,
        352.0,
        -41.5,
    )
    assert document["power_w"]["predicted"] == {"value": 13900.0, "std": 1200.0}
    assert document["power_w"]["measured"] == {"value": 14600.0, "std": None}
    assert document["energy_j"]["consumed"] == 3.96e6
    assert document["breakdown_j"]["tyres"] == {"value": 1.44e6, "std": 0.18e6}
    assert (document["receiving"], document["state_of_charge"], document["wh_per_km"]) == (
        True,
        0.614,
        163.0,
    )
    assert document["parameters"]["mass"] == {
        "value": 1847.0, "std": pytest.approx(92.35), "prior_share": 0.25,
        "lower": 923.5, "upper": 3694.0, "state": None,
    }  # fmt: skip
    assert document["parameters"]["eta"]["state"] == "valid" and document["problems"] == []


def test_a_script_reads_that_nothing_is_known_and_what_fell_silent(well):
    document = json.loads(json_text(as_json(LiveData(), 0.0)))
    assert (
        document["speed_mps"]
        is document["voltage_v"]
        is document["parameters"]["eta"]["value"]
        is None
    )
    assert document["problems"][0]["level"] == "warn" and document["energy_j"] == {}
    assert document["receiving"] is False and document["problems"][0]["text"] == NOTHING
    later = json.loads(json_text(as_json(well(160.0), 170.0)))
    assert later["speed_mps"] is later["power_w"]["measured"]["value"] is None
    assert {"error"} == {problem["level"] for problem in later["problems"]}
