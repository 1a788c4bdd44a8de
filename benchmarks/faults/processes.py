"""Start and stop: in any order, one alone, by signals, and killed at any instant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path
import random
import shutil
import signal
import time

from benchmarks.faults.bus import bus_arguments
from benchmarks.faults.chain import (
    LEADING,
    ChainFault,
    NodeChain,
    Process,
    running,
    start_all,
    start_node,
)
from benchmarks.faults.drive import VEHICLE, learned_state
from benchmarks.faults.fault import RECOVERY, Fault, FaultEffect
from benchmarks.faults.files import file_of
from benchmarks.faults.rig import OUTPUTS, Rig
from benchmarks.processes import resident_mb
from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.state_file import Half, read_half, read_state
from evpinn_ros.nodes.processes import node_command

STOP, WARM_START, START = 2.0, 1.0, 1.5  # s, goals
SETTLE = 30.0  # s until the first intervals are learned
MOST_LOST = 1.0  # s of a recording
LONGEST_LIFE = 3.0  # s of a process that is killed at random, from its first report on
UNNAMED = "nothing to name"
LIVENESS_TIMEOUT = 3.0  # s without a report, then a node is gone, REP-107


def process_faults(chain: NodeChain, kills: int) -> Iterator[Fault]:
    """The faults of this module; restarts are done to a chain."""
    none = "nothing"
    for order in (LEADING, LEADING[::-1]):
        name = "start_" + "_".join(order)
        yield Fault(name, f"{order[0]} first, driving all the while", none, _Order(order))
    warm = "from exec to the first output of a learned car"
    yield Fault("warm_start", warm, none, _warm_start, WARM_START)
    together = "from exec of all three nodes at once to the first energy/state"
    yield Fault("start_together", together, none, _start_together, START)
    yield Fault("sigint", "SIGINT to `evpinn run`", none, _Stop(signal.SIGINT), STOP)
    yield Fault("sigterm", "SIGTERM to `evpinn run`", none, _Stop(signal.SIGTERM), STOP)
    yield Fault("sigterm_saving", "SIGTERM while it saves", none, _stop_saving, STOP)
    yield Fault("sigint_starting", "SIGINT while it starts", none, _stop_starting, STOP)
    for name in LEADING:
        yield Fault(
            f"{name}_restarted", f"{name} stopped and started", "meanwhile", _Restart(chain, name)
        )
        yield Fault(
            f"{name}_killed",
            f"{name} killed and started",
            "what was not saved",
            _Restart(chain, name, killed=True),
        )
    yield Fault(
        "sigkill",
        f"all killed at {kills} random instants",
        "1 s of recording, what was not saved",
        _Kills(kills),
    )


@dataclass(frozen=True)
class _Order:
    """Nodes started one after the other, each up before the next."""

    order: tuple[str, ...]

    def __call__(self, rig: Rig) -> FaultEffect:
        begin, processes = time.monotonic(), []
        try:
            for name in self.order:
                processes.append(start_node(rig, name))
                processes[-1].await_ready()
            took = rig.drive_until_recovered(time.monotonic())
        finally:
            codes = [process.stop().code for process in processes]
        waiting = rig.status("", "waiting for", begin)
        harm = rig.faulty(begin)
        kept = not any(codes) and harm is None
        status = waiting or UNNAMED  # the first of them may have nothing to wait for
        return FaultEffect(harm or "nothing", kept, took, status)


def _warm_start(rig: Rig) -> FaultEffect:
    path = rig.folder / "warm.json"
    shutil.copy(learned_state(rig.folder), path)
    estimator = start_node(rig, "estimator", state_file=str(path))
    with running(estimator):
        took = rig.drive_until_recovered(estimator.started, (topics.POWER_PREDICTED,))
    return FaultEffect("nothing", True, took, UNNAMED)


def _start_together(rig: Rig) -> FaultEffect:
    rig.drive(1.0)  # the car was driving before
    begin, car = time.monotonic(), {"vehicle": VEHICLE}
    nodes = [
        Process(rig, name, node_command(name, car), rest=0.0) for name in (*LEADING, "can_bridge")
    ]
    with running(*nodes):
        took = rig.drive_until_recovered(begin)
        rig.drive(SETTLE)
        memory = sum(resident_mb(node.pid) for node in nodes)
    predicted = rig.recovered(begin, (topics.POWER_PREDICTED,))
    found = f"first prediction after {predicted:.2f} s; {memory:.0f} MB resident"
    return FaultEffect(found, True, took, UNNAMED)


@dataclass(frozen=True)
class _Stop:
    """Stop of all that `evpinn run` starts, while it records."""

    how: signal.Signals

    def __call__(self, rig: Rig) -> FaultEffect:
        folder, state = rig.folder / self.how.name, rig.folder / f"{self.how.name}.json"
        files = ("--state", str(state), "--record", str(folder))
        run = start_all(rig, *bus_arguments(), *files)
        with running(run):
            run.await_ready("recorder")
            rig.drive(2.0)
            end = run.stop(self.how)
        saved = all(read_half(state, half)[0] is not None for half in Half)
        with BagReader(folder) as bag:
            whole = bag.problem is None
        lost = f"exit {end.code}; files {'saved' if saved else 'not saved'}"
        kept = saved and whole and not end.code
        return FaultEffect(f"nothing: {lost}" if kept else lost, kept, end.seconds, UNNAMED)


def _stop_saving(rig: Rig) -> FaultEffect:
    path = rig.folder / "saving.json"
    shutil.copy(learned_state(rig.folder), path)
    estimator = start_node(rig, "estimator", state_file=str(path))
    with running(estimator):
        estimator.await_ready()
        rig.begin_call("estimator/save")
        end = estimator.stop(signal.SIGTERM)
    kept = end.code == 0 and read_state(path) is not None
    return FaultEffect("nothing" if kept else "the state", kept, end.seconds, UNNAMED)


def _stop_starting(rig: Rig) -> FaultEffect:
    """Whatever it is importing: it must end, and soon."""
    worst, codes = 0.0, list[int]()
    for delay in (0.3, 1.0, 2.0):
        process = start_node(rig, "estimator")
        rig.rest(delay)
        end = process.stop(signal.SIGINT)
        worst, codes = max(worst, end.seconds), [*codes, end.code]
    return FaultEffect(f"exit codes {codes}", not any(codes), worst, UNNAMED)


@dataclass(frozen=True)
class _Restart(ChainFault):
    """One node of the chain gone, and come back, while the other goes on."""

    name: str
    killed: bool = False

    def inject(self, rig: Rig) -> FaultEffect:
        process = self.chain.processes[self.name]
        begin, before = time.monotonic(), rig.learned()
        if self.killed:
            process.kill()
        else:
            process.stop()
        gone = time.monotonic()
        rig.drive(LIVENESS_TIMEOUT + 1.5)
        silent = rig.status(self.name, "", gone + 0.5) is None
        fresh = self.chain.start(self.name)
        fresh.await_ready()
        ready = time.monotonic()
        took = rig.drive_until_recovered(ready)
        rig.drive(2.0)
        moved = abs(rig.learned() / before - 1.0)
        status = (
            rig.status("energy", "no power/smoothed", begin) if self.name == "estimator" else None
        )
        named = f"dropout of {self.name}" if status is None and silent else status
        lost = f"{fresh.name} for {ready - begin:.1f} s; mass/eta moved {moved:.1%}"
        kept = moved < 0.05 and rig.faulty(begin) is None
        return FaultEffect(lost, kept, took, named)


@dataclass(frozen=True)
class _Kills:
    """`evpinn run`, recording and saving, killed again and again; each finds what is left."""

    count: int

    def __call__(self, rig: Rig) -> FaultEffect:
        chance, state = random.Random(0), rig.folder / "killed.json"
        shutil.copy(learned_state(rig.folder), state)
        lost, slowest, bad = 0.0, 0.0, 0
        for number in range(self.count):
            folder = rig.folder / f"kill_{number}"
            run = start_all(rig, *bus_arguments(), "--state", str(state), "--record", str(folder))
            with running(run):
                ready = run.started + run.await_ready("recorder")
                self._live(rig, run, chance)
                died = run.kill()
            slowest = max(slowest, rig.recovered(ready, OUTPUTS))
            end = _bag_end(folder)
            lost = max(lost, died - end if end is not None else math.inf)
            bad += not _readable(state)
            shutil.rmtree(folder, ignore_errors=True)
        text = f"{lost:.2f} s of recording at most, {bad} bad files in {self.count}"
        return FaultEffect(text, lost <= MOST_LOST and not bad, slowest, UNNAMED)

    def _live(self, rig: Rig, run: Process, chance: random.Random) -> None:
        """Drive for a random time; half of the kills strike near a save."""
        begin = time.monotonic()
        rig.drive_until_recovered(begin, OUTPUTS, RECOVERY)
        rig.drive(chance.uniform(0.0, LONGEST_LIFE))
        if chance.random() < 0.5:
            rig.begin_call("estimator/save")
            rig.begin_call("energy/save")
            rig.drive(chance.uniform(0.0, 0.05), rate=200.0)


def _readable(path: Path) -> bool:
    """True if a state file is whole, or was never written."""
    try:
        read_state(path)
    except InputError:
        return False
    return True


def _bag_end(folder: Path) -> float | None:
    """Time of the last speed in a bag, s, None when it cannot be read."""
    try:
        with BagReader(file_of(folder)) as bag:
            times = [record.log_time_ns for record in bag.records([topics.SPEED.under()])]
    except (InputError, StopIteration):
        return None
    return max(times) / 1e9 if times else None
