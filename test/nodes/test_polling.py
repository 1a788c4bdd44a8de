"""The bridge asks a simulated car: real rclpy, real UDP, and never a frame without leave."""

import time

import can
import pytest

from evpinn_ros import topics
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.topics.messages import Level
from evpinn_ros.topics.node_parameters import bus_options
from test.waiting import HANG_S

SPEED, VOLTAGE, CURRENT = load_profile("bmw_i3").requests


@pytest.fixture
def i3(simulated_unit, can_bus):
    """Two control units of the car, each with a bus of its own."""
    _, options = can_bus
    speed = {SPEED.payload: lambda: [SPEED.echo + b"\x01\xf4"]}
    battery = {
        VOLTAGE.payload: lambda: [VOLTAGE.echo + b"\x8c\xa0"],
        CURRENT.payload: lambda: [CURRENT.echo + (-5000).to_bytes(4, "big", signed=True)],
    }
    units = ((SPEED.address, speed), (VOLTAGE.address, battery))
    return [simulated_unit(another(options), *unit) for unit in units]


def another(options):
    """A bus beside the one that a bridge of these options joins."""
    kind, channel = options["interface"], options["channel"]
    return can.Bus(channel, interface=kind, **bus_options(options["bus_options"]))


def test_what_the_car_is_asked_is_published(bench, i3, can_bus):
    node = bench.start(CanBridgeNode, vehicle="bmw_i3", poll=True, **can_bus[1])
    bench.listen(topics.SPEED, topics.BATTERY)
    before = time.time()
    bench.pump(lambda: all(len(bench.heard[t]) >= 3 for t in (topics.SPEED, topics.BATTERY)))
    speed, battery = bench.heard[topics.SPEED][0], bench.heard[topics.BATTERY][0]
    assert speed.twist.twist.linear.x == pytest.approx(50 / 3.6)
    assert speed.twist.covariance[0] == pytest.approx((0.1 / 3.6) ** 2 / 12)
    assert (battery.voltage, battery.current) == (pytest.approx(360.0), pytest.approx(-50.0))
    stamp = battery.header.stamp.sec + battery.header.stamp.nanosec * 1e-9
    assert before - 5 < stamp < time.time()
    assert int(bench.diagnosis(node)["polling"][2]["answered"]) >= 9
    for part, text in (("polling", "asking"), ("bus", "receiving")):
        bench.pump(lambda p=part, t=text: bench.diagnosis(node)[p][:2] == (Level.OK, t))


def test_without_leave_the_bridge_is_silent_and_says_what_to_set(bench, i3, can_bus):
    listener, options = can_bus
    lines = bench.log_lines()
    node = bench.start(CanBridgeNode, vehicle="bmw_i3", **options)
    bench.pump(lambda: any("poll:=true" in line for line in lines))
    bench.await_reports(node, 2)
    diagnosis = bench.diagnosis(node)
    with another(options) as bus:
        bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    assert listener.recv(HANG_S).arbitration_id == 0x7FF  # nothing came before it
    assert not any(unit.asked for unit in i3)
    level, text, _ = diagnosis["polling"]
    assert level == Level.WARN
    assert "bmw_i3" in text and "poll:=true" in text


def test_an_experimental_profile_warns(bench, can_bus):
    node = bench.start(CanBridgeNode, can_profile="vw_meb", poll=True, **can_bus[1])
    level, text, _ = bench.diagnosis(node)["polling"]
    assert level == Level.WARN and text == "experimental profile: asking"


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"vehicle": "nissan_leaf"}, "CAN profile 'nissan_leaf' defines no requests"),
        ({"vehicle": "bmw_i3", "log_file": "drive.log"}, "a log answers no requests"),
        (
            {"vehicle": "bmw_i3", "bus_options": "listen_only=true"},
            "listen_only in bus_options forbids sending",
        ),
    ],
)
def test_leave_of_no_use_is_refused(bench, parameters, reason):
    with pytest.raises(InputError, match=reason):
        bench.start(CanBridgeNode, poll=True, **parameters)
