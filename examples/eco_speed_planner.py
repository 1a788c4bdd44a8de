#!/usr/bin/env python3
"""Asks for the energy of several ways to drive a hilly route, and picks the cheapest in time.

An example to copy: it uses only the topics of the node `energy`, and imports nothing of it.

    ros2 launch evpinn_ros eco_speed_planner.launch.py vehicle:=bmw_i3 deadline:=720.0

Once a period it publishes every candidate on `plan/speed_profile`, collects the answers from
`energy/forecast`, `energy/forecast/battery` and `energy/forecast/status`, prints a table, and
publishes the best candidate, latched, on `~/chosen`. An answer has the header of its question.
Questions with one stamp, whose frames are `asker/...`, are compared: the status of each has its
differences from the others, whose 1-sigma is far less than that of either energy. Among the
candidates that are not distinguishable from the cheapest, it picks the first to arrive.
"""

import csv
from dataclasses import dataclass, field
import math
import os
from pathlib import Path
import signal
import sys
from typing import Any

from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

GRAVITY = 9.81  # m/s^2
ACCELERATION = 1.0  # m/s^2, from the stop at the start and to the one at the end
SPACING = 50.0  # m between the points of a profile
LENT_TO_HILLS = 0.3  # share of potential energy that is taken from speed, and returned downhill
WH = 3600.0  # J

PARAMETERS = (
    ("deadline", 720.0, "Latest arrival, seconds after departure.", (1.0, 1e6)),
    ("route", "", "CSV file of the road: distance_m,elevation_m. Empty: 12 km of hills.", None),
    ("candidates", 12, "How many speed profiles to ask about.", (1, 100)),
    ("slowest", 14.0, "Cruising speed of the slowest candidate, m/s.", (1.0, 70.0)),
    ("fastest", 25.0, "Cruising speed of the fastest, and the limit of all, m/s.", (1.0, 70.0)),
    ("period", 5.0, "Seconds from one round of questions to the next.", (0.1, 3600.0)),
    ("timeout", 1.0, "Seconds that answers may take.", (0.01, 3600.0)),
)


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way to drive the route; arrays of shape (n,): s, m, m/s and m."""

    name: str
    time: np.ndarray
    distance: np.ndarray
    speed: np.ndarray
    elevation: np.ndarray

    @property
    def arrival(self) -> float:
        """Seconds after departure."""
        return float(self.time[-1])


@dataclass
class Answer:
    """Energy of a candidate, J, with 1-sigma, and the battery at its end, 0..1; NaN if unknown.

    Attributes:
        status: values of the status by key; None until it is received.
        refusal: why there is no energy; empty if there is.
        more: energy beyond that of other candidates, by their index: J with 1-sigma.
    """

    energy: float = math.nan
    sigma: float = math.nan
    battery: float = math.nan
    status: dict[str, str] | None = None
    refusal: str = ""
    more: dict[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Whether all parts of the answer were received."""
        if self.status is None or self.refusal:
            return bool(self.refusal)
        battery = math.isnan(self.battery) and "battery" in self.status
        return not (math.isnan(self.energy) or battery)


def hills() -> tuple[np.ndarray, np.ndarray]:
    """Distance and elevation, m, of the default route."""
    s = np.linspace(0.0, 12_000.0, 241)
    z = 100.0 - 30.0 * np.cos(s * math.tau / 4000.0) + 6.0 * np.sin(s * math.tau / 1300.0)
    return s, z


def read_route(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Distance and elevation, m, from a CSV file with the columns distance_m and elevation_m.

    Raises:
        ValueError: the file is not a route.
    """
    try:
        with path.open(newline="") as file:
            rows = [(row["distance_m"], row["elevation_m"]) for row in csv.DictReader(file)]
        route = np.array(rows, dtype=float)
    except KeyError as error:
        raise ValueError(f"{path}: has no column {error}") from error
    except (OSError, ValueError, csv.Error) as error:
        raise ValueError(f"{path}: {error}") from error
    if len(route) < 2 or not np.isfinite(route).all() or (np.diff(route[:, 0]) <= 0).any():
        raise ValueError(f"{path}: needs two or more finite rows with rising distance_m")
    length = route[-1, 0] - route[0, 0]
    s = np.linspace(0.0, length, max(3, round(length / SPACING) + 1))
    return s, np.interp(s, route[:, 0] - route[0, 0], route[:, 1])


def speed_profile(
    name: str, s: np.ndarray, z: np.ndarray, cruise: float, lent: float, fastest: float
) -> Candidate:
    """A drive from stop to stop at a cruising speed, some of which is lent to the hills.

    With `lent` = 0 speed is steady. Otherwise this share of the potential energy is exchanged with
    speed, without the losses of motor and battery.
    """
    squared = cruise**2 - 2 * GRAVITY * lent * (z - z.mean())
    squared = np.clip(squared, (cruise / 2) ** 2, fastest**2)
    ramps = 2 * ACCELERATION * np.minimum(s, s[-1] - s)
    speed = np.sqrt(np.minimum(squared, ramps))
    # Constant acceleration between points: the mean speed is that of the ends.
    time = np.concatenate(([0.0], np.cumsum(2 * np.diff(s) / (speed[1:] + speed[:-1]))))
    return Candidate(name, time, s, speed, z)


def all_candidates(
    s: np.ndarray, z: np.ndarray, number: int, slowest: float, fastest: float
) -> list[Candidate]:
    """Cruising speeds from slowest to fastest, each steady and with the hills."""
    styles = {"steady": 0.0, "with the hills": LENT_TO_HILLS}
    speeds = np.linspace(slowest, fastest, math.ceil(number / len(styles)))
    made = [
        speed_profile(f"{cruise * 3.6:.0f} km/h {style}", s, z, cruise, lent, fastest)
        for cruise in speeds
        for style, lent in styles.items()
    ]
    return made[:number]


def difference(answers: list[Answer], first: int, other: int) -> tuple[float, float]:
    """Energy of one candidate beyond another, J, and its 1-sigma, NaN where unknown."""
    if first == other:
        return 0.0, 0.0
    if other in answers[first].more:
        return answers[first].more[other]
    less, sigma = answers[other].more.get(first, (math.nan, math.nan))
    return -less, sigma


def cheapest_in_time(
    candidates: list[Candidate], answers: list[Answer], deadline: float
) -> int | None:
    """Index of the first to arrive among the cheapest and those within 1-sigma of it.

    Only candidates in time count; the slowest of them without any answer; None if all are late.
    """
    in_time = [i for i, candidate in enumerate(candidates) if candidate.arrival <= deadline]
    answered = [i for i in in_time if not math.isnan(answers[i].energy)]
    if answered:
        cheapest = min(answered, key=lambda i: answers[i].energy)
        apart = {i: difference(answers, i, cheapest) for i in answered}
        alike = [i for i in answered if i == cheapest or apart[i][0] < apart[i][1]]
        return min(alike, key=lambda i: candidates[i].arrival)
    return max(in_time, key=lambda i: candidates[i].arrival, default=None)


def table(
    candidates: list[Candidate], answers: list[Answer], deadline: float, pick: int | None
) -> str:
    """A table of the candidates, in minutes and Wh."""
    head = f"{'candidate':24} {'arrival':>8} {'energy':>9} {'sigma':>8} {'more':>16}"
    lines = [f"{head} {'battery':>8}"]
    for index, (candidate, answer) in enumerate(zip(candidates, answers, strict=True)):
        minutes, seconds = divmod(round(candidate.arrival), 60)
        none = "refused" if answer.refusal else "no answer"
        energy = _number(answer.energy / WH, ".0f", " Wh", none)
        more = ""
        if pick is not None and index != pick:
            apart, beside = difference(answers, index, pick)
            more = _number(apart / WH, "+.0f", f" +-{beside / WH:4.0f} Wh", "")
        sigma = _number(answer.sigma / WH, ".0f", " Wh", "")
        battery = _number(answer.battery * 100, ".1f", " %", "")
        remark = "late" if candidate.arrival > deadline else "<- picked" if index == pick else ""
        row = f"{candidate.name:24} {minutes:5}:{seconds:02} {energy:>9} {sigma:>8} {more:>16}"
        row = f"{row} {battery:>8}"
        lines.append(f"{row}  {remark}".rstrip())
    return "\n".join(lines)


def _number(value: float, form: str, unit: str, unknown: str) -> str:
    return unknown if math.isnan(value) else f"{value:{form}}{unit}"


def profile_message(candidate: Candidate, header: Header) -> JointTrajectory:
    """The message for the node `energy`; heights are in the joint `elevation`."""
    points = []
    for time, distance, speed, elevation in zip(
        candidate.time, candidate.distance, candidate.speed, candidate.elevation, strict=True
    ):
        nanoseconds = round(time * 1e9)
        start = Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        # Every joint needs a velocity; that of elevation is not read.
        point = JointTrajectoryPoint(
            positions=[distance, elevation], velocities=[speed, 0.0], time_from_start=start
        )
        points.append(point)
    return JointTrajectory(header=header, joint_names=["distance", "elevation"], points=points)


class EcoSpeedPlanner(Node):
    """Asks, waits for answers or for the timeout, decides, and starts over.

    Attributes:
        candidates: all ways to drive.
        answers: to each of them, of the newest round.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Ask first after one period; `kwargs` go to rclpy's Node.

        Raises:
            ValueError: the route or the speeds are wrong.
            ParameterException: another parameter is wrong.
        """
        super().__init__("eco_speed_planner", **kwargs)
        for name, default, description, ends in PARAMETERS:
            self.declare_parameter(name, default, _descriptor(name, description, ends))
        if self._value("slowest") > self._value("fastest"):
            raise ValueError("slowest must not be above fastest")
        path = self._value("route")
        s, z = read_route(Path(path).expanduser()) if path else hills()
        speeds = self._value("slowest"), self._value("fastest")
        self.candidates = all_candidates(s, z, self._value("candidates"), *speeds)
        self.answers = [Answer() for _ in self.candidates]
        self._open: dict[tuple[str, int, int], int] = {}  # candidates by header

        # A round is asked at once: the queues must hold all its questions and answers.
        depth = len(self.candidates)
        self._questions = self.create_publisher(JointTrajectory, "plan/speed_profile", depth)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._chosen = self.create_publisher(JointTrajectory, "~/chosen", latched)
        self.create_subscription(JointTrajectory, "energy/forecast", self._on_forecast, depth)
        battery = "energy/forecast/battery"
        self.create_subscription(BatteryState, battery, self._on_battery, depth)
        status = "energy/forecast/status"
        self.create_subscription(DiagnosticArray, status, self._on_status, depth)
        # A clock that never stops or jumps, as that of a simulation does.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(self._value("period"), self._ask, clock=steady)
        self._timeout = self.create_timer(self._value("timeout"), self._decide, clock=steady)
        self._timeout.cancel()

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _ask(self) -> None:
        if self._open:
            return  # the round before still waits
        stamp = self.get_clock().now().to_msg()
        self.answers = [Answer() for _ in self.candidates]
        for index, candidate in enumerate(self.candidates):
            header = Header(stamp=stamp, frame_id=self._frame(index))
            self._open[_key(header)] = index
            self._questions.publish(profile_message(candidate, header))
        self._timeout.reset()

    def _on_forecast(self, message: JointTrajectory) -> None:
        index = self._open.get(_key(message.header))
        if index is None or not message.points:
            return  # the answer to another planner, or a late one
        end, answer = message.points[-1], self.answers[index]
        answer.energy = end.positions[0]
        answer.sigma = end.effort[0] if end.effort else math.nan
        self._decide_early()

    def _on_battery(self, message: BatteryState) -> None:
        index = self._open.get(_key(message.header))
        if index is not None:
            self.answers[index].battery = message.percentage
            self._decide_early()

    def _on_status(self, message: DiagnosticArray) -> None:
        index = self._open.get(_key(message.header))
        if index is None or not message.status:
            return
        status, answer = message.status[0], self.answers[index]
        answer.status = {pair.key: pair.value for pair in status.values}
        answer.refusal = "" if status.level == DiagnosticStatus.OK else status.message
        for other in range(len(self.candidates)):
            name = self._frame(other)
            if (apart := answer.status.get(f"difference/{name}")) is not None:
                sigma = answer.status[f"difference_sigma/{name}"]
                answer.more[other] = float(apart), float(sigma)
        self._decide_early()

    def _frame(self, index: int) -> str:
        # The node's full name distinguishes these questions from those of other planners.
        return f"{self.get_fully_qualified_name()}/{index}"

    def _decide_early(self) -> None:
        """Decide before the timeout if all answers are complete."""
        if all(answer.complete for answer in self.answers):
            self._decide()

    def _decide(self) -> None:
        self._timeout.cancel()
        self._open.clear()
        deadline = self._value("deadline")
        pick = cheapest_in_time(self.candidates, self.answers, deadline)
        print(table(self.candidates, self.answers, deadline, pick), flush=True)
        if all(math.isnan(answer.energy) for answer in self.answers):
            self._say_why_no_answer()
        if pick is None:
            fastest = min(candidate.arrival for candidate in self.candidates)
            self.get_logger().warning(
                f"none arrives in {deadline:g} s; the fastest: {fastest:.0f}"
            )
            return
        if self.answers[pick].battery == 0.0:
            self.get_logger().warning("the battery will be empty before the end of this route")
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self.candidates[pick].name)
        self._chosen.publish(profile_message(self.candidates[pick], header))

    def _say_why_no_answer(self) -> None:
        if refused := next((a.refusal for a in self.answers if a.refusal), ""):
            why = f"the energy node refuses: {refused}"
        elif self._questions.get_subscription_count():
            why = "the energy node did not answer; its /diagnostics say why"
        else:
            why = f"no energy node listens to {self._questions.topic_name}"
        self.get_logger().warning(f"{why}. Without energies the slowest in time is picked.")


def _key(header: Header) -> tuple[str, int, int]:
    return header.frame_id, header.stamp.sec, header.stamp.nanosec


def _descriptor(name: str, description: str, ends: Any) -> ParameterDescriptor:
    # Only the deadline is read anew for each round.
    descriptor = ParameterDescriptor(description=description, read_only=name != "deadline")
    if ends is not None and isinstance(ends[0], int):
        descriptor.integer_range = [IntegerRange(from_value=ends[0], to_value=ends[1])]
    elif ends is not None:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=ends[0], to_value=ends[1])
        ]
    return descriptor


def main() -> int:
    """Plan until a signal; returns the exit code."""
    # rclpy itself ends at SIGINT; without this, Python would also raise KeyboardInterrupt.
    signal.signal(signal.SIGINT, lambda *_: None)
    rclpy.init()
    try:
        rclpy.spin(EcoSpeedPlanner())
    except (ValueError, ParameterException) as error:
        sys.stderr.write(f"eco_speed_planner: {error}\n")
        return 1
    except ExternalShutdownException:
        pass
    except RuntimeError:
        if rclpy.ok():
            raise
        # The shutdown came in the middle of a callback.
    finally:
        rclpy.try_shutdown()
        # Launch repeats the terminal's signal, which would kill Python while it ends.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return 0


if __name__ == "__main__":
    exit_code = main()
    sys.stdout.flush()
    # Without taking its publishers to pieces: Fast DDS may hang there for ever while others leave.
    os._exit(exit_code)
