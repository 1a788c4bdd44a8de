"""Two cars in one graph, `/robot1/ev/...` and `/robot2/ev/...`.

`ros2 launch evpinn_ros two_cars.launch.py first:=first.yaml second:=second.yaml
first_vehicle:=bmw_i3 second_vehicle:=generic`
"""

from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
import launch_ros.actions

from launch import LaunchDescription

# Jazzy spells it in another way.
Push = getattr(launch_ros.actions, "PushROSNamespace", None) or launch_ros.actions.PushRosNamespace
CARS = (("robot1", "first"), ("robot2", "second"))


def generate_launch_description():
    arguments = []
    for _, car in CARS:
        arguments += [
            DeclareLaunchArgument(car, description=f"Parameter file of the {car} car."),
            DeclareLaunchArgument(
                f"{car}_vehicle",
                default_value="",
                description=f"Vehicle of the {car} car; empty: as in its file.",
            ),
        ]
    return LaunchDescription([*arguments, *(_car(*each) for each in CARS)])


def _car(namespace, car):
    file = PathJoinSubstitution([ThisLaunchFileDir(), "evpinn.launch.py"])
    given = {
        "vehicle": LaunchConfiguration(f"{car}_vehicle"),
        "params_file": LaunchConfiguration(car),
    }
    include = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(file), launch_arguments=given.items()
    )
    return GroupAction([Push(namespace), include])
