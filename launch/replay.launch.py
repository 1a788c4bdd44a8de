"""A recorded drive through the nodes: `ros2 launch evpinn_ros replay.launch.py bag:=my_drive`.

Only the inputs in the bag are played; outputs recorded with them would mix with the new ones.
"""

from launch.actions import EmitEvent, ExecuteProcess, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown

from evpinn_ros.nodes.launching import TRUTH, argument, describe, node
from evpinn_ros.topics import (
    BATTERY,
    INPUTS,
    NAMESPACE,
    POWER_MEASURED,
    POWER_SMOOTHED,
    SPEED,
)

CLOCK_RATE = "100"  # Hz
DELAY = "3"  # s for the nodes to load and to be discovered; the bag's first messages matter
QUEUE = 1000  # messages of each stream that may wait, so that a fast replay loses none
QUEUED = {"estimator": INPUTS, "energy": (SPEED, BATTERY, POWER_MEASURED, POWER_SMOOTHED)}
OWN = (
    argument("bag", None, "The recorded drive."),
    argument("bag_namespace", NAMESPACE, "Of the topics in the bag."),
    argument("rate", "1.0", "Speed against real time."),
    argument("keep", "false", "Leave the nodes up when the bag has ended.", TRUTH),
)
BY_THE_BAG = argument(
    "use_sim_time", "true", "Publish the bag's time on /clock, and take it from there.", TRUTH
)


def generate_launch_description():
    return describe(_actions, *OWN, simulated=BY_THE_BAG)


def _actions(given):
    player = _player(given)
    nodes = [node(given, executable, _parameters(given, executable)) for executable in QUEUED]
    if given.is_true("keep"):
        return [*nodes, player]
    over = OnProcessExit(target_action=player, on_exit=[EmitEvent(event=Shutdown())])
    return [*nodes, player, RegisterEventHandler(over)]


def _player(given):
    names = {t.under(given["bag_namespace"]): t.under(given.namespace) for t in INPUTS}
    command = ["ros2", "bag", "play", given["bag"], "--rate", str(given.number("rate"))]
    command += ["--delay", DELAY, "--topics", *names]
    if given.is_true("use_sim_time"):
        command += ["--clock", CLOCK_RATE]
    if moved := [f"{old}:={new}" for old, new in names.items() if old != new]:
        command += ["--remap", *moved]
    return ExecuteProcess(cmd=command, output="screen")


def _parameters(given, executable):
    names = [topic.under(given.namespace) for topic in QUEUED[executable]]
    parameters = {f"qos_overrides.{name}.subscription.depth": QUEUE for name in names}
    if executable == "estimator":
        parameters["wait_for_update"] = True  # the same numbers at any rate
    return parameters | {"vehicle": given["vehicle"]}
