"""Faults of time under use_sim_time: a late /clock, and one that jumps, as a bag in a loop."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import math
import time

from evpinn_ros.nodes import topics
from evpinn_ros.nodes.factory import message_class, new_message
from evpinn_ros.nodes.faults.chain import Chain
from evpinn_ros.nodes.faults.fault import RECOVERY, Fault, Finding
from evpinn_ros.nodes.faults.inputs import MOST_MOVED
from evpinn_ros.nodes.faults.rig import SLACK, Rig
from evpinn_ros.signals.readings import NANOSECONDS

CLOCK = "rosgraph_msgs/msg/Clock"
BEGIN_NS = 5000 * NANOSECONDS
LONGEST = 15.0  # s in which a fault must be named


def clock_faults() -> Iterator[Fault]:
    """The faults of this module."""
    reset = "what was learned since the start (policy reset)"
    yield Fault("clock_late", "use_sim_time, no /clock for 5 s", "nothing", _late)
    yield Fault("clock_back", "/clock and stamps go back 300 s", reset, _Jump(-300, "went back"))
    yield Fault("clock_ahead", "/clock and stamps leap 300 s", "nothing", _Jump(300, "leapt"))
    yield Fault(
        "clock_back_held", "likewise, policy hold", "nothing", _Jump(-300, "went back", "hold")
    )


class _SimTime:
    """Time as /clock tells it, at each moment of the drive."""

    def __init__(self, rig: Rig) -> None:
        self._publisher = rig.node.create_publisher(message_class(CLOCK), "/clock", 10)
        self._offset_ns = BEGIN_NS - time.monotonic_ns()
        self.ticks = True

    def jump(self, seconds: float) -> None:
        self._offset_ns += round(seconds * NANOSECONDS)

    def __call__(self) -> int:
        """The stamp of this moment, once /clock was told."""
        now_ns = time.monotonic_ns() + self._offset_ns
        if self.ticks:
            message = new_message(CLOCK)
            message.clock.sec, message.clock.nanosec = divmod(now_ns, NANOSECONDS)
            self._publisher.publish(message)
        return now_ns


@contextmanager
def _sim_time(rig: Rig) -> Iterator[_SimTime]:
    before, clock = rig.clock, _SimTime(rig)
    rig.clock = clock
    try:
        yield clock
    finally:
        rig.clock = before


def _late(rig: Rig) -> Finding:
    chain = Chain(rig, rig.folder / "late", use_sim_time=True)
    with _sim_time(rig) as clock:
        clock.ticks = False
        begin = time.monotonic()
        try:
            for name in ("estimator", "energy"):
                chain.start(name)
            for process in chain.processes.values():
                process.await_ready()
            sent, since = rig.sent, time.monotonic()
            rig.drive(LONGEST, until=lambda: rig.said("estimator", "/clock", begin) is not None)
            clock.ticks = True
            end = time.monotonic()
            rig.drive(2 * RECOVERY, until=lambda: rig.recovered(end) < math.inf)
            rig.drive(2.0)
            missing = rig.sent - sent - rig.count(topics.POWER_PREDICTED, since)
        finally:
            chain.stop()
    said, harm = rig.said("estimator", "/clock", begin), rig.faulty(begin)
    return Finding(
        harm or f"{max(missing, 0)} of {rig.sent - sent} predictions",
        missing <= SLACK and harm is None,
        rig.recovered(end),
        None if said is None else said.text,
    )


@dataclass(frozen=True)
class _Jump:
    """Time jumps by so many seconds."""

    seconds: float
    word: str
    policy: str = "reset"

    def __call__(self, rig: Rig) -> Finding:
        chain = Chain(
            rig,
            rig.folder / f"jump_{self.seconds}_{self.policy}",
            use_sim_time=True,
            time_jump_policy=self.policy,
        )
        with _sim_time(rig) as clock:
            try:
                chain.await_well()
                rig.drive(3.0)
                begin, sent, learned = time.monotonic(), rig.sent, rig.learned()
                clock.jump(self.seconds)
                rig.drive(
                    2 * RECOVERY,
                    until=lambda: (
                        rig.recovered(begin) < math.inf
                        and rig.said("estimator", self.word, begin) is not None
                    ),
                )
                rig.drive(1.5)
                missing = rig.sent - sent - rig.count(topics.POWER_PREDICTED, begin)
            finally:
                chain.stop()
        moved = abs(rig.learned() / learned - 1.0)
        said, harm = rig.said("estimator", self.word, begin), rig.faulty(begin)
        return Finding(
            harm or f"{max(missing, 0)} predictions, mass/eta moved {moved:.1%}",
            missing <= SLACK and harm is None and moved <= MOST_MOVED,
            rig.recovered(begin),
            None if said is None else said.text,
        )
