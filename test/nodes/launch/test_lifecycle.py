"""Managed nodes, driven by `ros2 lifecycle`."""

import json

from evpinn_ros import topics
from evpinn_ros.nodes.factory import message_class, qos_profile


def hear(bench, topic):
    heard: list = []
    kind, qos = message_class(topic.type_name), qos_profile(topic.subscriber_qos)
    bench.node.create_subscription(kind, topic.under(), heard.append, qos)
    return heard


def test_a_managed_estimator_works_while_it_is_active(ros2, bench, urban, tmp_path):
    state, powers, said = tmp_path / "car.json", hear(bench, topics.POWER_PREDICTED), []
    bench.node.create_subscription(
        message_class(topics.DIAGNOSTICS_TYPE), "/diagnostics", said.append, 10
    )
    options = (
        "-p",
        "managed:=true",
        "-p",
        "vehicle:=tesla_model_3_lr",
        "-p",
        f"state_file:={state}",
    )
    drive = [(topic, message) for topic, _, message in urban(20.0)]

    def send(count):
        for topic, message in drive[:count]:
            bench.send(topic, message)
            bench.executor.spin_once(timeout_sec=0.01)
        del drive[:count]

    def seconds(message):
        return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec

    def to(transition):
        answer = ros2.ask("lifecycle", "set", "/ev/estimator", transition)
        assert "Transitioning successful" in answer, answer

    command = ("run", "evpinn_ros", "estimator", "--ros-args", "-r", "__ns:=/ev", *options)
    with ros2.running(*command):
        bench.pump(lambda: said, 30.0)
        assert "managed node that is not active" in said[-1].status[0].message
        send(40)
        assert not powers and "unconfigured" in ros2.ask("lifecycle", "get", "/ev/estimator")
        to("configure")
        to("activate")
        send(120)
        bench.pump(lambda: len(powers) > 20, 20.0)
        assert not state.exists()
        to("deactivate")
        assert json.loads(state.read_text())["learned"]["vehicle"] == "tesla_model_3_lr"
        first = seconds(drive[0][1])
        send(40)
        assert not [power for power in powers if seconds(power) >= first]  # others were on the way


def test_a_managed_bridge_opens_its_bus_when_it_is_activated(ros2, bench):
    said: list = []
    bench.node.create_subscription(
        message_class(topics.DIAGNOSTICS_TYPE), "/diagnostics", said.append, 10
    )

    def text():
        said.clear()
        bench.pump(lambda: said, 20.0)
        return said[-1].status[0].message

    options = ("-p", "managed:=true", "-p", "interface:=slcan", "-p", "channel:=/dev/none")
    options += ("-p", "can_profile:=tesla_model_3")
    command = ("run", "evpinn_ros", "can_bridge", "--ros-args", "-r", "__ns:=/ev", *options)
    with ros2.running(*command):
        assert text().startswith("not opened")
        for transition in ("configure", "activate"):
            ros2.ask("lifecycle", "set", "/ev/can_bridge", transition)
        bench.pump(lambda: "/dev/none" in text(), 20.0)
