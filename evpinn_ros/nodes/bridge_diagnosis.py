"""Status of the CAN bridge, decided without ROS."""

from __future__ import annotations

from evpinn_ros.can.bridge import BridgeStatus
from evpinn_ros.can.bus import BusCondition, BusStatus
from evpinn_ros.can.poller import PollStatus
from evpinn_ros.nodes.diagnosis import Health, Status, flat, rounded, with_health
from evpinn_ros.topics.messages import Level


def bus_status(bus: BusStatus, bridge: BridgeStatus, health: Health) -> Status:
    """The health of the CAN bridge."""
    values = {
        "bus": bus.condition.name.lower(),
        "frames": bridge.frames,
        "unknown_frames": bridge.unknown_frames,
        "unknown_ids": bridge.unknown_ids,
        **flat("dropped", bridge.dropped),
        **flat("bus", bus.counters),
    }
    for name, signal in bridge.signals.items():
        values |= {
            f"{name}.count": signal.count,
            f"{name}.rate_hz": rounded(signal.rate),
            f"{name}.age_s": rounded(signal.age),
        }
    if bridge.fault:
        values["suspicion"] = bridge.fault
    if bus.problem:
        values["bus.last_problem"] = bus.problem
    if bus.condition in (BusCondition.LOST, BusCondition.OFF):
        verdict = Level.ERROR, bus.problem or bus.condition.value
    elif bus.condition in (BusCondition.SILENT, BusCondition.ERRORS):
        verdict = Level.WARN, bus.condition.value
    elif bus.condition is BusCondition.CLOSED:
        verdict = Level.WARN, bus.problem or "closed"
    else:
        verdict = _level(bridge), bridge.text
    return with_health(Status("bus", *verdict, values), health)


def poll_status(poll: PollStatus, experimental: bool) -> Status:
    """Status of asking the car."""
    text = f"experimental profile: {poll.text}" if experimental else poll.text
    level = Level.OK if poll.ok and not experimental else Level.WARN
    return Status("polling", level, text, dict(poll.counters))


def log_status(text: str, problem: str | None, bridge: BridgeStatus, health: Health) -> Status:
    """The health of the CAN bridge while it replays a log."""
    values = {"frames": bridge.frames, **flat("dropped", bridge.dropped)}
    if problem is not None:
        verdict = Level.ERROR, problem
    elif bridge.refusal or bridge.fault:
        verdict = _level(bridge), bridge.text
    else:
        verdict = Level.OK, text
    return with_health(Status("log", *verdict, values), health)


def _level(bridge: BridgeStatus) -> Level:
    if bridge.refusal:
        return Level.ERROR
    return Level.OK if bridge.ok else Level.WARN
