"""Newest messages of running nodes with their times of arrival, s; without ROS or a clock."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Mapping
import math
from typing import Any, NamedTuple

from evpinn_ros import topics
from evpinn_ros.common.errors import printable
from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.core.energy.charge import UNKNOWN, Uncertain
from evpinn_ros.core.estimation.operating_range import MANNERS, SPEEDS
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.topics import Topic
from evpinn_ros.topics.estimates import POWER, bounds_of
from evpinn_ros.topics.messages import BadMessage, Level, NamedVector, read_named_vector
from evpinn_ros.topics.readings import ChargeScale, to_reading

VECTORS = (
    topics.PARAMETERS,
    topics.BOUNDS,
    topics.POWER_MEASURED,
    topics.POWER_PREDICTED,
    topics.ENERGY_STATE,
    topics.ENERGY_BREAKDOWN,
    topics.ENERGY_CONSUMPTION,
    topics.ENERGY_RANGE,
)
WATCHED = (*topics.SPEEDS, topics.BATTERY, *VECTORS, topics.DIAGNOSTICS)
POWERS = {topics.POWER_MEASURED: "measured", topics.POWER_PREDICTED: "predicted"}
NODES = ("can_bridge", "estimator", "energy", "recorder")

STALE_AFTER = 3.0  # s without a message
RATE_WINDOW = 5.0  # s over which messages are counted
MOST_ARRIVALS = 5000  # of a topic, for its rate
MOST_PARTS = 50  # of all followed nodes; ours have ten
LEAST_DISTANCE = 100.0  # m; a consumption over less means nothing
BIN_NS = 500_000_000  # bins of the power line
KEPT_BINS = 600  # five minutes
STARTED_OVER_NS = 10 * 10**9  # stamps further back mean a restart
NOTHING = "nothing received yet: are nodes up (evpinn run), with this ROS_DOMAIN_ID?"


class ParameterRow(NamedTuple):
    """One parameter; NaN and empty text if not received."""

    name: str
    value: float
    std: float
    lower: float
    upper: float
    prior_share: float
    progress: float
    state: str


class PartStatus(NamedTuple):
    """Newest status of a part of a node, and its time of arrival, s."""

    level: Level
    text: str
    values: Mapping[str, str]
    arrived: float


class PowerHistory:
    """Mean power of each half second, for several kinds of power."""

    def __init__(self) -> None:
        self.newest_ns: int | None = None  # the newest stamp of any kind, None before the first
        self._bins: dict[str, dict[int, tuple[float, int]]] = {}

    def add(self, kind: str, stamp_ns: int, power: float) -> None:
        """Add one value, W; the line restarts when time does."""
        if self.newest_ns is not None and stamp_ns < self.newest_ns - STARTED_OVER_NS:
            self._bins.clear()
            self.newest_ns = None
        self.newest_ns = max(stamp_ns, self.newest_ns or stamp_ns)
        bins = self._bins.setdefault(kind, {})
        index = stamp_ns // BIN_NS
        total, count = bins.get(index, (0.0, 0))
        bins[index] = total + power, count + 1
        while len(bins) > KEPT_BINS:
            del bins[min(bins)]

    def last(self, kind: str, count: int) -> list[float]:
        """The newest `count` bins, W, oldest first; NaN for an empty bin."""
        bins = self._bins.get(kind, {})
        if self.newest_ns is None:
            return [math.nan] * count
        end = self.newest_ns // BIN_NS + 1
        sums = (bins.get(index) for index in range(end - count, end))
        return [
            math.nan if sum_and_count is None else sum_and_count[0] / sum_and_count[1]
            for sum_and_count in sums
        ]


class LiveData:
    """Takes messages, and returns the values that a screen shows."""

    def __init__(self, namespace: str = topics.NAMESPACE, units: Units = METRIC) -> None:
        self.units, self._namespace = units, namespace.strip("/")
        self.speed = math.nan  # m/s, NaN while unknown
        self.battery: BatteryReading | None = None  # the last reading, None before the first
        self.line = PowerHistory()  # power of the last minutes
        self.statuses: dict[str, PartStatus] = {}  # of the parts of our nodes, by `node: part`
        self.unusable: Counter[str] = Counter()  # messages without a usable value, by topic
        self._elsewhere: set[str] = set()  # namespaces of nodes like ours
        self._vectors: dict[Topic, NamedVector] = {}
        self._arrivals: defaultdict[Topic, deque[float]] = defaultdict(
            lambda: deque(maxlen=MOST_ARRIVALS)
        )
        self._first: dict[Topic, float] = {}
        self._last: dict[Topic, float] = {}
        self._charge_scale = ChargeScale()

    def take(self, topic: Topic, message: Any, now: float) -> None:
        """Take a message of rclpy or rosbags from a topic of `WATCHED` at `now`, s."""
        self._first.setdefault(topic, now)
        self._last[topic] = now
        self._arrivals[topic].append(now)
        try:
            self._read(topic, message, now)
        except BadMessage:
            self.unusable[topic.name] += 1

    def _read(self, topic: Topic, message: Any, now: float) -> None:
        if topic is topics.DIAGNOSTICS:
            for status in message.status:
                self._take_status(status, now)
        elif topic not in VECTORS:
            reading = self._charge_scale.reading(to_reading(topic.type_name, message))
            if isinstance(reading, SpeedReading):
                self.speed = reading.speed
            elif isinstance(reading, BatteryReading):
                self.battery = reading
        else:
            vector = self._vectors[topic] = read_named_vector(message)
            if topic in POWERS and POWER in vector.values:
                self.line.add(POWERS[topic], vector.stamp_ns, vector.values[POWER])

    def _take_status(self, status: Any, now: float) -> None:
        node, _, part = status.name.partition(":")
        namespace, _, node = node.strip("/").rpartition("/")
        if node not in NODES:
            return  # of another node: all nodes share this topic
        if namespace != self._namespace:
            if len(self._elsewhere) < MOST_PARTS:
                self._elsewhere.add(printable(f"/{namespace}"))
            return
        # rclpy stores a byte as bytes, rosbags as int.
        level = status.level if isinstance(status.level, int) else status.level[0]
        values = {pair.key: printable(pair.value) for pair in status.values}
        known = Level(min(level, Level.STALE))
        text = printable(status.message)
        name = printable(f"{node}:{part}")
        if name not in self.statuses and len(self.statuses) >= MOST_PARTS:
            self.unusable[topics.DIAGNOSTICS.name] += 1
            return
        self.statuses[name] = PartStatus(known, text, values, now)

    def age(self, topic: Topic, now: float) -> float:
        """Seconds since the last message of a topic, infinite before the first."""
        return now - self._last.get(topic, -math.inf)

    def rate(self, topic: Topic, now: float) -> float:
        """Messages per second in the last `RATE_WINDOW`."""
        arrivals = self._arrivals[topic]
        while arrivals and arrivals[0] <= now - RATE_WINDOW:
            arrivals.popleft()
        span = min(max(now - self._first.get(topic, now), 1.0), RATE_WINDOW)
        return len(arrivals) / span

    def power(self, topic: Topic, now: float) -> Uncertain:
        """Measured or predicted power, W, unknown if its topic is silent."""
        if self.age(topic, now) >= STALE_AFTER:
            return UNKNOWN
        values, sigmas = self.vector(topic), self.sigmas(topic)
        return Uncertain(values.get(POWER, math.nan), sigmas.get(POWER, math.nan))

    def fresh_speed(self, now: float) -> float:
        """Speed, m/s, NaN if its topic is silent."""
        age = min(self.age(topic, now) for topic in topics.SPEEDS)
        return self.speed if age < STALE_AFTER else math.nan

    def fresh_battery(self, now: float) -> BatteryReading | None:
        """The newest battery reading, None if its topic is silent."""
        return self.battery if self.age(topics.BATTERY, now) < STALE_AFTER else None

    def vector(self, topic: Topic) -> Mapping[str, float]:
        """The last values of a named vector, empty before the first."""
        vector = self._vectors.get(topic)
        return {} if vector is None else vector.values

    def sigmas(self, topic: Topic) -> Mapping[str, float]:
        """The last 1-sigmas of a named vector, empty if not received."""
        vector = self._vectors.get(topic)
        return {} if vector is None else vector.sigmas

    def charge(self) -> float:
        """State of charge, 0..1, projected to now or else as last received; NaN if unknown."""
        received = math.nan if self.battery is None else self.battery.state_of_charge
        return self.vector(topics.ENERGY_RANGE).get("state_of_charge", received)

    def consumption(self) -> float:
        """Wh/km of this trip, which the node publishes from 1 km on; NaN below 100 m."""
        consumption = self.vector(topics.ENERGY_CONSUMPTION)
        distance = consumption.get("distance_trip", 0.0)
        if "wh_per_km_trip" in consumption or distance < LEAST_DISTANCE:
            return consumption.get("wh_per_km_trip", math.nan)
        consumed = self.vector(topics.ENERGY_STATE).get("consumed", math.nan)
        return consumed / 3600.0 / (distance / 1000.0)

    def parameters(self) -> list[ParameterRow]:
        """All parameters, received or not."""
        values, sigmas = self.vector(topics.PARAMETERS), self.sigmas(topics.PARAMETERS)
        bounds, status = self.vector(topics.BOUNDS), self._estimator()
        return [
            ParameterRow(
                name,
                values.get(name, math.nan),
                sigmas.get(name, math.nan),
                **bounds_of(bounds, name),
                progress=_number(status.get(f"progress.{name}")),
                state=status.get(f"state.{name}", ""),
            )
            for name in PARAMETER_NAMES
        ]

    def seen(self) -> list[list[float]]:
        """Counts of learned samples: rows by `MANNERS`, columns by `SPEEDS`."""
        values = self._estimator()
        return [
            [_number(values.get(f"seen.{speed}_kmh_{manner}")) for speed in SPEEDS]
            for manner in MANNERS
        ]

    def band_coverage(self) -> float:
        """Share of recent samples in the 90 % band of power/predicted, NaN if not received."""
        return _number(self._estimator().get("in_90_band.predicted"))

    @property
    def received(self) -> bool:
        """True once any message was received."""
        return bool(self._last)

    def problems(self, now: float) -> list[tuple[Level, str]]:
        """(level, text) of each problem, the worst first."""
        if not self.received:
            return [(Level.WARN, NOTHING)]
        if not self.statuses:
            run = f"; nodes run under {', '.join(sorted(self._elsewhere))} (--namespace)"
            known = run if self._elsewhere else ""
            problems = [(Level.WARN, f"no /diagnostics of our nodes yet{known}")]
        else:
            problems = [
                (status.level, f"{name}: {status.text}")
                for name, status in self.statuses.items()
                if status.level is not Level.OK and now - status.arrived < STALE_AFTER
            ]
        silent: dict[str, float] = {}
        for name, status in self.statuses.items():
            node = name.partition(":")[0]
            silent[node] = min(silent.get(node, math.inf), now - status.arrived)
        problems += [
            (Level.ERROR, f"{node}: has sent nothing for {age:.0f} s")
            for node, age in silent.items()
            if age >= STALE_AFTER
        ]
        problems += [
            (Level.WARN, f"{name}: {count} messages were not usable")
            for name, count in self.unusable.items()
        ]
        return sorted(problems, key=lambda problem: problem[0], reverse=True)

    def activity(self, now: float) -> str:
        """Text of the estimator's status; empty if it is silent."""
        status = self.statuses.get("estimator: estimate")
        return status.text if status is not None and now - status.arrived < STALE_AFTER else ""

    def _estimator(self) -> Mapping[str, str]:
        status = self.statuses.get("estimator: estimate")
        return {} if status is None else status.values


def _number(text: str | None) -> float:
    """A value of a status; NaN if it was not received or is no number."""
    try:
        return math.nan if text is None else float(text)
    except ValueError:
        return math.nan
