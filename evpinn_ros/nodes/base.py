"""Base of all nodes: parameters, guarded callbacks, counters, diagnostics, lifecycle.

Without the parameter `managed` a node configures and activates itself; otherwise `configure` makes
the endpoints, `activate` starts the work, and `cleanup` undoes both.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial, wraps
from inspect import isawaitable
import math
from pathlib import Path
import time
from typing import Any

from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn
from rclpy.node import Node

from evpinn_ros import topics
from evpinn_ros.common.errors import InputError, printable
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.arrivals import MessageNumbers
from evpinn_ros.nodes.diagnosis import LATELY, Health, Lately, Status, unused_notice
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.parameters import declare, unknown_parameters
from evpinn_ros.nodes.typed import ALWAYS, PACKAGE, TYPED, typed_message
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import BadMessage, Level, diagnostics
from evpinn_ros.topics.node_parameters import TABLES, refuse_wrong

REPORT_PERIOD = 1.0  # s, REP-107
NOT_ACTIVE = "a managed node that is not active"
UNCONFIGURED = "it waits to be configured"
NO_CLOCK = "use_sim_time is set, but no /clock comes"
VECTORS = "named_vectors"
NOT_FINITE = "output_not_finite"


class GuardedNode(LifecycleNodeMixin, ABC, Node):
    """A node whose callbacks never raise and which reports its health once a second."""

    active, configured = True, False  # whether it works; whether its parameters are in use

    def __init__(self, name: str, **kwargs: Any) -> None:
        """Declare the table's parameters; activate at once unless the node is managed."""
        self.calls: Counter[str] = Counter()  # of services, by name
        self._made: list[Callable[[], object]] = []  # functions that undo each endpoint and timer
        Node.__init__(self, name, **kwargs)
        self._table = TABLES.get(name, ())
        self.values = declare(self, self._table)  # of the parameters, by name, updated by changes
        self.received: Counter[Topic] = Counter()  # messages by input
        self.published: Counter[Topic] = Counter()  # messages by output
        self.bad: Counter[str] = Counter()  # unused messages, by topic and reason
        self._usual: set[str] = set()  # keys of `bad` that need no attention
        self._lasting: dict[str, float] = {}  # keys of `bad` that are shown once; newest, s
        self._refused: dict[str, set[str]] = {}  # reasons by input, since its last used message
        self._faults: Counter[str] = Counter()
        self._newest_fault = "", -math.inf  # text, and time, s
        self._outlets: dict[Topic, Any] = {}
        self._arrivals: dict[Topic, float] = {}
        self._inputs: dict[Topic, str] = {}
        self._numbers = MessageNumbers()
        self._lately = Lately()
        self._mismatched: dict[Topic, str] = {}
        self._notices: dict[str, tuple[str, float]] = {}
        # A timer on the node's clock would stop when that clock stands still.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._phases: dict[str, str] = {}  # text of each phase at the last check
        self._logged: dict[str, str] = {}
        self.advertise(topics.DIAGNOSTICS)
        self.every(REPORT_PERIOD, self.report)
        self.every(REPORT_PERIOD, self._log_changes)
        for problem in unknown_parameters(self, self._table):
            self.log(Level.WARN, problem)
        self._waits_for = UNCONFIGURED
        self._made.clear()  # endpoints made so far live as long as the node
        if not self.values.get("managed"):
            self.configure()
            self.configured = True
            self.begin()
            return
        self.active = False
        LifecycleNodeMixin.__init__(self)
        # A manager's request can be lost during discovery; this one cannot.
        succeeded = TransitionCallbackReturn.SUCCESS
        if not self.values["autostart"]:
            self.log(Level.OK, f"{NOT_ACTIVE}: {UNCONFIGURED}")
        elif self.trigger_configure() is succeeded:
            self.trigger_activate()

    def configure(self) -> None:
        """Make the core and its resources; InputError if a parameter or a file is wrong."""

    def let_go(self) -> None:
        """Undo `configure`, except for endpoints and timers, which the base class destroys."""

    def begin(self) -> None:
        """Acquire the resources of an active node; InputError if that fails."""

    def end(self) -> str | None:
        """Release the resources of an active node; returns what could not be saved and why."""
        return None

    def close(self) -> str | None:
        """Release everything after spinning ended; returns what could not be saved and why."""
        problem = self.end() if self.active else None
        if self.configured:
            self.let_go()
        self.active = self.configured = False
        return problem

    @abstractmethod
    def statuses(self) -> Iterable[Status]:
        """The health of the node's parts, for `/diagnostics`."""

    def phases(self) -> Iterable[Status]:
        """Texts that are logged when they change, so they contain no counts or ages."""
        return ()

    def log_start(self, text: str, known: Iterable[Status] = ()) -> None:
        """Log how the node starts; phases in `known` are not logged. InputError: unused QoS."""
        factory.refuse_unknown_overrides(self)
        self._logged = {phase.name: phase.text for phase in known}
        self.get_logger().info(printable(text))

    def respond(self, response: Any, text: str, problem: str | None = None) -> Any:
        """Fill and log the response of a service: `text`, or `problem` if it failed."""
        response.success, response.message = problem is None, problem or text
        self.log(Level.OK if problem is None else Level.WARN, response.message)
        return response

    def advertise(self, *outputs: Topic) -> None:
        """Make the publishers; InputError if only typed ones are wanted and not installed."""
        has_typed, all_typed = factory.is_installed(PACKAGE), not self.values.get(VECTORS, True)
        if all_typed and not has_typed:
            raise InputError(f"{VECTORS}: false, but {PACKAGE} is not installed")
        typed_topics = [TYPED[topic] for topic in outputs if has_typed and topic in TYPED]
        left_out = TYPED.keys() - ALWAYS if all_typed else ()
        for topic in (*(topic for topic in outputs if topic not in left_out), *typed_topics):
            outlet = factory.advertise(self, topic, partial(self._refused_by, topic))
            self._outlets[topic] = outlet
            self._made.append(partial(self.destroy_publisher, outlet))

    def listen(self, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False) -> None:
        """Subscribe to a topic (`raw`: to its CDR bytes), and report a second publisher."""

        def take(message: Any, info: Mapping[str, Any]) -> None:
            if not self.active:
                return
            self.received[topic] += 1
            now = self.steady_s()
            lost, by_turns = self._numbers.record(topic, info, now)
            if lost:
                self.bad[f"{topic.name}: lost"] += lost
            alone = by_turns and not raw  # a recorder takes topics with several publishers
            if alone and (publishers := self.count_publishers(subscription.topic_name)) > 1:
                self.notice(f"publishers {topic.name}", f"{publishers} publishers of {topic.name}")
            if topic in self._mismatched:
                del self._mismatched[topic]
            callback(message)
            self._arrivals[topic] = self._now_s(now)
            if topic.name in self._refused:
                del self._refused[topic.name]

        safe = self.guarded(take, topic.name)

        @wraps(take)
        def unpacked(*taken: Any) -> None:
            # rclpy's EventsExecutor passes a message and its info as one tuple.
            safe(*(taken[0] if len(taken) == 1 else taken))

        on_mismatch = partial(self._on_mismatch, topic)
        subscription = factory.subscribe(self, topic, unpacked, raw=raw, on_mismatch=on_mismatch)
        self._made.append(partial(self.destroy_subscription, subscription))
        if not raw:
            self._inputs[topic] = subscription.topic_name

    def create_service(
        self, kind: Any, name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Any:
        """As in rclpy, but an exception of the callback is counted and does not end the node."""

        async def safe(request: Any, response: Any) -> Any:
            self.calls[name] += 1
            try:
                answer = callback(request, response)
                return await answer if isawaitable(answer) else answer
            except Exception as error:
                self.count_fault(f"{name}: {type(error).__name__}", str(error))
                response = kind.Response()
                if hasattr(response, "message"):
                    response.message = f"internal fault: {type(error).__name__}"
                return response

        service = super().create_service(kind, name, safe, **options)
        self._made.append(partial(self.destroy_service, service))
        return service

    def every(self, seconds: float, callback: Callable[[], object]) -> None:
        """Call a callback at a period, s, of the monotonic clock."""
        safe = self.guarded(callback, getattr(callback, "__name__", "timer"))
        timer = self.create_timer(seconds, safe, clock=self._steady)
        self._made.append(partial(self.destroy_timer, timer))

    def on_clock_going_back(self, callback: Callable[[], None]) -> None:
        """Call a callback when the node's clock jumps back, as /clock does when a bag restarts."""
        threshold = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )

        def jumped(_: Any) -> None:
            self._arrivals.clear()
            callback()

        handle = self.get_clock().create_jump_callback(
            threshold, post_callback=self.guarded(jumped, "clock jump")
        )
        self._made.append(handle.unregister)

    def publish(self, messages: Iterable[tuple[Topic, Any]]) -> None:
        """Publish messages that belong together, or none if a number in them is not finite."""
        try:
            ready = [
                topic_and_message
                for topic_and_message in messages
                if self.active or topic_and_message[0] is topics.DIAGNOSTICS
            ]
        except ValueError:
            self.bad[NOT_FINITE] += 1
            return
        for topic, message in ready:
            if (typed_topic := TYPED.get(topic)) in self._outlets:
                self._outlets[typed_topic].publish(typed_message(topic, message))
                self.published[typed_topic] += 1
                if topic not in self._outlets:
                    continue
            self._outlets[topic].publish(message)
            self.published[topic] += 1

    def forget_endpoints(self) -> None:
        """Destroy the endpoints and timers made since `_made` was cleared."""
        while self._made:
            self._made.pop()()
        for kept in (self._arrivals, self._inputs, self._mismatched):
            kept.clear()
        self._outlets = {k: v for k, v in self._outlets.items() if k is topics.DIAGNOSTICS}
        self._numbers = MessageNumbers()

    def now_ns(self) -> int:
        """Time of the node's clock, ns."""
        return int(self.get_clock().now().nanoseconds)

    def notice(self, kind: str, text: str) -> None:
        """Show a text in /diagnostics for `LATELY` seconds, and log it at its first occurrence."""
        _, noticed = self._notices.get(kind, ("", -math.inf))
        self._notices[kind] = text, self.steady_s()
        if self.steady_s() - noticed > LATELY:
            self.log(Level.WARN, text)

    def steady_s(self) -> float:
        """Time of the monotonic clock, s; tests replace it."""
        return time.monotonic()

    def health(
        self,
        dropped: Mapping[str, int] | None = None,
        shown_elsewhere: Mapping[str, int] | None = None,
        usual: Collection[str] = (),
    ) -> Health:
        """Faults so far and `dropped` messages, by reason; `usual` reasons need no attention."""
        bad = {**self.bad, **(dropped or {})}
        lately = self._lately.update(self.steady_s(), {**bad, **(shown_elsewhere or {})})
        shown = {why: n for why, n in lately.items() if why not in self._usual.union(usual)}
        fault, at = self._newest_fault
        recent = fault if at > self.steady_s() - LATELY else None
        notices = tuple(self._detections(shown))
        return Health(bad, dict(self._faults), notices, recent, dict(self.calls))

    def _detections(self, lately: Mapping[str, int]) -> Iterator[str]:
        since = self.steady_s() - LATELY
        yield from (text for text, at in self._notices.values() if at > since)
        for topic, policy in self._mismatched.items():
            yield f"incompatible QoS of {topic.name}: {policy}"
        if self.get_clock().ros_time_is_active and self.now_ns() == 0:
            yield NO_CLOCK
        if not self.active:
            yield NOT_ACTIVE
        if (unused := unused_notice(lately)) is not None:
            yield unused

    def _refused_by(self, topic: Topic, policy: str) -> None:
        self.notice(topic.name, f"a subscriber of {topic.name} has incompatible QoS: {policy}")

    def _on_mismatch(self, topic: Topic, policy: str) -> None:
        self._mismatched[topic] = policy
        self.log(Level.WARN, f"incompatible QoS of {topic.name}: {policy}")

    def age(self, *either: Topic) -> float:
        """Seconds since the last used message of any of these inputs, NaN before the first."""
        arrived = [self._arrivals[topic] for topic in either if topic in self._arrivals]
        return self._now_s(self.steady_s()) - max(arrived) if arrived else math.nan

    def why_silent(self, *either: Topic) -> str:
        """The publishers of these inputs, and why their messages are not used."""
        reasons: list[str] = []
        for topic, name in self._inputs.items():
            if topic not in either or not (publishers := self.count_publishers(name)):
                continue
            known = len(reasons) + 1
            reasons.append(f"{publishers} publisher{'s' * (publishers > 1)} of {topic.name}")
            types = {info.topic_type for info in self.get_publishers_info_by_topic(name)}
            reasons += (f"of type {other}" for other in sorted(types - {topic.type_name}))
            if policy := self._mismatched.get(topic):
                reasons.append(f"incompatible QoS ({policy})")
            reasons += sorted(self._refused.get(topic.name, ()))
            if len(reasons) == known:
                reasons.append("no message")
        return ", ".join(reasons) or "nobody publishes it"

    def stream(self, topic: Topic) -> Topic:
        """The stream of an input (`SPEEDS` are one); BadMessage if a better speed is received."""
        if topic not in topics.SPEEDS:
            return topic
        for better in topics.SPEEDS[: topics.SPEEDS.index(topic)]:
            if self.received[better]:
                raise BadMessage(f"{better.name} is received", usual=True)
        return topics.SPEED

    def _now_s(self, steady: float) -> float:
        """Time for ages, s: simulated time, which may pause, if in use, else the monotonic."""
        simulated = self.get_clock().ros_time_is_active
        return self.now_ns() / NANOSECONDS if simulated else steady

    def report(self) -> None:
        """Publish the diagnostics."""
        self.publish(self._diagnostics())

    def _diagnostics(self) -> Iterator[tuple[Topic, Any]]:
        waits = Status("lifecycle", Level.WARN, f"{NOT_ACTIVE}: {self._waits_for}", {})
        statuses = self.statuses() if self.configured else [waits]
        vehicle = self.values.get("vehicle")  # a name, or the path of a file
        car = {"vehicle": Path(vehicle).stem} if vehicle else {}
        with_car = [status._replace(values=car | dict(status.values)) for status in statuses]
        yield topics.DIAGNOSTICS, self.status_message(with_car)

    def status_message(self, statuses: Iterable[Status]) -> Any:
        """diagnostic_msgs/DiagnosticArray of statuses, with the names of node and car."""
        node = self.get_fully_qualified_name()
        named: Sequence[tuple[Any, ...]] = [
            (f"{node}: {status.name}", status.level, status.text, status.values)
            for status in statuses
        ]
        return diagnostics(new_message, self.now_ns(), named, self.get_namespace())

    def _log_changes(self) -> None:
        """Log each phase whose text has changed and is the same as at the last check."""
        for phase in self.phases() if self.configured else ():
            lasts = self._phases.get(phase.name) == phase.text
            self._phases[phase.name] = phase.text
            if lasts and phase.text != self._logged.get(phase.name):
                self._logged[phase.name] = phase.text
                self.log(phase.level, phase.text)

    def log(self, level: Level, text: str) -> None:
        """Log a line; rclpy ties the severity to the calling line, so each level has its own."""
        logger, text = self.get_logger(), printable(text)
        if level is Level.ERROR:
            logger.error(text)
        elif level is Level.WARN:
            logger.warning(text)
        else:
            logger.info(text)

    def guarded(self, callback: Callable[..., object], name: str) -> Callable[..., None]:
        """Wrap a callback, so that a bad message or an internal fault cannot end the node."""

        @wraps(callback)  # rclpy passes the arguments of the signature
        def safe(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except BadMessage as error:
                self.bad[why := f"{name}: {error.reason}"] += 1
                self._refused.setdefault(name, set()).add(error.reason)
                if error.usual or error.lasting:
                    self._usual.add(why)
                if error.lasting:
                    reported, now = self._lasting.get(why, -math.inf), self.steady_s()
                    self._lasting[why] = now
                    if now - reported > LATELY:
                        self.notice(why, f"not used from now on: {why}")
            except Exception as error:
                # After any exception, the node continues with the next message.
                self.count_fault(f"{name}: {type(error).__name__}", str(error))

        return safe

    def count_fault(self, text: str, detail: str = "") -> None:
        """Count an internal fault; only its first occurrence is logged, with `detail`."""
        if not self.context.ok():
            return  # shutdown during a callback
        if text not in self._faults:
            self.get_logger().error(printable(f"{text} {detail}".strip()))
        self._faults[text] += 1
        self._newest_fault = text, self.steady_s()

    def on_configure(self, state: Any) -> Any:
        """Read parameters and files anew; the transition fails if one is wrong."""
        return self._transit(self._configure, super().on_configure, state)

    def on_activate(self, state: Any) -> Any:
        """Start to use messages and to publish."""
        return self._transit(self._activate, super().on_activate, state)

    def on_deactivate(self, state: Any) -> Any:
        """Stop working; the learned state is kept, and saved to its file."""
        return self._transit(self._deactivate, super().on_deactivate, state)

    def on_cleanup(self, state: Any) -> Any:
        """Undo `configure`; also called after a shutdown or a fault of our own."""
        return self._transit(self._clean_up, super().on_cleanup, state)

    on_shutdown = on_error = on_cleanup

    def _transit(
        self, step: Callable[[], None], entities: Callable[[Any], Any], state: Any
    ) -> Any:
        try:
            step()
        except InputError as error:
            self._waits_for = str(error)
            self.log(Level.ERROR, f"{step.__name__.strip('_').replace('_', ' ')}: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.count_fault(f"{step.__name__.strip('_')}: {type(error).__name__}", str(error))
            return TransitionCallbackReturn.ERROR
        return entities(state)

    def _configure(self) -> None:
        try:
            refuse_wrong(self._table, self.values)
            self.configure()
        except InputError:
            self._clean_up()
            raise
        self.configured = True

    def _activate(self) -> None:
        self.begin()
        self.active = True

    def _deactivate(self) -> None:
        if self.active:
            self.active = False
            if problem := self.end():
                self.log(Level.WARN, problem)

    def _clean_up(self) -> None:
        self._deactivate()
        if self.configured:
            self.let_go()
        self.configured, self._waits_for = False, UNCONFIGURED
        self.forget_endpoints()
