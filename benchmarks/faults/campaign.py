"""The campaign: every fault, one after the other, on real nodes over real DDS."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
import tempfile

import rclpy

from benchmarks.faults.bus import bus_faults
from benchmarks.faults.chain import NodeChain
from benchmarks.faults.clocks import clock_faults
from benchmarks.faults.fault import Fault, FaultEffect, FaultResult
from benchmarks.faults.files import file_faults
from benchmarks.faults.inputs import input_faults
from benchmarks.faults.load import load_faults
from benchmarks.faults.processes import process_faults
from benchmarks.faults.rig import Rig
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.processes import own_network


def run_campaign(
    only: Collection[str], kills: int, progress: Callable[[str], None]
) -> Iterator[FaultResult]:
    """Inject the faults; results come one by one.

    `only` names faults, none for all; `kills` is how often to kill at a random instant; `progress`
    takes the name of the fault that begins.

    Raises:
        InputError: no fault of such a name.
    """
    with _rig() as rig:
        chain = NodeChain(rig, rig.folder / "shared")
        try:
            faults = [*_faults(chain, kills)]
            _refuse_unknown(only, faults)
            for fault in faults:
                if not only or fault.name in only:
                    progress(fault.name)
                    if not fault.is_shared:
                        chain.stop()
                    yield FaultResult(fault, _inject(fault, rig))
        finally:
            chain.stop()


def _faults(chain: NodeChain, kills: int) -> Iterator[Fault]:
    yield from input_faults(chain)
    yield from load_faults(chain)
    yield from bus_faults(chain)
    yield from process_faults(chain, kills)
    yield from file_faults()
    yield from clock_faults()


def _inject(fault: Fault, rig: Rig) -> FaultEffect:
    try:
        return fault.inject(rig)
    except InputError as error:
        return FaultEffect(str(error), False, float("inf"), None)


def _refuse_unknown(only: Collection[str], faults: Collection[Fault]) -> None:
    names = [fault.name for fault in faults]
    for name in only:
        if name not in names:
            raise InputError(f"no fault named '{name}'; there are {', '.join(names)}")


@contextmanager
def _rig() -> Iterator[Rig]:
    own_network()
    rclpy.init(args=[])
    try:
        with tempfile.TemporaryDirectory(prefix="evpinn_faults_") as folder:
            rig = Rig(Path(folder))
            try:
                yield rig
            finally:
                rig.close()
    finally:
        rclpy.try_shutdown()
