"""Start of every executable, so that a signal ends it well from the first moment on.

What they import takes seconds on a small processor, and only what is imported can handle signals
(`nodes.running`). Until then nothing is open and nothing is to be saved.
"""

from __future__ import annotations

from importlib import import_module
import os
import signal
import sys

NODES = {"can_bridge": "CanBridgeNode", "energy": "EnergyNode", "estimator": "EstimatorNode"}


def can_bridge() -> int:
    """Run the node `can_bridge`; gives the exit code."""
    return _node("can_bridge")


def energy() -> int:
    """Run the node `energy`; gives the exit code."""
    return _node("energy")


def estimator() -> int:
    """Run the node `estimator`; gives the exit code."""
    return _node("estimator")


def evpinn() -> None:
    """Run the command `evpinn`."""
    if sys.argv[1:2] == ["run"]:  # the other commands end at signals as commands do
        _end_at_signals()
    from evpinn_ros.cli.main import main

    main()


def _node(name: str) -> int:
    _end_at_signals()
    from evpinn_ros.nodes.running import run

    return run(getattr(import_module(f"evpinn_ros.nodes.{name}"), NODES[name]))


def _end_at_signals() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))


if __name__ == "__main__":
    sys.exit(_node(sys.argv[1]))
