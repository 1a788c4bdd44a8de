"""The launch files without `launch`, which is no wheel: what they ask of it, written down."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import sys
from types import ModuleType

import pytest

from evpinn_ros.nodes.parameter_file import check_parameter_file
from evpinn_ros.nodes.parameter_table import TABLES
from evpinn_ros.nodes.topics import INPUTS, TOPICS

ROOT = Path(__file__).resolve().parents[2]
STUBBED = (
    "launch",
    "launch.actions",
    "launch.event_handlers",
    "launch.events",
    "launch.substitutions",
    "launch_ros",
    "launch_ros.actions",
    "launch_ros.parameter_descriptions",
)


class Asked:
    """Anything a launch file makes; as a LaunchConfiguration it reads the context."""

    def __init__(self, kind, arguments, options):
        self.kind, self.arguments, self.options = kind, arguments, options

    def perform(self, context):
        assert self.kind == "LaunchConfiguration"
        return context[self.arguments[0]]


def _stub(name):
    module = ModuleType(name)
    module.__getattr__ = lambda kind: lambda *a, **k: Asked(kind, a, k)
    return module


@pytest.fixture
def launch(monkeypatch):
    """The actions of a launch file for some arguments, by kind."""
    for name in STUBBED:
        monkeypatch.setitem(sys.modules, name, _stub(name))

    def actions(file, **given):
        spec = spec_from_file_location("launch_file", ROOT / "launch" / file)
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        *declared, opaque = module.generate_launch_description().arguments[0]
        context = {each.arguments[0]: each.options.get("default_value") for each in declared}
        assert given.keys() <= context.keys()
        assert all(each.options["description"] for each in declared)
        context |= given
        assert None not in context.values(), "an argument without default is not given"
        return opaque.options["function"](context)

    return actions


def nodes(actions):
    return {a.options["executable"]: a.options for a in actions if a.kind == "Node"}


def commands(actions):
    return [a.options["cmd"] for a in actions if a.kind == "ExecuteProcess"]


def test_live_starts_the_three_nodes_under_one_namespace(launch):
    actions = launch("evpinn.launch.py")
    assert nodes(actions).keys() == TABLES.keys() and len(actions) == 3
    for name, options in nodes(actions).items():
        assert options["package"] == "evpinn_ros"
        assert (options["name"], options["namespace"]) == (name, "/ev")
        file, overrides = options["parameters"]
        check_parameter_file(Path(file))
        assert overrides == {"use_sim_time": False}


def test_arguments_reach_the_parameters_of_the_nodes_that_have_them(launch):
    given = {"vehicle": "bmw_i3", "can_interface": "pcan", "can_channel": "0"}
    for name, options in nodes(launch("evpinn.launch.py", **given)).items():
        overrides = {k: v for k, v in options["parameters"][1].items() if k != "use_sim_time"}
        expected = {"vehicle": "bmw_i3"}
        if name == "can_bridge":
            expected |= {"interface": "pcan", "channel": "0"}
        assert {key: value.arguments[0] for key, value in overrides.items()} == expected
        assert all(value.options == {"value_type": str} for value in overrides.values())
        assert overrides.keys() <= {parameter.name for parameter in TABLES[name]}


def test_live_records_every_topic_when_asked(launch):
    (command,) = commands(launch("evpinn.launch.py", record="true", namespace="/truck"))
    assert command[:6] == ["ros2", "bag", "record", "--storage", "mcap", "--topics"]
    assert command[6:] == [topic.under("/truck") for topic in TOPICS]
    (command,) = commands(launch("evpinn.launch.py", record="true", use_sim_time="true"))
    assert "--use-sim-time" in command


def test_replay_plays_inputs_alone_and_by_the_clock_of_the_bag(launch):
    actions = launch("replay.launch.py", bag="drive", vehicle="bmw_i3", rate="5")
    (command,) = commands(actions)
    assert command[:4] == ["ros2", "bag", "play", "drive"]
    assert command[command.index("--topics") + 1 :] == [topic.under() for topic in INPUTS]
    assert command[command.index("--rate") + 1] == "5" and "--clock" in command
    assert nodes(actions).keys() == {"estimator", "energy"}
    for name, options in nodes(actions).items():
        overrides = options["parameters"][1]
        assert overrides["use_sim_time"] is True
        leader = "vehicle/speed" if name == "estimator" else "power/smoothed"
        assert overrides[f"qos_overrides./ev/{leader}.subscription.depth"] == 1000
        assert overrides["vehicle"].arguments == ("bmw_i3",)
        assert overrides.get("wait_for_update", False) == (name == "estimator")


def test_eco_speed_planner_starts_beside_the_node_it_asks(launch):
    given = {"vehicle": "bmw_i3", "deadline": "600", "route": "7.csv"}
    started = nodes(launch("eco_speed_planner.launch.py", **given))
    names = {executable: options["name"] for executable, options in started.items()}
    assert names == {"energy": "energy", "eco_speed_planner.py": "eco_speed_planner"}
    assert (ROOT / "examples" / "eco_speed_planner.py").is_file()
    reached = {}
    for options in started.values():
        file, overrides = options["parameters"]
        check_parameter_file(Path(file))
        assert options["namespace"] == "/ev"
        reached |= {k: (v.arguments[0], v.options["value_type"]) for k, v in overrides.items()}
    assert reached == {
        "vehicle": ("bmw_i3", str),
        "deadline": ("600", float),
        "route": ("7.csv", str),
    }
    energy = nodes(launch("eco_speed_planner.launch.py"))["energy"]
    assert len(energy["parameters"]) == 1, "the vehicle is that of the file"


def test_replay_ends_with_the_bag_and_demands_one(launch):
    kinds = [action.kind for action in launch("replay.launch.py", bag="drive")]
    assert kinds[-1] == "RegisterEventHandler"
    with pytest.raises(AssertionError, match="without default"):
        launch("replay.launch.py")
