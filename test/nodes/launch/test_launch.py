"""Every launch file, started by the real `ros2 launch`: its nodes do their work and end well."""

from collections.abc import Callable
import itertools
import json
from operator import itemgetter
import os
from pathlib import Path
import re
import signal

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import pytest
import rclpy
from std_srvs.srv import Trigger

from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.core.estimation.state_file import read_state
from evpinn_ros.nodes.factory import message_class
from evpinn_ros.nodes.typed import TYPED
from test.conftest import ROOT
from test.nodes.processes import add_messages

LAUNCH = ("launch", "evpinn_ros")
GUIDE = ROOT / "docs" / "guides" / "two_cars.md"
SECONDS = 40.0  # of a bundled drive


def statuses(said, node):
    """Statuses of a node of the car under /ev, the newest last."""
    return [s for m in said for s in m.status if s.name.startswith(f"/ev/{node}:")]


def play(bench, namespace=topics.NAMESPACE, listeners=2):
    """Let the bridge of a car play its log, once all who shall hear the speed do."""
    speed, service = topics.SPEED.under(namespace), f"{namespace}/can_bridge/change_state"
    bench.pump(lambda: bench.node.count_subscribers(speed) >= listeners)
    for number in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        bench.ask(ChangeState, service, transition=Transition(id=number))
        bench.pump(lambda: bench.node.count_publishers(speed))


def numbers(message):
    return dict(zip(message.name, message.position, strict=True))


@pytest.fixture
def car(can_log, tmp_path) -> Callable[..., Path]:
    """Writes the parameters of a car whose bus is the CAN log of a bundled drive (`play`)."""

    def write(bag="urban", seconds=SECONDS, rate=8.0):
        log, file = can_log(bag, seconds), tmp_path / f"{bag}.yaml"
        bus = {"log_file": str(log), "log_rate": rate, "can_profile": "tesla_model_3"}
        bus["managed"] = True
        states = {
            "estimator": {"state_file": str(tmp_path / f"{bag}.json"), "wait_for_update": True},
            "energy": {"energy_file": str(tmp_path / f"{bag}.json")},
        }
        nodes = {"can_bridge": bus, **states}
        values = {f"/**/{node}": {"ros__parameters": own} for node, own in nodes.items()}
        file.write_text(json.dumps(values))  # which is YAML too
        return file

    return write


def test_nodes_are_kept_after_the_bag_and_a_mistyped_argument_is_reported(
    ros2, bench, monkeypatch, tmp_path
):
    monkeypatch.setitem(ros2.environment, "STAND_IN_END", str(tmp_path))  # at once
    given = (f"bag:={ROOT / 'bags/urban'}", "vehcle:=bmw_i3", "rate:=4", "keep:=true")
    with ros2.running(*LAUNCH, "replay.launch.py", *given) as launch:
        bench.pump(lambda: "process has finished cleanly" in launch.output)
        assert bench.ask(Trigger, "/ev/energy/reset").success and launch.process.poll() is None
    assert "unknown argument 'vehcle'; did you mean vehicle" in launch.output


def two_cars(folder, *changes) -> Path:
    """The launch file that the guide shows, with changes of its text."""
    text = re.search(r"^```python\n(.*?)^```$", GUIDE.read_text(), re.M | re.S)[1]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "two.launch.py").write_text(text)
    return folder / "two.launch.py"


@pytest.mark.nightly
def test_two_cars_in_one_graph_have_estimates_and_diagnostics_of_their_own(
    ros2, bench, car, tmp_path
):
    for bag in ("urban", "highway"):
        car(bag, rate=4.0)
    names = ("/robot1/ev", "/robot2/ev")
    speeds = {name: bench.hear(topics.SPEED, name) for name in names}
    learned = {name: bench.hear(topics.IDENTIFIABLE, name) for name in names}
    said = bench.hear(topics.DIAGNOSTICS)
    cars = {
        (f"{name}/{node}", name, vehicle)
        for name, vehicle in zip(names, ("tesla_model_3_lr", "generic"), strict=True)
        for node in ("can_bridge", "estimator", "energy")
    }

    def those_who_spoke():
        return {
            (s.name.partition(":")[0], s.hardware_id, entry.value)
            for m in said for s in m.status for entry in s.values if entry.key == "vehicle"
        }  # fmt: skip

    def fastest(name):
        return max((m.twist.twist.linear.x for m in speeds[name]), default=0.0)

    def all_is_said():
        first, second = map(fastest, names)  # two cars that set off may be as fast for a moment
        drive = min(first, second) > 2.0 and abs(first - second) > 0.1
        learn = all(len(messages) > 5 for messages in learned.values())
        return drive and learn and those_who_spoke() >= cars

    given = (f"first:={tmp_path}/urban.yaml", f"second:={tmp_path}/highway.yaml")
    with ros2.running("launch", two_cars(tmp_path), *given):
        for name in names:
            play(bench, name, listeners=3)
        bench.pump(all_is_said)
        graph = {f"{space}/{name}".replace("//", "/")
                 for name, space in bench.node.get_node_names_and_namespaces()}  # fmt: skip
        topic_names = {name for name, _ in bench.node.get_topic_names_and_types()}
    assert {node for node, *_ in cars} <= graph
    assert not [name for name in topic_names if name.startswith("/ev/power")]
    assert fastest(names[0]) != pytest.approx(fastest(names[1]), abs=0.1)
    last = [numbers(learned[name][-1]) for name in names]
    assert last[0] != last[1]
    assert those_who_spoke() == cars
    assert_each_is_in_one_group_of_its_car({s.name for m in said for s in m.status})


def assert_each_is_in_one_group_of_its_car(names):
    """By the rules of diagnostic_aggregator, which is C++ and no wheel.

    Its README (ros/diagnostics, diagnostic_aggregator) has the keys, and that what nobody matches
    goes to `Other`; GenericAnalyzer::match that `startswith` compares the name from its first
    letter. The file is read by the parser of ROS into a node called `analyzers`, as there.
    """
    words = ["--ros-args", "--params-file", str(ROOT / "config/diagnostics/two_cars.yaml")]
    node = rclpy.create_node(
        "analyzers", cli_args=words, automatically_declare_parameters_from_overrides=True,
        use_global_arguments=False,
    )  # fmt: skip
    parameters = node.get_parameters_by_prefix("")
    values = {name: parameter.value for name, parameter in parameters.items()}
    node.destroy_node()
    groups = {name.removesuffix(".startswith"): value for name, value in values.items()
              if name.endswith(".startswith")}  # fmt: skip
    assert {values[f"{group}.type"] for group in groups} == {
        "diagnostic_aggregator/GenericAnalyzer"
    }
    assert {values[f"{car}.type"] for car in ("robot1", "robot2")} == {
        "diagnostic_aggregator/AnalyzerGroup"
    }
    for name in names:
        matching = [group for group, starts in groups.items() if name.startswith(tuple(starts))]
        assert len(matching) == 1, name
        assert matching[0].startswith(name.split("/")[1] + ".analyzers."), name


WRONG = {
    "respawn:=1": "Valid options are",
    "use_sim_time:=yes": "Valid options are",
    "log_level:=loud": "Valid options are",
    "record:=1": "record:=1: give a folder",
    "record:=.": "record:=.: exists already",
    "params_file:=none.yaml": "params_file:=none.yaml: no such file",
    "vehicle:=trabant": "trabant",
    "deadline:=soon": "deadline:=soon: not a number",
    "rate:=fast": "rate:=fast: not a number",
}


def test_a_wrong_argument_is_refused_before_anything_starts(ros2):
    files = {"deadline": "eco_speed_planner.launch.py", "rate": "replay.launch.py"}
    named = {given: files.get(given.partition(":=")[0], "evpinn.launch.py") for given in WRONG}
    answers = ros2.run_all(*((*LAUNCH, file, "bag:=x", given) for given, file in named.items()))
    for (given, reason), (code, said) in zip(WRONG.items(), answers, strict=True):
        assert code == 1 and reason in said, (given, said)
        assert "process started" not in said


def test_arguments_are_the_same_everywhere_and_described(ros2):
    common = {"vehicle", "params_file", "namespace", "respawn", "log_level", "record"}
    files = [file.name for file in (ROOT / "launch").glob("*.launch.py")]
    answers = ros2.run_all(*((*LAUNCH, file, "--show-args") for file in files))
    for file, (_, shown) in zip(files, answers, strict=True):
        names = {*re.findall(r"^    '(\w+)':$", shown, re.M)}
        if file == "two_cars.launch.py":  # evpinn.launch.py twice, which takes the others
            assert names == {"first", "first_vehicle", "second", "second_vehicle"}
        else:
            assert names >= common | {"use_sim_time"}, file
        assert "no description given" not in shown


REMAPPED = """
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch_ros.actions import SetRemap

def generate_launch_description():
    arguments = {{"bus": "false", "vehicle": "tesla_model_3_lr", "record": "{record}"}}
    return LaunchDescription([
        SetRemap("vehicle/speed", "/car/speed"),
        SetRemap("/ev/battery/state", "/battery_state"),
        SetRemap("estimator:odom", "wheels"),
        IncludeLaunchDescription("{file}", launch_arguments=arguments.items()),
    ])
"""


def test_a_recording_has_inputs_that_are_remapped_and_no_bridge_is_started(
    ros2, bench, bundled, tmp_path
):
    """As `inputs.md` has it for a robot that publishes speed and battery by itself."""
    record, file = tmp_path / "drive", tmp_path / "robot.launch.py"
    include = ROOT / "launch" / "evpinn.launch.py"
    file.write_text(REMAPPED.format(file=include, record=record))
    powers = bench.hear(topics.POWER_PREDICTED)
    names = {topics.SPEED: "/car/speed", topics.BATTERY: "/battery_state"}
    publishers = {
        topic: bench.node.create_publisher(message_class(topic.type_name), name, 10)
        for topic, name in names.items()
    }
    drive = bundled("urban", 20.0)
    with ros2.running("launch", file) as launch:
        # The estimator, the energy node and the recorder.
        bench.pump(lambda: all(p.get_subscription_count() == 3 for p in publishers.values()))

        # All of it: a publisher knows a reader before that reader knows the publisher, and what
        # is sent in between is lost.
        def send_more() -> bool:
            if (sent := next(drive, None)) is not None:
                publishers[sent[0]].publish(sent[2])
            return sent is None and len(powers) > 5

        bench.pump(send_more)
        assert "/ev/wheels" in launch.output and "can_bridge" not in launch.output
    with BagReader(record) as bag:
        counts = {name: bag.topics[name].count for name in (*names.values(), "/ev/power/measured")}
    assert all(counts.values()), counts


def test_live_nodes_are_recorded_and_back_after_a_kill_with_all_they_had(
    ros2, bench, bundled, car, tmp_path
):
    learned, said = bench.hear(topics.PARAMETERS), bench.hear(topics.DIAGNOSTICS)
    totals, drive = bench.hear(topics.ENERGY_TOTALS), tmp_path / "drive"
    seconds = 25.0  # two intervals are learned from

    def on_disk():
        state = read_state(tmp_path / "urban.json")
        return [state["learned"], state["energy"]]

    def saved():
        for node in ("estimator", "energy"):
            assert bench.ask(Trigger, f"/ev/{node}/save").success
        return on_disk()

    def counted():
        return {k: v for k, v in numbers(totals[-1]).items() if k.startswith("lifetime")}

    given = ("vehicle:=tesla_model_3_lr", f"params_file:={car(seconds=seconds)}", "respawn:=true")
    with ros2.running(*LAUNCH, "evpinn.launch.py", *given, f"record:={drive}") as launch:
        play(bench, listeners=3)
        bench.pump(lambda: any("ended after" in s.message for s in statuses(said, "can_bridge")))
        bench.pump(lambda: saved() == saved())  # nothing is on the way any more
        parameters, total = numbers(learned[-1]), counted()
        learned.clear(), totals.clear()
        for node in ("estimator", "energy"):
            started = rf"\[{node}-\d\]: process started with pid \[(\d+)\]"
            os.kill(int(re.findall(started, launch.output)[0]), signal.SIGKILL)
        launch.killed = 2
        states = on_disk()  # nodes save by themselves as well, up to the kill
        bench.pump(lambda: launch.output.count("continues from") == 2)
        assert saved() == states  # to the last bit
        known = len(list(bundled("urban", seconds)))
        rest = itertools.islice(bundled("urban", 360.0), known, None)
        bench.pump(lambda: (learned and totals) or bench.send(*itemgetter(0, 2)(next(rest))))
    for name, sigma in zip(learned[0].name, learned[0].effort, strict=True):
        assert numbers(learned[0])[name] == pytest.approx(parameters[name], abs=sigma)
    assert total["lifetime_drawn"] > 1e4 and total.keys() == counted().keys()
    for name in ("lifetime_drawn", "lifetime_regenerated"):
        assert total[name] - 1e-6 < counted()[name] < total[name] + 1e6
    assert states[0]["vehicle"] == "tesla_model_3_lr"
    assert "/ev/typed/power/smoothed" in launch.output  # asked for, wherever it is published
    with BagReader(drive) as bag:
        assert bag.problem is None and "/diagnostics" in bag.topics
        assert bag.topics["/ev/power/smoothed"].count > 0
        speeds = [record.message for record in bag.records(["/ev/vehicle/speed"])]
        typed = {t.under() for standard, t in TYPED.items() if standard.under() in bag.topics}
        if add_messages({}):  # then nodes publish them
            assert len(typed) > 5 and typed <= bag.topics.keys()
            assert all(bag.topics[name].count > 0 for name in typed)
    assert max(speed.twist.twist.linear.x for speed in speeds) > 5.0
