"""`evpinn export rmf`: lines that a fleet adapter of Open-RMF reads."""

import pytest
import yaml

from test.robots import learned, robot

pytestmark = pytest.mark.slow

# What a fleet adapter reads of its config.yaml, all of them numbers.
KEYS = {
    "battery_system": {"voltage", "capacity", "charging_current"},
    "mechanical_system": {"mass", "moment_of_inertia", "friction_coefficient"},
    "ambient_system": {"power"},
    "tool_system": {"power"},
}


@pytest.mark.nightly
def test_the_learned_robot_for_a_fleet_adapter(evpinn, tmp_path):
    learned(1).save(tmp_path / "robot.json")
    given = ("--capacity", 25, "--charging-current", 5, "--radius", 0.4, "--tool", 12.5)
    ended = evpinn("export", "rmf", "robot.json", *given, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    fleet = yaml.safe_load(ended.stdout)["rmf_fleet"]
    assert {name: set(of) for name, of in fleet.items()} == KEYS
    values = [value for of in fleet.values() for value in of.values()]
    assert all(isinstance(value, float) and value > 0.0 for value in values)
    assert fleet["battery_system"] == {"voltage": 25.6, "capacity": 25.0, "charging_current": 5.0}
    assert fleet["tool_system"]["power"] == 12.5
    mechanics, ours = fleet["mechanical_system"], robot()
    force = mechanics["mass"] * mechanics["friction_coefficient"] * 9.81
    wheels = ours.MASS * 9.81 * ours.ROLLING + ours.GEAR_LOSS
    assert force == pytest.approx(wheels / ours.INVERTER, rel=0.3)
    assert mechanics["moment_of_inertia"] == pytest.approx(0.08 * mechanics["mass"], rel=1e-3)
    assert fleet["ambient_system"]["power"] == pytest.approx(ours.COMPUTER, rel=0.15)


def test_what_is_not_known_of_the_battery_is_asked_for(evpinn, tmp_path):
    learned(1, minutes=0.5).save(tmp_path / "robot.json")
    ended = evpinn("export", "rmf", "robot.json", cwd=tmp_path)
    assert (ended.returncode, ended.stdout) == (1, "")
    asked = "the capacity of the battery of mobile_robot is not known: give --capacity"
    assert asked in ended.stderr
