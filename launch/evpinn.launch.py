"""The three nodes of one car, live: `ros2 launch evpinn_ros evpinn.launch.py vehicle:=bmw_i3`."""

from evpinn_ros.nodes.launching import BUS, describe, node


def generate_launch_description():
    return describe(_actions, *BUS)


def _actions(given):
    car = {"vehicle": given["vehicle"]}
    bus = {"interface": given["can_interface"], "channel": given["can_channel"]}
    bridge = [node(given, "can_bridge", car | bus)] if given.is_true("bus") else []
    return [*bridge, node(given, "estimator", car), node(given, "energy", car)]
