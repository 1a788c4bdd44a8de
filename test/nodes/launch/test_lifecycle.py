"""Managed nodes, driven by `ros2 lifecycle`."""

from collections import deque
import json

from lifecycle_msgs.srv import GetState
import pytest
from rclpy.lifecycle import TransitionCallbackReturn

from evpinn_ros import topics
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import Half, StateClaim
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.topics.messages import stamp_ns
from test.waiting import wait_until

RUN, UNDER_EV = ("run", "evpinn_ros"), ("--ros-args", "-r", "__ns:=/ev", "-p", "managed:=true")


def state_of(bench, name):
    return bench.ask(GetState, f"/ev/{name}/get_state").current_state.label


@pytest.mark.nightly
def test_a_managed_estimator_works_while_it_is_active(ros2, bench, urban, tmp_path):
    powers, said = bench.hear(topics.POWER_PREDICTED), bench.hear(topics.DIAGNOSTICS)
    state = tmp_path / "car.json"
    options = ("-p", "vehicle:=tesla_model_3_lr", "-p", f"state_file:={state}")
    drive = deque((topic, message) for topic, _, message in urban(360.0))

    def send(count):
        for _ in range(count):
            bench.send(*drive.popleft())

    def to(transition):
        answer = ros2.ask("lifecycle", "set", "/ev/estimator", transition)
        assert "Transitioning successful" in answer, answer

    with ros2.running(*RUN, "estimator", *UNDER_EV, *options):
        bench.pump(lambda: said)
        assert "managed node that is not active" in said[-1].status[0].message
        assert state_of(bench, "estimator") == "unconfigured"
        to("configure")
        send(40)
        assert not powers
        to("activate")
        bench.pump(lambda: len(powers) > 20 or send(1))
        assert not state.exists()
        to("deactivate")
        assert json.loads(state.read_text())["learned"]["vehicle"] == "tesla_model_3_lr"
        first = stamp_ns(drive[0][1])
        send(40)
        assert all(stamp_ns(power) < first for power in powers)  # those were on the way


@pytest.mark.nightly
def test_a_wrong_parameter_fails_the_transition_and_a_right_one_mends_it(ros2, bench, tmp_path):
    """No process ends; what configure read is read anew after a cleanup."""
    name, state = "/ev/energy", tmp_path / "kept.json"

    def to(transition):
        return ros2.ask("lifecycle", "set", name, transition)

    with ros2.running(*RUN, "energy", *UNDER_EV, "-p", "vehicle:=no_such_car") as process:
        assert "Transitioning successful" not in to("configure")
        assert state_of(bench, "energy") == "unconfigured" and "no_such_car" in process.output
        ros2.ask("param", "set", name, "vehicle", "bmw_i3")
        assert "successful" in to("configure") and state_of(bench, "energy") == "inactive"
        refused = ros2.run("param", "set", name, "energy_file", str(state))
        assert "fixed until the node is cleaned up" in refused
        to("cleanup")
        ros2.ask("param", "set", name, "energy_file", str(state))
        for transition in ("configure", "activate", "deactivate"):
            assert "successful" in to(transition)
        assert json.loads(state.read_text())["energy"]["vehicle"] == "bmw_i3"


def test_a_file_that_can_never_be_written_fails_the_transition(ros2, bench, tmp_path):
    (tmp_path / "file").write_text("in the way")
    for path, why in ((tmp_path / "file" / "car.json", "Not a directory"), (tmp_path, "a folder")):
        with ros2.running(*RUN, "energy", *UNDER_EV, "-p", f"energy_file:={path}") as process:
            answer = ros2.ask("lifecycle", "set", "/ev/energy", "configure")
            assert "Transitioning successful" not in answer
            assert "waits to be configured" in process.output
            assert f"configure: {path}: cannot be written: {why}" in process.output


def test_a_file_into_which_another_process_learns_fails_the_transition(bench, tmp_path):
    path = tmp_path / "car.json"
    node = bench.start(EnergyNode, managed=True, energy_file=str(path))
    with StateClaim(path):
        assert node.trigger_configure() is TransitionCallbackReturn.FAILURE
        assert "another evpinn learns into this file" in bench.diagnosis(node)["lifecycle"][1]
    for _ in range(2):
        assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
        with StateClaim(path, [Half.LEARNED]), pytest.raises(InputError, match="another evpinn"):
            StateClaim(path)
        assert node.trigger_cleanup() is TransitionCallbackReturn.SUCCESS
    with StateClaim(path):
        pass


def test_endpoints_come_with_configure_and_go_with_cleanup(bench):
    """Twice over, in one process; nothing of the first life is left in the second."""
    node = bench.start(EnergyNode, managed=True)
    publishers = {topic.under(): 1 for topic in (topics.ENERGY_STATE, topics.FORECAST)}

    def offered():
        return {name: bench.node.count_publishers(name) for name in publishers}

    for _ in range(2):
        bench.pump(lambda: not any(offered().values()))
        assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
        bench.pump(lambda: offered() == publishers)
        assert node.trigger_activate() is TransitionCallbackReturn.SUCCESS
        assert bench.diagnosis(node)["meter"][1] == "waiting for power/smoothed"
        assert node.trigger_deactivate() is TransitionCallbackReturn.SUCCESS
        assert "managed node that is not active" in bench.diagnosis(node)["meter"][1]
        assert node.trigger_cleanup() is TransitionCallbackReturn.SUCCESS
        assert "lifecycle" in bench.diagnosis(node)


def test_a_fault_of_ours_leads_to_where_the_node_can_be_configured_anew(bench, monkeypatch):
    node = bench.start(EnergyNode, managed=True)
    monkeypatch.setattr(node, "configure", lambda: 1 / 0)
    assert node.trigger_configure() is TransitionCallbackReturn.ERROR
    assert node.health().fault == "configure: ZeroDivisionError"
    monkeypatch.undo()
    assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
    bench.faulty.add(node)


def test_a_launch_of_managed_nodes_ends_with_all_of_them_active(ros2, bench):
    given = ("vehicle:=tesla_model_3_lr", "can_interface:=virtual", "can_channel:=none")
    with ros2.running("launch", "evpinn_ros", "managed.launch.py", *given) as launch:
        for name in ("estimator", "energy", "can_bridge"):
            began = f"[ev.{name}]: "  # the line that each logs once it works
            wait_until(lambda began=began: began in launch.output, report=lambda: launch.output)
            assert state_of(bench, name) == "active"
