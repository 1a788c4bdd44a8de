"""A recorded drive through the nodes: `ros2 launch evpinn_ros replay.launch.py bag:=my_drive`.

Only the inputs in the bag are played; outputs recorded with them would mix with the new ones.
"""

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from evpinn_ros.nodes.topics import (
    BATTERY,
    INPUTS,
    NAMESPACE,
    POWER_MEASURED,
    POWER_SMOOTHED,
    SPEED,
)
from evpinn_ros.share import share_directory
from launch import LaunchDescription

CLOCK_RATE = "100"  # Hz
DELAY = "3"  # s for the nodes to load and to be discovered; the bag's first messages matter
QUEUE = 1000  # messages of each stream that may wait, so that a fast replay loses none
QUEUED = {"estimator": INPUTS, "energy": (SPEED, BATTERY, POWER_MEASURED, POWER_SMOOTHED)}
ARGUMENTS = {
    "vehicle": ("", "Vehicle by name or path; empty: as in params_file."),
    "params_file": (str(share_directory() / "config" / "evpinn.param.yaml"), "Parameters."),
    "namespace": (NAMESPACE, "Of all topics, in the bag and out."),
    "rate": ("1.0", "Speed against real time."),
}


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    bag = DeclareLaunchArgument("bag", description="The recorded drive.")
    return LaunchDescription([bag, *arguments, OpaqueFunction(function=_actions)])


def _actions(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ("bag", *ARGUMENTS)}
    player = _player(given)
    over = OnProcessExit(target_action=player, on_exit=[EmitEvent(event=Shutdown())])
    nodes = [_node(executable, given) for executable in QUEUED]
    return [*nodes, player, RegisterEventHandler(over)]


def _player(given):
    names = [topic.under(given["namespace"]) for topic in INPUTS]
    command = ["ros2", "bag", "play", given["bag"], "--clock", CLOCK_RATE, "--delay", DELAY]
    command += ["--rate", given["rate"], "--topics", *names]
    return ExecuteProcess(cmd=command, output="screen")


def _node(executable, given):
    names = [topic.under(given["namespace"]) for topic in QUEUED[executable]]
    overrides = {f"qos_overrides.{name}.subscription.depth": QUEUE for name in names}
    overrides["use_sim_time"] = True
    if executable == "estimator":
        overrides["wait_for_update"] = True  # the same numbers at any rate
    if given["vehicle"]:
        overrides["vehicle"] = ParameterValue(given["vehicle"], value_type=str)
    return Node(
        package="evpinn_ros",
        executable=executable,
        name=executable,
        namespace=given["namespace"],
        parameters=[given["params_file"], overrides],
        output="screen",
    )
