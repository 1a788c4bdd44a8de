"""Delay of the node `energy` in answering a plan; node and planner are processes.

The planner publishes and receives bytes, because unpacking is no part of the delay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import time
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.serialization import serialize_message

from benchmarks.processes import processor_seconds
from evpinn_ros import topics
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.power_model import vehicle_model
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.processes import START_TIMEOUT, node_process, own_network
from evpinn_ros.nodes.running import new_executor
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.messages import header
from evpinn_ros.topics.model import model_message
from evpinn_ros.topics.plans import DISTANCE_JOINT, ELEVATION_JOINT

VEHICLE = "tesla_model_3_lr"
WARM_UP = 20  # plans that are not counted: the first load code and learn addresses
SETTLE = 2.0  # s for both ends to discover each other
ANSWER_TIMEOUT = 10.0  # s
PAUSE = 0.02  # s between plans


class RoundLoad(NamedTuple):
    """Delay until plans asked together are all answered with differences, and a refusal, ms."""

    rounds: int
    plans: int
    p50_ms: float
    p99_ms: float
    refusal_p50_ms: float
    refusal_p99_ms: float


class PlanLoad(NamedTuple):
    """Count and size of plans that were answered, and their delays in ms."""

    plans: int
    points: int
    p50_ms: float
    p99_ms: float
    largest_ms: float
    node_ms: float  # of the processor that the node took for one, whatever else the machine did


def measure_plans(plans: int, points: int, progress: Callable[[float], None]) -> PlanLoad:
    """Ask for plans one after the other, and time from publishing each to hearing its answer.

    The node has the model of an estimator.

    Raises:
        InputError: the node did not come up, or left a plan without an answer.
    """
    times, begin = [], 0.0
    with _planning() as (planner, node):
        for number in range(WARM_UP + plans):
            if number == WARM_UP:
                begin = processor_seconds(node)
            times.append(planner.ask(speed_profile(number, points)))
            progress(number)
            time.sleep(PAUSE)
        node_seconds = processor_seconds(node) - begin
    p50, p99, largest = np.quantile(times[WARM_UP:], (0.5, 0.99, 1.0)).tolist()
    node_s = node_seconds / plans
    return PlanLoad(plans, points, *(1e3 * seconds for seconds in (p50, p99, largest, node_s)))


def measure_rounds(
    rounds: int, plans: int, points: int, progress: Callable[[float], None]
) -> RoundLoad:
    """Ask for plans together, then for one that cannot be driven, and time the last status.

    Raises:
        InputError: the node did not come up, left a plan without an answer, or a pair of plans
            without its difference.
    """
    together, refused = [], []
    with _planning() as (planner, _):
        for number in range(WARM_UP + rounds):
            asked = [speed_profile(index, points) for index in range(plans)]
            for index, plan in enumerate(asked):
                plan.header = header(new_message, (number + 1) * NANOSECONDS, f"bench/{index}")
            together.append(planner.ask_together(asked))
            backwards = speed_profile(number, points)
            backwards.points.reverse()
            refused.append(planner.ask_together([backwards]))
            progress(number)
            time.sleep(PAUSE)
    quantiles = [
        1e3 * float(np.quantile(times[WARM_UP:], share))
        for times in (together, refused)
        for share in (0.5, 0.99)
    ]
    return RoundLoad(rounds, plans, *quantiles)


def speed_profile(number: int, points: int) -> Any:
    """A drive over hills, one second a point, as trajectory_msgs/JointTrajectory."""
    time_s = np.arange(points)
    speed = 15.0 + 8.0 * np.sin(time_s / 25.0 + number)
    distance = np.concatenate(([0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)))
    elevation = 20.0 * np.sin(distance / 700.0)
    rows = zip(distance.tolist(), elevation.tolist(), speed.tolist(), strict=True)
    return new_message(
        topics.TRAJECTORY_TYPE,
        header=header(new_message, NANOSECONDS, f"plan {number}"),
        joint_names=[DISTANCE_JOINT, ELEVATION_JOINT],
        points=[
            new_message(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=[along, height],
                velocities=[v, 0.0],
                time_from_start=new_message("builtin_interfaces/msg/Duration", sec=second),
            )
            for second, (along, height, v) in enumerate(rows)
        ],
    )


@contextmanager
def _planning() -> Iterator[tuple[_Planner, int]]:
    """A planner, and the id of the process of a node that it knows."""
    own_network()
    rclpy.init(args=[])
    try:
        planner = _Planner()
        with node_process("energy", {"vehicle": VEHICLE}) as node:
            planner.await_node()
            yield planner, node.pid
    finally:
        rclpy.try_shutdown()


class _Planner:
    """Publishes plans and receives answers."""

    def __init__(self) -> None:
        self._node = rclpy.create_node("planner", namespace=NAMESPACE)
        self._executor = new_executor()
        self._executor.add_node(self._node)
        self._plans = factory.advertise(self._node, topics.SPEED_PROFILE)
        self._model = factory.advertise(self._node, topics.MODEL)
        factory.subscribe(self._node, topics.FORECAST, self._take, raw=True)
        factory.subscribe(self._node, topics.FORECAST_STATUS, self._take_status)
        self._answered: str | None = None
        self._statuses: dict[str, int] = {}  # differences answered, by frame

    def await_node(self) -> None:
        """Wait until the node listens, and give it a model."""
        model = vehicle_model(load_vehicle(VEHICLE)).car
        self._model.publish(model_message(new_message, VEHICLE, model))
        self._spin_until(lambda: self._plans.get_subscription_count() > 0, START_TIMEOUT)
        end = time.monotonic() + SETTLE
        self._spin_until(lambda: time.monotonic() > end, START_TIMEOUT)

    def ask(self, plan: Any) -> float:
        """Publish a plan; returns the seconds until its answer was received."""
        wanted, data = plan.header.frame_id, bytes(serialize_message(plan))
        begin = time.perf_counter()
        self._plans.publish(data)
        self._spin_until(lambda: self._answered == wanted, ANSWER_TIMEOUT)
        return time.perf_counter() - begin

    def ask_together(self, plans: Sequence[Any]) -> float:
        """Publish plans; returns the seconds until every status was received."""
        frames = [plan.header.frame_id for plan in plans]
        data = [bytes(serialize_message(plan)) for plan in plans]
        self._statuses.clear()
        begin = time.perf_counter()
        for message in data:
            self._plans.publish(message)
        self._spin_until(lambda: all(f in self._statuses for f in frames), ANSWER_TIMEOUT)
        seconds = time.perf_counter() - begin
        pairs = len(plans) * (len(plans) - 1) // 2
        if sum(self._statuses.values()) != pairs:
            raise InputError(f"{pairs} differences expected, not {sum(self._statuses.values())}")
        return seconds

    def _take_status(self, message: Any) -> None:
        differences = [p.key for p in message.status[0].values if p.key.startswith("difference/")]
        self._statuses[message.header.frame_id] = len(differences)

    def _take(self, data: bytes) -> None:
        self._answered = factory.decode("std_msgs/msg/Header", data).frame_id

    def _spin_until(self, condition: Callable[[], bool], seconds: float) -> None:
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise InputError(f"the node 'energy' sent nothing for {seconds:g} s")
            self._executor.spin_once(timeout_sec=0.05)
