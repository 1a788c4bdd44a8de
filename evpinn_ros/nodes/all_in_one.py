"""The three nodes of `evpinn run` in one process, with an optional recorder."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

from evpinn_ros.bags.writer import Split
from evpinn_ros.can.frame import RawFrames
from evpinn_ros.nodes import running
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.parameters import overrides
from evpinn_ros.nodes.recorder import RecorderNode
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.node_parameters import Value, of_node

NODES = {"estimator": EstimatorNode, "energy": EnergyNode, "can_bridge": CanBridgeNode}
"""The bridge is last: it publishes at once, and its subscribers take seconds to load."""


def run(
    parameters: Mapping[str, Value],
    *,
    record: Path | None = None,
    split: Split | None = None,
    beside: AbstractContextManager[object] | None = None,
    ros_args: Sequence[str] = (),
) -> int:
    """Run the nodes until SIGINT or SIGTERM; returns 1, with a line on stderr, for wrong input.

    `parameters` override those of a file. `record` is the folder of a bag for all topics and raw
    frames. `beside` is entered before the nodes start. `ros_args` follow `--ros-args`.
    """
    args = ["--ros-args", *ros_args] if ros_args else []
    options: dict[str, dict[str, Any]] = {
        name: {"namespace": NAMESPACE, "parameter_overrides": overrides(of_node(name, parameters))}
        for name in NODES
    }
    makers: list[running.MakeNode] = []
    if record is not None:
        frames: RawFrames = deque()
        options["can_bridge"]["record"] = frames
        makers.append(partial(RecorderNode, record, frames, split, namespace=NAMESPACE))
    makers += [partial(make, **options[name]) for name, make in NODES.items()]
    return running.run(*makers, args=args, beside=beside)
