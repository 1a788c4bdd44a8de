"""The three nodes of one car as managed nodes, which are configured and activated one by one.

`ros2 launch evpinn_ros managed.launch.py vehicle:=bmw_i3`; with `autostart:=false` they wait for
`ros2 lifecycle set ...` or a lifecycle manager.
"""

from launch.actions import EmitEvent, RegisterEventHandler
from launch.events import matches_action
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

from evpinn_ros.nodes.launching import TRUTH, argument, describe, managed_node

OWN = (
    argument("can_interface", "", "Driver of the CAN adapter; empty: as in params_file."),
    argument("can_channel", "", "Channel of the adapter; empty: as in params_file."),
    argument("autostart", "true", "Configure and activate the nodes.", TRUTH),
)


def generate_launch_description():
    return describe(_actions, *OWN)


def _actions(given):
    car = {"vehicle": given["vehicle"]}
    bus = {"interface": given["can_interface"], "channel": given["can_channel"]}
    # Those who listen come before the one who speaks.
    nodes = [
        managed_node(given, "estimator", car),
        managed_node(given, "energy", car),
        managed_node(given, "can_bridge", car | bus),
    ]
    started = [part for node in nodes for part in _start(node)]
    return [*nodes, *(started if given.is_true("autostart") else [])]


def _start(node):
    """Configure a node, and activate it once that is done; a failure is logged and left."""

    def to(transition):
        change = ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition)
        return EmitEvent(event=change)

    configured = OnStateTransition(
        target_lifecycle_node=node,
        start_state="configuring",
        goal_state="inactive",
        entities=[to(Transition.TRANSITION_ACTIVATE)],
    )
    return [RegisterEventHandler(configured), to(Transition.TRANSITION_CONFIGURE)]
