"""The nodes under test: each an executable of its own, started, stopped and killed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time
from typing import NamedTuple

from benchmarks.faults.drive import VEHICLE, learned_state
from benchmarks.faults.fault import FaultEffect
from benchmarks.faults.rig import SPIN, Change, Rig, unchanged
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.processes import START_TIMEOUT, STOP_TIMEOUT, node_command
from evpinn_ros.topics.node_parameters import Value

LAST_WORDS = 0.5  # s until what a node status before its end is received
LEADING = ("estimator", "energy")
FILES = {"estimator": ("state_file", "car.json"), "energy": ("energy_file", "energy.json")}


class Stopped(NamedTuple):
    """End of a process: exit code, and s that it took."""

    code: int
    seconds: float


class Process:
    """One process; what it says is in a file beside."""

    def __init__(
        self,
        rig: Rig,
        name: str,
        command: list[str],
        environment: Mapping[str, str] | None = None,
        rest: float = LAST_WORDS,
    ) -> None:
        """Start it, after hearing the last words of those before it for `rest` s.

        `environment` holds variables that it has besides ours.
        """
        self.name, self._rig = name, rig
        rig.rest(rest)
        self.started = time.monotonic()
        with (rig.folder / f"{name}.log").open("ab") as log:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, **(environment or {})},
            )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """True if it has not ended."""
        return self._process.poll() is None

    def await_ready(self, node: str | None = None, change: Change = unchanged) -> float:
        """Drive until it reports on /diagnostics; gives the seconds since it was started."""
        name = node or self.name
        took = self._rig.drive(
            START_TIMEOUT,
            change,
            until=lambda: self._rig.status(name, "", self.started) is not None or not self.runs,
        )
        if not self.runs or took >= START_TIMEOUT:
            raise InputError(f"the node '{name}' did not come up")
        return time.monotonic() - self.started

    def stop(self, how: signal.Signals = signal.SIGINT) -> Stopped:
        """Ask it to end, and wait; it is killed when it does not."""
        begin = time.monotonic()
        if self.runs:
            self._process.send_signal(how)
        while self.runs and time.monotonic() - begin < STOP_TIMEOUT:
            self._rig.rest(SPIN)
        seconds = time.monotonic() - begin
        self._process.kill()
        return Stopped(self._process.wait(), seconds)

    def kill(self) -> float:
        """SIGKILL; gives the time of the system's clock at which it was dead."""
        self._process.kill()
        self._process.wait()
        return time.time()

    def signal(self, number: signal.Signals) -> None:
        """Send a signal and wait for nothing."""
        self._process.send_signal(number)


def start_node(
    rig: Rig, name: str, environment: Mapping[str, str] | None = None, /, **parameters: Value
) -> Process:
    """Start the executable of one node; of parameters with a dot, the dot is a double `_`."""
    values = {key.replace("__", "."): value for key, value in parameters.items()}
    return Process(rig, name, node_command(name, {"vehicle": VEHICLE, **values}), environment)


def start_all(rig: Rig, *options: str) -> Process:
    """Start `evpinn run`."""
    command = [sys.executable, "-m", "evpinn_ros", "run", "--vehicle", VEHICLE, *options]
    return Process(rig, "run", command)


@contextmanager
def running(*processes: Process) -> Iterator[None]:
    """Stop processes in the end, whatever happens."""
    try:
        yield
    finally:
        for process in processes:
            process.stop()


class NodeChain:
    """Estimator and energy with their files, which many faults share one after the other.

    Attributes:
        folder: of the files `car.json` and `energy.json`.
        processes: by name.
    """

    def __init__(
        self, rig: Rig, folder: Path, environment: Mapping[str, str] | None = None, **common: Value
    ) -> None:
        """Not running yet; `environment` and the parameters `common` are those of both."""
        self.folder, self._rig, self._common = folder, rig, common
        self._environment = environment
        self.processes: dict[str, Process] = {}
        folder.mkdir(exist_ok=True)
        shutil.copy(learned_state(rig.folder), folder / "car.json")

    def await_well(self) -> None:
        """Start what does not run, and drive until all is well."""
        rig = self._rig
        fresh = [name for name in LEADING if not self.runs(name)]
        for name in fresh:
            self.start(name)
        for name in fresh:
            self.processes[name].await_ready()
        since = time.monotonic()
        took = rig.drive(
            START_TIMEOUT,
            until=lambda: (
                all(rig.is_well(name, since) for name in LEADING)
                and rig.recovered(since) < START_TIMEOUT
            ),
        )
        if took >= START_TIMEOUT:
            raise InputError(f"the chain is not well: {'; '.join(rig.complaints(since))}")

    def runs(self, name: str) -> bool:
        """True if a node is there."""
        return name in self.processes and self.processes[name].runs

    def start(self, name: str) -> Process:
        """Start one node."""
        key, file = FILES[name]
        own = {**self._common, key: str(self.folder / file)}
        self.processes[name] = start_node(self._rig, name, self._environment, **own)
        return self.processes[name]

    def stop(self) -> None:
        """Stop all."""
        for process in self.processes.values():
            process.stop()


@dataclass(frozen=True)
class ChainFault(ABC):
    """A fault done to a chain in which all is well."""

    chain: NodeChain

    def __call__(self, rig: Rig) -> FaultEffect:
        """Do it, and look."""
        self.chain.await_well()
        return self.inject(rig)

    @abstractmethod
    def inject(self, rig: Rig) -> FaultEffect:
        """Do it to the nodes of the chain, and look."""
