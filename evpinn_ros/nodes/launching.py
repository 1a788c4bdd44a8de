"""Shared parts of the launch files; a wrong argument ends the launch before any node starts.

Only launch files import it: `launch` comes with a ROS 2 installation, not from PyPI.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.utilities import make_namespace_absolute, prefix_namespace

from evpinn_ros.common.errors import InputError, near_names
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.typed import TYPED, TYPED_FORECAST
from evpinn_ros.topics import NAMESPACE, TOPICS, Topic
from launch import LaunchDescription

if TYPE_CHECKING:  # `ros2` may run in a Python without the packages that the table needs
    from evpinn_ros.topics.node_parameters import Value

TRUTH = ("true", "false")
LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
NO_FOLDERS = (*TRUTH, "0", "1", "yes", "no", "on", "off")
RESPAWN_DELAY = 2.0  # s


def argument(
    name: str, default: str | None, description: str, choices: Sequence[str] | None = None
) -> DeclareLaunchArgument:
    """A launch argument, required if it has no default."""
    return DeclareLaunchArgument(
        name,
        default_value=default,
        description=description,
        choices=list(choices) if choices else None,
    )


COMMON = (
    argument("vehicle", "", "Vehicle by name or path; empty: as in params_file."),
    argument(
        "params_file", str(share_directory() / "config" / "evpinn.param.yaml"), "Parameter file."
    ),
    argument(
        "namespace",
        NAMESPACE.lstrip("/"),
        "Namespace of all topics; a relative one is below that of an including launch file.",
    ),
    argument("respawn", "false", "Restart a node that has ended.", TRUTH),
    argument("log_level", "info", "Lowest severity that is logged.", LOG_LEVELS),
    argument("record", "", "Folder of a bag (MCAP) to record every topic to; empty: none."),
)
BUS = (
    argument(
        "bus", "true", "Decode a CAN bus; false: other nodes publish speed and battery.", TRUTH
    ),
    argument("can_interface", "", "python-can interface of the bus; empty: as in params_file."),
    argument("can_channel", "", "Channel of the bus; empty: as in params_file."),
)
SIMULATED = argument("use_sim_time", "false", "Take the time from /clock.", TRUTH)


class Given:
    """The values of a launch's arguments; InputError if one is wrong."""

    def __init__(self, context: Any, arguments: Iterable[DeclareLaunchArgument]) -> None:
        names = [argument.name for argument in arguments]
        self.values: dict[str, str] = {
            name: LaunchConfiguration(name).perform(context) for name in names
        }  # values by name
        pushed = context.launch_configurations.get("ros_namespace")
        below = prefix_namespace(pushed, self.values["namespace"])
        self.namespace: str = make_namespace_absolute(below)  # with those of including files
        # (from, to) of each `SetRemap` in including files
        self.remaps: Sequence[tuple[str, str]] = context.launch_configurations.get(
            "ros_remaps", ()
        )
        if not Path(self.values["params_file"]).is_file():
            raise InputError(f"params_file:={self.values['params_file']}: no such file")
        if self.values["vehicle"]:
            load_vehicle(self.values["vehicle"])
        record = self.values["record"]
        if record.lower() in NO_FOLDERS:
            raise InputError(f"record:={record}: give a folder, such as record:=./drive")
        if record and Path(record).exists():
            raise InputError(f"record:={record}: exists already")

    def __getitem__(self, name: str) -> str:
        return self.values[name]

    def is_true(self, name: str) -> bool:
        """Whether an argument is `true`."""
        return self.values[name] == "true"

    def resolved(self, topic: Topic) -> str:
        """The full name of a topic, as a node resolves it: the first matching rule counts."""
        name = topic.under(self.namespace)
        for rule, target in self.remaps:
            # A rule may apply to one node: `energy:odom`.
            source = rule.removeprefix("rostopic://").rpartition(":")[2]
            if prefix_namespace(self.namespace, source) == name:
                return str(prefix_namespace(self.namespace, target))
        return name

    def number(self, name: str) -> float:
        """An argument as a number, with or without a decimal point."""
        try:
            return float(self.values[name])
        except ValueError as error:
            raise InputError(f"{name}:={self.values[name]}: not a number") from error


def describe(
    actions: Callable[[Given], list[Any]],
    *specific: DeclareLaunchArgument,
    simulated: DeclareLaunchArgument = SIMULATED,
) -> LaunchDescription:
    """Description of a launch file with `specific` and `COMMON` arguments, for `actions`."""
    arguments = (*specific, *COMMON, simulated)
    names = [argument.name for argument in arguments]

    def perform(context: Any) -> list[Any]:
        given = Given(context, arguments)
        recording = [recorder(given)] if given["record"] else []
        return [*_mistyped(context, names), *actions(given), *recording]

    return LaunchDescription([*arguments, OpaqueFunction(function=perform)])


def _mistyped(context: Any, names: Sequence[str]) -> list[LogInfo]:
    """A log line for each argument that looks mistyped; `launch` itself accepts any name."""
    others = [name for name in context.launch_configurations if name not in names]
    return [
        LogInfo(msg=f"unknown argument '{name}'{near}")
        for name in others
        if (near := near_names(name, names))
    ]


def node(
    given: Given, executable: str, parameters: Mapping[str, Value], kind: type[Node] = Node
) -> Node:
    """A node of this package; a parameter with an empty text is left to the file."""
    set_here = {"use_sim_time": given.is_true("use_sim_time")} | {
        # A text stays a text even if it looks like a number: a channel may be called `0`.
        name: ParameterValue(value, value_type=type(value))
        for name, value in parameters.items()
        if value != ""
    }
    return kind(
        package="evpinn_ros",
        executable=executable,
        name=executable.removesuffix(".py"),
        namespace=given["namespace"],
        parameters=[given["params_file"], set_here],
        ros_arguments=["--log-level", given["log_level"]],
        respawn=given.is_true("respawn"),
        respawn_delay=RESPAWN_DELAY,
        output="screen",
    )


def managed_node(given: Given, executable: str, parameters: Mapping[str, Value]) -> LifecycleNode:
    """A managed node of this package: it waits for its transitions."""
    return node(given, executable, {**parameters, "managed": True}, LifecycleNode)


def recorder(given: Given) -> ExecuteProcess:
    """Process `ros2 bag` that records every topic of this car."""
    command = ["ros2", "bag", "record", "--storage", "mcap", "--output", given["record"]]
    command += ["--use-sim-time"] if given.is_true("use_sim_time") else []
    recorded = (*TOPICS, *TYPED.values(), TYPED_FORECAST)
    command += ["--topics", *dict.fromkeys(map(given.resolved, recorded))]
    return ExecuteProcess(cmd=command, output="screen")
