"""Discovery by the rules of Home Assistant: classes, their units and what statistics they take."""

from evpinn_ros.extras.bridges.sensors import SENSORS, discovery

# developers.home-assistant.io, "Sensor entity": units and state classes of the classes we use.
CLASSES = {
    "power": ({"W"}, {"measurement", None}),
    "energy": ({"kWh"}, {"total", "total_increasing", None}),
    "distance": ({"km"}, {"measurement", None}),
    "battery": ({"%"}, {"measurement"}),
    "weight": ({"kg"}, {"measurement", None}),
}
FOUND = dict(discovery("homeassistant", "evpinn/1", "evpinn/status", "1", "Tesla Model 3"))


def test_each_class_has_its_units_and_statistics() -> None:
    for topic, content in FOUND.items():
        kind = content.get("device_class")
        if kind is not None:
            units, states = CLASSES[kind]
            assert content["unit_of_measurement"] in units, topic
            assert content.get("state_class") in states, topic


def test_the_energy_dashboard_takes_what_was_drawn_and_recovered() -> None:
    taken = {
        content["name"]
        for content in FOUND.values()
        if content.get("device_class") == "energy" and "state_class" in content
    }
    assert taken == {"Energy drawn", "Energy recovered"}


def test_names_are_unique_and_of_one_device() -> None:
    assert len(FOUND) == len(SENSORS) == len({c["unique_id"] for c in FOUND.values()})
    assert len({c["name"] for c in FOUND.values()}) == len(SENSORS)
    assert {str(c["device"]["identifiers"]) for c in FOUND.values()} == {"['evpinn_1']"}
    for topic, content in FOUND.items():
        assert topic.startswith("homeassistant/sensor/evpinn_1/") and topic.endswith("/config")
        assert content["availability_topic"] == "evpinn/status"
        assert content["state_topic"].startswith("evpinn/1/")
        assert None not in content.values()


def test_a_number_that_is_not_known_is_none() -> None:
    sensor = next(s for s in SENSORS if s.topic == "range/range_km")
    assert sensor.text({"range_km": None}) == sensor.text({}) == "None"
    assert sensor.text({"range_km": float("nan")}) == "None"
    assert sensor.text({"range_km": 316.4}) == "316"
