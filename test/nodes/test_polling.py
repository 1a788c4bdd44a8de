"""The bridge asks a simulated car: real rclpy, real UDP, and never a frame without leave."""

import os
import time

import can
import pytest
from rcl_interfaces.msg import Log

from evpinn_ros import topics
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.topics.messages import Level

GROUP = "239.74.163.81"
PORT = 21_000 + os.getpid() % 20_000
SPEED, VOLTAGE, CURRENT = load_profile("bmw_i3").requests
BUS = {"interface": "udp_multicast", "channel": GROUP, "bitrate": 0}
OPTIONS = {"bus_options": f"port={PORT} hop_limit=0"}


def open_bus():
    try:
        return can.Bus(GROUP, interface="udp_multicast", port=PORT, hop_limit=0)
    except (OSError, can.CanError) as error:
        pytest.skip(f"no multicast here: {error}")


@pytest.fixture
def i3(simulated_unit):
    return [
        simulated_unit(
            open_bus(), SPEED.address, {SPEED.payload: lambda: [SPEED.echo + b"\x01\xf4"]}
        ),
        simulated_unit(
            open_bus(),
            VOLTAGE.address,
            {
                VOLTAGE.payload: lambda: [VOLTAGE.echo + b"\x8c\xa0"],
                CURRENT.payload: lambda: [CURRENT.echo + (-5000).to_bytes(4, "big", signed=True)],
            },
        ),
    ]


def test_what_the_car_is_asked_is_published(bench, i3):
    node = bench.start(CanBridgeNode, vehicle="bmw_i3", poll=True, **BUS, **OPTIONS)
    bench.listen(topics.SPEED, topics.BATTERY)
    before = time.time()
    bench.pump(lambda: all(len(bench.heard[t]) >= 3 for t in (topics.SPEED, topics.BATTERY)))
    speed, battery = bench.heard[topics.SPEED][0], bench.heard[topics.BATTERY][0]
    assert speed.twist.twist.linear.x == pytest.approx(50 / 3.6)
    assert speed.twist.covariance[0] == pytest.approx((0.1 / 3.6) ** 2 / 12)
    assert (battery.voltage, battery.current) == (pytest.approx(360.0), pytest.approx(-50.0))
    stamp = battery.header.stamp.sec + battery.header.stamp.nanosec * 1e-9
    assert before - 5 < stamp < before + 30
    diagnosis = bench.diagnosis(node)
    assert diagnosis["polling"][:2] == (Level.OK, "asking")
    assert int(diagnosis["polling"][2]["answered"]) >= 9
    assert diagnosis["bus"][:2] == (Level.OK, "receiving")


def test_without_leave_the_bridge_is_silent_and_says_what_to_set(bench, i3):
    with open_bus() as listener:
        node = bench.start(CanBridgeNode, vehicle="bmw_i3", **BUS, **OPTIONS)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            bench.executor.spin_once(timeout_sec=0.02)
        diagnosis = bench.diagnosis(node)
        assert listener.recv(0) is None
    assert not any(unit.asked for unit in i3)
    level, text, _ = diagnosis["polling"]
    assert level == Level.WARN
    assert "bmw_i3" in text and "poll:=true" in text


def test_that_the_car_must_be_asked_is_said(bench):
    open_bus().shutdown()
    lines = []
    bench.node.create_subscription(Log, "/rosout", lambda log: lines.append(log.msg), 1000)
    bench.start(CanBridgeNode, vehicle="bmw_i3", **BUS, **OPTIONS)
    bench.pump(lambda: any("poll:=true" in line for line in lines))


def test_an_experimental_profile_warns(bench):
    open_bus().shutdown()
    node = bench.start(CanBridgeNode, can_profile="vw_meb", poll=True, **BUS, **OPTIONS)
    level, text, _ = bench.diagnosis(node)["polling"]
    assert level == Level.WARN and text == "experimental profile: asking"


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"vehicle": "nissan_leaf"}, "CAN profile 'nissan_leaf' asks nothing"),
        ({"vehicle": "bmw_i3", "log_file": "drive.log"}, "a log cannot be asked"),
        ({"vehicle": "bmw_i3", "bus_options": "listen_only=true"}, "cannot send with listen_only"),
    ],
)
def test_leave_of_no_use_is_refused(bench, parameters, reason):
    with pytest.raises(InputError, match=reason):
        bench.start(CanBridgeNode, poll=True, **parameters)
