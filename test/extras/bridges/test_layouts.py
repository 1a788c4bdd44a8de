"""Topics of TeslaMate, OVMS and mapping files: quantities, units, signs."""

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.extras.bridges.layouts import Measurand, read_layout


def only(layout, topic, payload):
    parsed = layout.parse(topic, payload.encode())
    ((quantity, value),) = parsed.values.items()
    return parsed.car, quantity, pytest.approx(value.value)


def test_teslamate_has_km_per_h_and_whole_kw_positive_when_drawn():
    layout = read_layout("teslamate")
    assert only(layout, "teslamate/cars/1/speed", "36") == ("1", Measurand.SPEED, 10.0)
    assert only(layout, "teslamate/cars/2/power", "-9") == ("2", Measurand.POWER, -9000.0)
    assert only(layout, "teslamate/cars/1/elevation", "70") == ("1", Measurand.ALTITUDE, 70.0)
    charge = only(layout, "teslamate/cars/1/usable_battery_level", "85")
    assert charge == ("1", Measurand.CHARGE, 0.85)


def test_ovms_counts_current_positive_out_of_the_battery():
    """`BatteryState.current` is negative then."""
    layout, base = read_layout("ovms"), "ovms/me/CAR/metric"
    assert only(layout, f"{base}/v/b/current", "12.5") == ("CAR", Measurand.CURRENT, -12.5)
    assert only(layout, f"{base}/v/b/power", "1.5") == ("CAR", Measurand.POWER, 1500.0)
    assert only(layout, f"{base}/v/p/speed", "72") == ("CAR", Measurand.SPEED, 20.0)
    assert only(layout, f"{base}/v/e/on", "no") == ("CAR", Measurand.ASLEEP, 1.0)


def test_what_is_no_number_has_no_value_but_shows_that_the_car_sends():
    for payload in ("", "nan", "inf", "12,5", "1" * 100_000, "\x00"):
        parsed = read_layout("teslamate").parse("teslamate/cars/1/speed", payload.encode())
        assert parsed.values == {}, payload
    assert read_layout("teslamate").parse("teslamate/cars/1/speed", b"\xff\xfe").values == {}
    assert read_layout("teslamate").parse("teslamate/cars/1/geofence", b"Home").car == "1"


def test_a_name_that_would_reach_another_topic_or_file_is_no_car():
    for name in ("..", "a b", "+", "$SYS", "", "x" * 65):
        assert read_layout("teslamate").parse(f"teslamate/cars/{name}/speed", b"1") is None


MAPPING = """
stamp: t
topics:
  garage/{car}/speed: {quantity: speed, scale: 0.44704}
  garage/{car}/state:
    fields:
      amps: {quantity: current, scale: -1}
      volts: {quantity: voltage}
"""


def test_a_mapping_file_reads_plain_payloads_and_fields_of_json(tmp_path):
    path = tmp_path / "topics.yaml"
    path.write_text(MAPPING)
    layout = read_layout(str(path))
    assert set(layout.subscriptions) == {"garage/+/speed", "garage/+/state"}
    assert only(layout, "garage/zoe/speed", "10") == ("zoe", Measurand.SPEED, 4.4704)
    parsed = layout.parse("garage/zoe/state", b'{"amps": 3, "volts": 400, "t": 1700000000.5}')
    assert {of: value.value for of, value in parsed.values.items()} == {
        "current": -3,
        "voltage": 400,
    }
    assert parsed.stamp_ns == 1_700_000_000_500_000_000
    for broken in (b"[1]", b"{", b"7", b'{"amps": "x"}', b"[" * 50_000):
        assert layout.parse("garage/zoe/state", broken).values == {}
    assert layout.parse("garage/zoe/other", b"1") is None


def test_a_mapping_file_names_units_of_any_country(tmp_path):
    path = tmp_path / "topics.yaml"
    path.write_text(
        "stamp: ms\ntopics:\n  a/speed: {quantity: speed, unit: mph}\n"
        "  a/cold: {quantity: temperature, unit: °F}\n  a/soc: {quantity: charge, unit: '%'}\n"
        "  a/kw: {quantity: power, unit: kW, scale: -1}\n"
        "  a/ft: {fields: {up: {quantity: altitude, unit: ft}}}\n"
    )
    layout = read_layout(str(path))
    assert only(layout, "a/speed", "10")[2] == 4.4704
    assert [only(layout, "a/cold", text)[2] for text in ("14", "212")] == [-10.0, 100.0]
    assert only(layout, "a/soc", "85") == ("car", Measurand.CHARGE, 0.85)
    assert only(layout, "a/kw", "-9") == ("car", Measurand.POWER, 9000.0)
    assert only(layout, "a/ft", '{"up": 1000}')[2] == 304.8
    stamped = layout.parse("a/ft", b'{"up": 1, "ms": 1700000000500}')
    assert stamped.stamp_ns == 1_700_000_000_500_000_000


def test_a_mapping_file_says_what_words_mean_and_whether_values_last(tmp_path):
    path = tmp_path / "topics.yaml"
    path.write_text(
        "base: my/{car}/\nnamed: '{namespace}/{car}/'\naround: '#'\ntopics:\n"
        "  ignition: {quantity: asleep, words: {'on': 0}, otherwise: 1}\n"
        "  kw: {quantity: power, unit: kW, scale: -1, step: 0.1}\n"
    )
    layout = read_layout(str(path))
    assert layout.on_change and layout.subscriptions == ("my/+/#",)
    assert [only(layout, "my/zoe/ignition", payload)[2] for payload in ("on", "off")] == [0.0, 1.0]
    (drawn,) = layout.parse("my/zoe/kw", b"-2").values.values()
    assert drawn == (2000.0, pytest.approx(100.0))
    assert layout.parse("my/zoe/some/thing", b"1") == ("zoe", {}, None, "")
    assert read_layout(str(path), "your").subscriptions == ("your/+/#",)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("topics: {a/+: {quantity: speed}}", ":1: a topic has no wildcard but one level"),
        ("topics: {a: {quantity: speed, units: kmh}}", "unknown key 'units'"),
        ("topics: {a: {quantity: asleep, unit: s}}", "units of asleep: none"),
    ],
)
def test_a_wrong_mapping_file_is_refused_with_its_line(tmp_path, text, reason):
    path = tmp_path / "topics.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_layout(str(path))
    assert str(refused.value).startswith(f"{path}:1:") and reason in str(refused.value)
