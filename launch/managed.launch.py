"""The three nodes of one car as managed nodes, which are configured and activated one by one.

`ros2 launch evpinn_ros managed.launch.py vehicle:=bmw_i3`; with `autostart:=false` they wait for
`ros2 lifecycle set ...` or a lifecycle manager.
"""

from evpinn_ros.nodes.launching import BUS, TRUTH, argument, describe, managed_node

AUTOSTART = argument("autostart", "true", "The nodes configure and activate themselves.", TRUTH)


def generate_launch_description():
    return describe(_actions, *BUS, AUTOSTART)


def _actions(given):
    own = {"vehicle": given["vehicle"], "autostart": given.is_true("autostart")}
    bus = {"interface": given["can_interface"], "channel": given["can_channel"]}
    bridge = [managed_node(given, "can_bridge", own | bus)] if given.is_true("bus") else []
    return [managed_node(given, "estimator", own), managed_node(given, "energy", own), *bridge]
