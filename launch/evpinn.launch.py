"""The three nodes of one car, live: `ros2 launch evpinn_ros evpinn.launch.py vehicle:=bmw_i3`."""

from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from evpinn_ros.nodes.topics import NAMESPACE, TOPICS
from evpinn_ros.share import share_directory
from launch import LaunchDescription

EXECUTABLES = ("can_bridge", "estimator", "energy")
ARGUMENTS = {
    "vehicle": ("", "Vehicle by name or path; empty: as in params_file."),
    "can_interface": ("", "Driver of the CAN adapter; empty: as in params_file."),
    "can_channel": ("", "Channel of the adapter; empty: as in params_file."),
    "params_file": (str(share_directory() / "config" / "evpinn.param.yaml"), "Parameters."),
    "namespace": (NAMESPACE, "Of all topics."),
    "record": ("false", "Record every topic into an MCAP bag in the working directory."),
    "use_sim_time": ("false", "Take the time from /clock."),
}
# Launch argument, parameter, and the nodes that have it.
OVERRIDES = (
    ("vehicle", "vehicle", EXECUTABLES),
    ("can_interface", "interface", ("can_bridge",)),
    ("can_channel", "channel", ("can_bridge",)),
)


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_actions)])


def _actions(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    actions = [_node(executable, given) for executable in EXECUTABLES]
    if _is_true(given["record"]):
        actions.append(_recorder(given["namespace"], _is_true(given["use_sim_time"])))
    return actions


def _node(executable, given):
    overrides = {"use_sim_time": _is_true(given["use_sim_time"])}
    for argument, parameter, executables in OVERRIDES:
        if given[argument] and executable in executables:
            # As text, also where it looks like a number: channels may be called `0`.
            overrides[parameter] = ParameterValue(given[argument], value_type=str)
    return Node(
        package="evpinn_ros",
        executable=executable,
        name=executable,
        namespace=given["namespace"],
        parameters=[given["params_file"], overrides],
        output="screen",
    )


def _recorder(namespace, use_sim_time):
    command = ["ros2", "bag", "record", "--storage", "mcap"]
    command += ["--use-sim-time"] if use_sim_time else []
    command += ["--topics", *(topic.under(namespace) for topic in TOPICS)]
    return ExecuteProcess(cmd=command, output="screen")


def _is_true(text):
    return text.lower() == "true"
