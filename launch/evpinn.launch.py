"""The three nodes of one car, live: `ros2 launch evpinn_ros evpinn.launch.py vehicle:=bmw_i3`."""

from evpinn_ros.nodes.launching import argument, describe, node

OWN = (
    argument("can_interface", "", "Driver of the CAN adapter; empty: as in params_file."),
    argument("can_channel", "", "Channel of the adapter; empty: as in params_file."),
)


def generate_launch_description():
    return describe(_actions, *OWN)


def _actions(given):
    car = {"vehicle": given["vehicle"]}
    bus = {"interface": given["can_interface"], "channel": given["can_channel"]}
    return [
        node(given, "can_bridge", car | bus),
        node(given, "estimator", car),
        node(given, "energy", car),
    ]
