"""Starts every executable so that a signal ends it well even during the imports."""

from __future__ import annotations

from contextlib import nullcontext
from importlib import import_module
from io import FileIO, TextIOWrapper
import os
import resource
import signal
import sys

from evpinn_ros.common.stopping import STOPS, at_stop, interruptible

ADDRESS_SPACE = 1_500_000_000  # bytes that libraries reserve; they use a tenth
OPENSSL = ("_hashlib", "_ssl")
"""What `numpy.random` and `asyncio` load and do without: 4 to 6 MB of each node."""
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
    is_run = sys.argv[1:2] == ["run"]
    before = {number: signal.getsignal(number) for number in STOPS}
    at_stop(lambda number, _: os._exit(0 if is_run else 128 + number))
    _open_streams()
    _check_address_space()
    from evpinn_ros.cli.main import main

    main(nullcontext() if is_run else interruptible(before))


def _open_streams() -> None:
    """Open on nothing what whoever started us has closed of stdin, stdout and stderr.

    What is opened next would take their numbers, and get all that libraries print.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    sys.stdout = sys.stdout or TextIOWrapper(FileIO(os.devnull, "w"))
    sys.stderr = sys.stderr or TextIOWrapper(FileIO(os.devnull, "w"))


def _check_address_space() -> None:
    """End where libraries could not be loaded: polars and BLAS abort, or raise whatever comes."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < ADDRESS_SPACE:
        sys.exit(
            f"evpinn: {limit / 1e6:.0f} MB of address space (`ulimit -v`) is too little: "
            f"libraries reserve {ADDRESS_SPACE / 1e6:.0f} MB"
        )


def _node(name: str) -> int:
    _open_streams()
    _check_address_space()
    at_stop(lambda *_: os._exit(0))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)  # where `node_process` has held them back
    for module in OPENSSL:
        sys.modules.setdefault(module, None)  # type: ignore[arg-type]
    from evpinn_ros.nodes.running import run

    return run(getattr(import_module(f"evpinn_ros.nodes.{name}"), NODES[name]))


if __name__ == "__main__":
    sys.exit(_node(sys.argv[1]))
