"""Faults of the car's signals: dropouts, wrong values, wrong stamps, on a chain that all share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import cycle
import math
import time
from typing import Any

from benchmarks.faults.chain import ChainFault, NodeChain
from benchmarks.faults.fault import Fault, FaultEffect
from benchmarks.faults.rig import LONGEST, SLACK, Change, Rig, Sent, nothing, stamped
from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS

SHORTEST = 4.0  # s
MOST_MOVED = 0.05  # of mass over eta, that a fault may teach
HOUR_NS = 3600 * NANOSECONDS


@dataclass(frozen=True)
class Disturbance(ChainFault):
    """Changes what the car sends for some seconds."""

    change: Change  # of the messages of each moment
    word: str  # of the diagnostics that name it
    may_lose: float = 0.0  # share of the predictions that may be missing meanwhile
    forgets: bool = False  # whether what was learned may move

    def inject(self, rig: Rig) -> FaultEffect:
        """Disturb, and look."""
        watch, learned = rig.watch(), rig.learned()
        begin = watch.begin
        rig.drive(SHORTEST, self.change)
        rig.drive(
            LONGEST - SHORTEST,
            self.change,
            until=lambda: rig.status("estimator", self.word, begin) is not None,
        )
        took = rig.drive_until_recovered(time.monotonic())
        lost, kept = watch.lost, watch.missing <= self.may_lose * watch.sent + SLACK
        rig.drive(1.5)  # until what was learned is published again
        moved = abs(rig.learned() / learned - 1.0)
        harm = rig.faulty(begin)
        lost = f"{lost}, mass/eta moved {moved:.1%}"
        return FaultEffect(
            lost if harm is None else f"{lost}; {harm}",
            kept and harm is None and (self.forgets or moved <= MOST_MOVED),
            took,
            rig.status("estimator", self.word, begin),
        )


# --- changes -----------------------------------------------------------------------------------


def without(topic: topics.Topic) -> Change:
    """One topic falls silent."""
    return lambda messages: [each for each in messages if each[0] is not topic]


def on(topic: topics.Topic, alter: Callable[[Any], None]) -> Change:
    """Each message of one topic is altered."""

    def change(messages: Iterable[Sent]) -> Iterator[Sent]:
        for each, message in messages:
            if each is topic:
                alter(message)
            yield each, message

    return change


def with_speed(value: float) -> Change:
    """Speed tells this value."""
    return on(topics.SPEED, lambda message: setattr(message.twist.twist.linear, "x", value))


def with_battery(**values: float) -> Change:
    """The battery tells these values."""

    def alter(message: Any) -> None:
        for name, value in values.items():
            setattr(message, name, value)

    return on(topics.BATTERY, alter)


def flipped() -> Change:
    """The current has the other sign."""
    return on(topics.BATTERY, lambda message: setattr(message, "current", -message.current))


def leaping() -> Change:
    """Every third speed is far off, as by a broken wire."""
    far = cycle((0.0, 0.0, 40.0))

    def alter(message: Any) -> None:
        message.twist.twist.linear.x += next(far)

    return on(topics.SPEED, alter)


def doubled(messages: Iterable[Sent]) -> Iterator[Sent]:
    """Everything comes twice."""
    for each in messages:
        yield each
        yield each


class Shuffled:
    """Every other speed comes a second late."""

    def __init__(self) -> None:
        self._held: list[Any] = []
        self._count = 0

    def __call__(self, messages: Iterable[Sent]) -> Iterator[Sent]:
        """Change the messages of one moment."""
        for topic, message in messages:
            self._count += topic is topics.SPEED
            if topic is topics.SPEED and self._count % 2:
                self._held.append(message)
            else:
                yield topic, message
        while len(self._held) > 10:  # at ten odd speeds a second
            yield topics.SPEED, self._held.pop(0)


def shifted(nanoseconds: int) -> Change:
    """All stamps are off by so much."""

    def change(messages: Iterable[Sent]) -> Iterator[Sent]:
        for topic, message in messages:
            stamp = message.header.stamp
            own = stamp.sec * NANOSECONDS + stamp.nanosec
            yield topic, stamped(message, own + nanoseconds)

    return change


def unstamped(messages: Iterable[Sent]) -> Iterator[Sent]:
    """No stamp is set."""
    return ((topic, stamped(message, 0)) for topic, message in messages)


def input_faults(chain: NodeChain) -> Iterator[Fault]:
    """The faults of this module, done to a chain."""

    def fault(name: str, what: str, contract: str, *how: Any, **more: Any) -> Fault:
        return Fault(name, what, contract, Disturbance(chain, *how, **more))

    nan, none = math.nan, "nothing: power and energy go on"
    moments = "the moments concerned"
    battery, speed = topics.BATTERY, topics.SPEED
    yield fault("battery_silent", "no battery/state", none, without(battery), "is silent")
    yield fault(
        "speed_silent", "no vehicle/speed", moments, without(speed), "no vehicle/speed", 1.0
    )
    yield fault("both_silent", "neither", moments, nothing, "no vehicle/speed", 1.0)
    yield fault("speed_nan", "speed is NaN", moments, with_speed(nan), "not_finite", 1.0)
    yield fault("speed_infinite", "speed is inf", moments, with_speed(math.inf), "not_finite", 1.0)
    yield fault(
        "battery_nan", "V and A are NaN", none, with_battery(voltage=nan, current=nan), "is silent"
    )
    yield fault(
        "current_infinite", "A is inf", none, with_battery(current=-math.inf), "not_finite"
    )
    yield fault(
        "zero_voltage", "V is 0 while driving", none, with_battery(voltage=0.0), "out_of_range"
    )
    yield fault(
        "current_absurd", "A is 1e6", none, with_battery(current=-1e6), "battery_out_of_range"
    )
    yield fault(
        "speed_absurd", "speed is 500 m/s", moments, with_speed(500.0), "speed_out_of_range", 1.0
    )
    yield fault(
        "speed_jumps", "each third speed is 40 m/s off", moments, leaping(), "impossible", 1.0
    )
    yield fault(
        "speed_stuck", "speed repeats", "the leap", with_speed(17.0), "speed is stuck", 0.2
    )
    yield fault(
        "battery_stuck",
        "V and A repeat",
        none,
        with_battery(voltage=358.0, current=-30.0),
        "state is stuck",
    )
    yield fault("duplicates", "everything twice", "the doubles", doubled, "doubled", 0.5)
    yield fault(
        "out_of_order", "every other speed 1 s late", "the late ones", Shuffled(), "late", 0.5
    )
    yield fault("no_stamp", "no stamp is set", moments, unstamped, "no_stamp", 1.0)
    start = "what was learned since the start (policy reset)"
    yield fault(
        "stamps_ahead",
        "all stamps 1 h ahead",
        start,
        shifted(HOUR_NS),
        "ahead of this",
        forgets=True,
    )
    yield fault(
        "stamps_back",
        "all stamps 1 h back",
        start,
        shifted(-HOUR_NS),
        "time went back",
        forgets=True,
    )
    yield Fault("current_sign", "the current has the other sign", none, _SignFlip(chain), 5.0)


class _SignFlip(ChainFault):
    """A wrong profile has the wrong sign from the first message on: a car nothing is known of."""

    def inject(self, rig: Rig) -> FaultEffect:
        begin = time.monotonic()
        rig.call("estimator/reset")
        rig.drive(
            3 * LONGEST,
            flipped(),
            until=lambda: rig.status("estimator", "sign of current", begin) is not None,
        )
        named = rig.status("estimator", "sign of current", begin)
        rig.call("estimator/reset")
        end = time.monotonic()
        took = rig.drive_until_recovered(end)
        harm = rig.faulty(begin)
        lost = harm or f"learning, until reported after {end - begin:.0f} s"
        return FaultEffect(lost, harm is None, took, named)
