"""The node `can_bridge`: decodes frames of a CAN bus or log into speed, battery and torque."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
import threading
from typing import Any

from rclpy.exceptions import InvalidTopicNameException

from evpinn_ros import topics
from evpinn_ros.can import elm327
from evpinn_ros.can.bridge import WAITING, BridgeStatus, CanBridge
from evpinn_ros.can.bus import BusCondition, BusReader, BusStatus
from evpinn_ros.can.current_sign import CurrentSign
from evpinn_ros.can.frame import CanFrame, RawFrames
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.poller import PollStatus
from evpinn_ros.can.profile import CanProfile, bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import Reading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.diagnosis import WELL, Health, Status, flat, rounded, with_health
from evpinn_ros.nodes.factory import is_installed, new_message
from evpinn_ros.nodes.frame_sources import FrameTopic, LogPlayer, frame_topic
from evpinn_ros.topics.messages import Level
from evpinn_ros.topics.node_parameters import FRAMES, bus_options
from evpinn_ros.topics.readings import reading_messages

PUBLISHES = (
    topics.SPEED,
    topics.BATTERY,
    topics.BATTERY_VOLTAGE,
    topics.BATTERY_CURRENT,
    topics.MOTOR_TORQUE,
)
BEGINNINGS = (BusCondition.CLOSED.value, WAITING)  # of every bus; not logged
LONGEST_STOP = 5.0  # s to wait until a thread ends; a daemon cannot block the end


class CanBridgeNode(GuardedNode):
    """Reads a bus in one thread, and polls the car in another if `poll` is set."""

    def __init__(self, *, record: RawFrames | None = None, **kwargs: Any) -> None:
        """Start to read; all frames are also put into `record`.

        Raises:
            InputError: a parameter or a file is wrong.
        """
        self._record = record
        super().__init__("can_bridge", **kwargs)

    def configure(self) -> None:
        """Load the profile of the bus; `begin` opens the bus."""
        self._profile = self._load_profile()
        self._refuse_idle_poll()
        self._bridge = self._make_bridge()
        self._lock = threading.Lock()  # of the bridge, between its thread and the diagnostics
        self.advertise(*PUBLISHES)
        self._source: BusReader | LogPlayer | FrameTopic | None = None
        if self.values["interface"] == FRAMES and not self.values["log_file"]:
            self._listen_to_frames()
        self._threads: list[threading.Thread] = []
        values = self.values
        where = values["log_file"] or f"{values['interface']} {values['channel']}"
        self.log_start(f"decoding {self._profile.key}; {where}; waiting for frames")

    def begin(self) -> None:
        """Open the bus or the log, and read it."""
        if self._threads:  # a managed node that was active before
            self._bridge = self._make_bridge()
        self._source = self._open_source()
        self._threads = [self._start(self.guarded(self._read, "source"), "can")]
        if self._bridge.poller is not None and self.values["poll"]:
            self._threads.append(self._start(self._bridge.poller.run, "can poll"))

    def end(self) -> None:
        """Stop polling and reading."""
        if self._bridge.poller is not None:
            self._bridge.poller.stop()
        if self._source is not None:
            self._source.stop()
        for thread in self._threads:
            thread.join(LONGEST_STOP)

    def statuses(self) -> list[Status]:
        """The health of the bus or of the replay of the log."""
        return self._statuses(self.health())

    def _statuses(self, health: Health) -> list[Status]:
        source = self._source
        if source is None:
            return [with_health(Status("bus", Level.OK, "not opened", {}), health)]
        if isinstance(source, LogPlayer):
            bridge = self._bridge_status(source.newest_ns)
            return [log_status(source.text, source.problem, bridge, health)]
        bus = source.status(self.steady_s()) if isinstance(source, FrameTopic) else source.status()
        statuses = [bus_status(bus, self._bridge_status(self.now_ns()), health)]
        if self._bridge.poller is not None:
            poll = self._bridge.poller.status()
            statuses.append(poll_status(poll, self._profile.experimental))
        return statuses

    def phases(self) -> list[Status]:
        """Messages of /diagnostics, except the initial conditions of every bus."""
        return [status for status in self._statuses(WELL) if status.text not in BEGINNINGS]

    def _start(self, run: Callable[[], None], name: str) -> threading.Thread:
        thread = threading.Thread(target=run, name=name, daemon=True)
        thread.start()
        return thread

    def _load_profile(self) -> CanProfile:
        if name := self.values["can_profile"]:
            return load_profile(name)
        vehicle = load_vehicle(self.values["vehicle"])
        if vehicle.can_profile is None:
            raise InputError(f"vehicle '{vehicle.key}' names no CAN profile; set can_profile")
        return load_profile(vehicle.can_profile)

    def _refuse_idle_poll(self) -> None:
        """InputError if `poll` is set but cannot work."""
        values = self.values
        if not values["poll"]:
            return
        if not self._profile.requests:
            name = self._profile.key
            raise InputError(f"poll: CAN profile '{name}' defines no requests; unset poll")
        if values["log_file"]:
            raise InputError("poll: a log answers no requests; unset poll")
        if values["interface"] == FRAMES:
            raise InputError("poll: a topic of frames answers no requests; unset poll")
        if bus_options(values["bus_options"]).get("listen_only"):
            raise InputError("poll: listen_only in bus_options forbids sending; unset one of them")

    def _make_bridge(self) -> CanBridge:
        trusted, poll = self.values["trust_profile"], self.values["poll"]
        return CanBridge(
            self._profile,
            self._send if poll else None,
            guard=None if trusted else FitGuard(self._profile, bundled_profiles()),
            sign=CurrentSign(),
        )

    def _listen_to_frames(self) -> None:
        """Subscribe to the topic `channel`; InputError if this is impossible."""
        if not is_installed(FRAMES):
            raise InputError(f"interface {FRAMES}: the package {FRAMES} is not installed")
        self._frames = frame_topic(self.values["channel"])
        try:
            self.listen(self._frames, self._take_frame)
        except InvalidTopicNameException as error:
            raise InputError(f"channel: {error}") from error

    def _take_frame(self, message: Any) -> None:
        if isinstance(self._source, FrameTopic):
            self._source.take(message, self.now_ns(), self.steady_s())

    def _open_source(self) -> BusReader | LogPlayer | FrameTopic:
        values = self.values
        on_frame = self.guarded(self._on_frame, "frame")
        if values["log_file"]:
            return LogPlayer(
                Path(values["log_file"]), values["log_rate"], values["log_delay"], on_frame
            )
        if values["interface"] == FRAMES:
            name = self.resolve_topic_name(self._frames.name)
            return FrameTopic(name, on_frame, partial(self.count_publishers, name))
        options: dict[str, Any] = dict(bus_options(values["bus_options"]))
        if values["bitrate"]:
            options.setdefault("bitrate", values["bitrate"])
        if values["interface"] == elm327.NAME:
            broadcast = {message.key[0] for message in self._profile.messages.values()}
            options |= {"requests": self._profile.requests, "broadcast": broadcast}
        return BusReader(values["interface"], values["channel"], on_frame, self.now_ns, **options)

    def _read(self) -> None:
        """Read the source until it ends; then publish readings that still waited for a check."""
        assert self._source is not None  # opened before its thread starts
        self._source.run()
        if isinstance(self._source, LogPlayer):
            with self._lock:
                readings = self._bridge.finish()
            self._publish_all(readings)

    def _send(self, frame: CanFrame) -> bool:
        return isinstance(self._source, BusReader) and self._source.send(frame)

    def _on_frame(self, frame: CanFrame) -> None:
        if self._record is not None:
            self._record.append((self.now_ns(), frame))
        with self._lock:
            readings = self._bridge.decode(frame)
        self._publish_all(readings)

    def _publish_all(self, readings: Iterable[Reading]) -> None:
        for reading in readings:
            self.publish(reading_messages(new_message, reading))

    def _bridge_status(self, now_ns: int) -> BridgeStatus:
        with self._lock:
            return self._bridge.status(now_ns)


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
    if bus.condition is BusCondition.LOST and bus.problem:
        verdict = Level.ERROR, f"{bus.problem}; trying again"
    elif bus.condition in (BusCondition.LOST, BusCondition.OFF):
        verdict = Level.ERROR, bus.problem or bus.condition.value
    elif bus.condition in (BusCondition.SILENT, BusCondition.ERRORS):
        verdict = Level.WARN, bus.condition.value
    elif bus.condition is BusCondition.CLOSED:
        verdict = Level.WARN, bus.problem or "closed"
    else:
        verdict = _level(bridge), bridge.text
    return with_health(Status("bus", *verdict, values), health)


def poll_status(poll: PollStatus, experimental: bool) -> Status:
    """Status of polling the car."""
    text = f"experimental profile: {poll.text}" if experimental else poll.text
    level = Level.OK if poll.ok and not experimental else Level.WARN
    return Status("polling", level, text, dict(poll.counters))


def log_status(text: str, problem: str | None, bridge: BridgeStatus, health: Health) -> Status:
    """The health of the CAN bridge while it plays a log."""
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
