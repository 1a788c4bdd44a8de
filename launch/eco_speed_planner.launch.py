"""The node `energy` and an example that asks it what driving a hilly route costs.

`ros2 launch evpinn_ros eco_speed_planner.launch.py vehicle:=bmw_i3 deadline:=720.0`

Where `evpinn.launch.py` runs already, the example alone joins it:
`ros2 run evpinn_ros eco_speed_planner.py --ros-args -r __ns:=/ev`.
"""

from evpinn_ros.nodes.launching import argument, describe, node

OWN = (
    argument("deadline", "720.0", "Latest arrival, seconds after departure."),
    argument("route", "", "CSV file of the road: distance_m,elevation_m; empty: 12 km of hills."),
)


def generate_launch_description():
    return describe(_actions, *OWN)


def _actions(given):
    wanted = {"deadline": given.number("deadline"), "route": given["route"]}
    return [
        node(given, "energy", {"vehicle": given["vehicle"]}),
        node(given, "eco_speed_planner.py", wanted),
    ]
