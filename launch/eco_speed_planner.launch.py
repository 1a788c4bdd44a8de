"""The node `energy` and an example that asks it what driving a hilly route costs.

`ros2 launch evpinn_ros eco_speed_planner.launch.py vehicle:=bmw_i3 deadline:=720.0`

Where `evpinn.launch.py` runs already, the example alone joins it:
`ros2 run evpinn_ros eco_speed_planner.py --ros-args -r __ns:=/ev`.
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from evpinn_ros.nodes.topics import NAMESPACE
from evpinn_ros.share import share_directory
from launch import LaunchDescription

ARGUMENTS = {
    "vehicle": ("", "Vehicle by name or path; empty: as in params_file."),
    "params_file": (str(share_directory() / "config" / "evpinn.param.yaml"), "Parameters."),
    "namespace": (NAMESPACE, "Of all topics."),
    "deadline": ("720.0", "Latest arrival, seconds after departure."),
    "route": ("", "CSV file of the road: distance_m,elevation_m; empty: 12 km of hills."),
}
# Executable: what of the arguments goes to its parameters, and as which type.
OVERRIDES = {
    "energy": {"vehicle": str},
    "eco_speed_planner.py": {"deadline": float, "route": str},
}


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_actions)])


def _actions(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    return [_node(executable, given) for executable in OVERRIDES]


def _node(executable, given):
    overrides = {
        name: ParameterValue(given[name], value_type=kind)
        for name, kind in OVERRIDES[executable].items()
        if given[name]
    }
    return Node(
        package="evpinn_ros",
        executable=executable,
        name=executable.removesuffix(".py"),
        namespace=given["namespace"],
        parameters=[given["params_file"], *([overrides] if overrides else [])],
        output="screen",
    )
