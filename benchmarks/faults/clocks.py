"""Faults of time: a late /clock, one that jumps, as a bag in a loop, and the computer's own clock.

That one is set by libfaketime, for which no right is needed: it is preloaded into the nodes, whose
monotonic clock goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import math
from pathlib import Path
import time

from benchmarks.faults.chain import NodeChain
from benchmarks.faults.drive import RATE
from benchmarks.faults.fault import RECOVERY, Fault, FaultEffect
from benchmarks.faults.inputs import MOST_MOVED
from benchmarks.faults.rig import SLACK, Rig
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.factory import message_class, new_message

CLOCK = "rosgraph_msgs/msg/Clock"
BEGIN_NS = 5000 * NANOSECONDS
DEAF = 2.0  # s without messages when the clock is set: docs/project/benchmark_history.md


def clock_faults() -> Iterator[Fault]:
    """The faults of this module."""
    reset = "what was learned since the start (policy reset)"
    yield Fault("clock_late", "use_sim_time, no /clock for 5 s", "nothing", _late)
    yield Fault("clock_back", "/clock and stamps go back 300 s", reset, _Jump(-300, "went back"))
    yield Fault("clock_ahead", "/clock and stamps leap 300 s", "nothing", _Jump(300, "leapt"))
    yield Fault(
        "clock_back_held",
        "/clock and stamps go back 300 s, policy hold",
        "nothing",
        _Jump(-300, "went back", "hold"),
    )
    if clock_setter() is None:
        return
    back, ahead = _Jump(-7200, "went back", system=True), _Jump(7200, "leapt", system=True)
    deaf = f"{DEAF:g} s of predictions"
    yield Fault("system_clock_back", "the computer's clock is set back by 2 h", deaf, back)
    yield Fault("system_clock_ahead", "the computer's clock is set ahead by 2 h", deaf, ahead)


def clock_setter() -> Path | None:
    """The library of Debian's package libfaketime, where it is installed."""
    return next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)


class _SimTime:
    """Time as /clock tells it, at each moment of the drive."""

    def __init__(self, rig: Rig) -> None:
        self._publisher = rig.node.create_publisher(message_class(CLOCK), "/clock", 10)
        self._offset_ns = BEGIN_NS - time.monotonic_ns()
        self.ticks = True

    def jump(self, seconds: float) -> None:
        self._offset_ns += round(seconds * NANOSECONDS)

    def __call__(self) -> int:
        """The stamp of this moment, once /clock was published."""
        now_ns = time.monotonic_ns() + self._offset_ns
        if self.ticks:
            message = new_message(CLOCK)
            message.clock.sec, message.clock.nanosec = divmod(now_ns, NANOSECONDS)
            self._publisher.publish(message)
        return now_ns


class SystemClock:
    """The clock of the computer, as processes with its environment have it.

    Attributes:
        environment: variables of these processes.
    """

    def __init__(self, folder: Path) -> None:
        """Like the real one, until it is set; a file in the folder sets it."""
        self._file, self._offset = folder / "clock_offset", 0.0
        self.jump(0.0)
        self.environment = {
            "LD_PRELOAD": str(clock_setter()),
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            # Under libfaketime, shared memory of Fast DDS wakes a reader at its next timer only.
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }

    def jump(self, seconds: float) -> None:
        """Set it by so many seconds."""
        self._offset += seconds
        fresh = self._file.with_suffix(".new")
        fresh.write_text(f"{self._offset:+.3f}\n")
        fresh.replace(self._file)  # it is read at every look at the clock

    def __call__(self) -> int:
        """The stamp of this moment, ns."""
        return time.time_ns() + round(self._offset * NANOSECONDS)


@contextmanager
def _stamped_by(rig: Rig, clock: _SimTime | SystemClock) -> Iterator[None]:
    """Drive by a clock; as before in the end."""
    before, rig.clock = rig.clock, clock
    try:
        yield
    finally:
        rig.clock = before


def _late(rig: Rig) -> FaultEffect:
    chain = NodeChain(rig, rig.folder / "late", use_sim_time=True)
    clock = _SimTime(rig)
    with _stamped_by(rig, clock):
        clock.ticks = False
        begin = time.monotonic()
        try:
            for name in ("estimator", "energy"):
                chain.start(name)
            for process in chain.processes.values():
                process.await_ready()
            watch = rig.watch()
            rig.drive_until_named("estimator", "/clock", begin)
            clock.ticks = True
            took = rig.drive_until_recovered(time.monotonic())
            rig.drive(2.0)
            lost, missing = watch.lost, watch.missing
        finally:
            chain.stop()
    harm = rig.faulty(begin)
    kept = missing <= SLACK and harm is None
    return FaultEffect(harm or lost, kept, took, rig.status("estimator", "/clock", begin))


@dataclass(frozen=True)
class _Jump:
    """Time jumps by so many seconds."""

    seconds: float
    word: str
    policy: str = "reset"
    system: bool = False

    def __call__(self, rig: Rig) -> FaultEffect:
        clock = SystemClock(rig.folder) if self.system else _SimTime(rig)
        chain = NodeChain(
            rig,
            rig.folder / f"jump_{self.seconds}_{self.policy}_{self.system}",
            clock.environment if isinstance(clock, SystemClock) else None,
            use_sim_time=not self.system,
            time_jump_policy=self.policy,
        )
        with _stamped_by(rig, clock):
            try:
                chain.await_well()
                rig.drive(3.0)
                watch, learned = rig.watch(), rig.learned()
                begin = watch.begin
                clock.jump(self.seconds)
                rig.drive(
                    2 * RECOVERY,
                    until=lambda: (
                        rig.recovered(begin) < math.inf
                        and rig.status("estimator", self.word, begin) is not None
                    ),
                )
                rig.drive(1.5)
                missing = watch.missing
            finally:
                chain.stop()
        most = SLACK + (DEAF * RATE if self.system else 0)
        moved = abs(rig.learned() / learned - 1.0)
        harm = rig.faulty(begin)
        return FaultEffect(
            harm or f"{max(missing, 0)} predictions, mass/eta moved {moved:.1%}",
            missing <= most and harm is None and moved <= MOST_MOVED,
            rig.recovered(begin),
            rig.status("estimator", self.word, begin),
        )
