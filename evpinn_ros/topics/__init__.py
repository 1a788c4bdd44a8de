"""Every topic of this package; names are relative to `NAMESPACE`, except `/diagnostics`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

NAMESPACE = "/ev"
QUEUE_DEPTH = 100
TYPED = "typed"  # namespace of the same topics as messages of evpinn_msgs
FROM_THE_CAR = ("the car", "can_bridge")

SPEED_TYPE = "geometry_msgs/msg/TwistWithCovarianceStamped"
BATTERY_TYPE = "sensor_msgs/msg/BatteryState"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
VELOCITY_REPORT_TYPE = "autoware_vehicle_msgs/msg/VelocityReport"
IMU_TYPE = "sensor_msgs/msg/Imu"
FIX_TYPE = "sensor_msgs/msg/NavSatFix"
TEMPERATURE_TYPE = "sensor_msgs/msg/Temperature"
NAMED_VECTOR_TYPE = "sensor_msgs/msg/JointState"
ARRAY_TYPE = "std_msgs/msg/Float64MultiArray"
PRESSURE_TYPE = "sensor_msgs/msg/FluidPressure"
WIND_TYPE = "geometry_msgs/msg/Vector3Stamped"
SCALAR_TYPE = "std_msgs/msg/Float64"
PATH_TYPE = "nav_msgs/msg/Path"
TRAJECTORY_TYPE = "trajectory_msgs/msg/JointTrajectory"
AUTOWARE_TRAJECTORY_TYPE = "autoware_planning_msgs/msg/Trajectory"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
FRAME_TYPE = "can_msgs/msg/Frame"


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service: keep-last history with this depth, defaults otherwise."""

    reliable: bool
    transient_local: bool
    depth: int


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of the contract: its name, type, content and quality of service."""

    name: str  # relative to the namespace, or absolute
    source: str  # its publisher
    description: str  # content, in one line
    unit: str = ""  # of the content; empty if it has several or none
    type_name: str = NAMED_VECTOR_TYPE  # `package/msg/Type`
    latched: bool = False  # a late subscriber gets the last message
    depth: int = QUEUE_DEPTH  # of its queues; 1 if latched

    @property
    def package(self) -> str:
        """The package of the message type."""
        return self.type_name.partition("/")[0]

    @property
    def publisher_qos(self) -> Qos:
        """Reliable, which suits every subscriber, with the same depth; depth 1 if latched."""
        depth = 1 if self.latched else self.depth
        return Qos(reliable=True, transient_local=self.latched, depth=depth)

    @property
    def subscriber_qos(self) -> Qos:
        """Best effort for streams of the car, else reliable; the depth suits replay at 10 x."""
        if self.source in FROM_THE_CAR:
            return Qos(reliable=False, transient_local=False, depth=self.depth)
        depth = 1 if self.latched else self.depth
        return Qos(reliable=True, transient_local=self.latched, depth=depth)

    def under(self, namespace: str = NAMESPACE) -> str:
        """The full name, for example `/ev/vehicle/speed`."""
        return self.name if self.name.startswith("/") else f"{namespace.rstrip('/')}/{self.name}"

    def matches(self, full_name: str) -> bool:
        """True if a full name is this topic, under any namespace; False for its typed twin."""
        name = self.name.lstrip("/")
        is_twin = full_name.endswith(f"/{TYPED}/{name}")
        return full_name == self.name or (full_name.endswith(f"/{name}") and not is_twin)


SPEED = Topic(
    "vehicle/speed",
    "can_bridge",
    "`twist.twist.linear.x` in frame `base_link`, with the variance of its resolution",
    "m/s",
    type_name=SPEED_TYPE,
)
ODOMETRY = Topic(
    "odom",
    "the car",
    "optional: `twist.twist.linear.x` as speed, until `vehicle/speed` is received",
    "m/s",
    type_name=ODOMETRY_TYPE,
)
VELOCITY_REPORT = Topic(
    "vehicle/status/velocity_status",
    "the car",
    "optional, of Autoware: `longitudinal_velocity` as speed, until `vehicle/speed` or `odom` is "
    "received",
    "m/s",
    type_name=VELOCITY_REPORT_TYPE,
)
SPEEDS = SPEED, ODOMETRY, VELOCITY_REPORT
"""Topics of speed; the first of them that is received is used."""
BATTERY = Topic(
    "battery/state",
    "can_bridge",
    "voltage and current of one moment, negative current discharges; NaN where not measured",
    "V, A",
    type_name=BATTERY_TYPE,
)
BATTERY_VOLTAGE = Topic(
    "battery/voltage", "can_bridge", "the same voltage, for plots", "V", type_name=SCALAR_TYPE
)
BATTERY_CURRENT = Topic(
    "battery/current",
    "can_bridge",
    "the same current, for plots; negative discharges",
    "A",
    type_name=SCALAR_TYPE,
)
IMU = Topic(
    "vehicle/imu",
    "the car",
    "optional grade source: grade = -pitch in `base_link`; another frame needs `imu_rotation_rpy`",
    "rad",
    type_name=IMU_TYPE,
)
FIX = Topic(
    "vehicle/fix",
    "the car",
    "optional grade source: altitude over distance",
    "m",
    type_name=FIX_TYPE,
)
TEMPERATURE = Topic(
    "environment/temperature",
    "the car",
    "optional: ambient temperature, for the density of air",
    "degC",
    type_name=TEMPERATURE_TYPE,
)
PRESSURE = Topic(
    "environment/pressure",
    "the car",
    "optional: pressure of the air outside, for its density",
    "Pa",
    type_name=PRESSURE_TYPE,
)
WIND = Topic(
    "environment/wind",
    "the car",
    "optional: velocity of the air over ground in `base_link`; a head wind is negative x",
    "m/s",
    type_name=WIND_TYPE,
)
AUXILIARY_POWER = Topic(
    "auxiliary/power",
    "can_bridge",
    "optional: power of known loads by name, `heating` and others; heating counts only below 20 "
    "degC outside",
    "W",
)
MOTOR_TORQUE = Topic(
    "vehicle/motor_torque",
    "can_bridge",
    "optional: `torque`, the sum over all motors at the shaft, positive drives forward, and their "
    "`speed` if known",
    "N m, rad/s",
)
PARAMETERS = Topic(
    "estimate/parameters",
    "estimator",
    "`eta, mu, mass, c_rr, c_d, p_aux`: live value and 1-sigma",
    "1, 1, kg, 1, 1, W",
)
IDENTIFIABLE = Topic(
    "estimate/identifiable",
    "estimator",
    "combinations that the data alone determines: "
    "`mass_over_eta, drag_area_over_eta, c_rr, regeneration, p_aux`",
    "kg, m^2, 1, 1, W",
)
BOUNDS = Topic(
    "estimate/bounds",
    "estimator",
    "`<parameter>_lower`, `_upper`, `_prior_share` (0 = all data, 1 = all prior)",
)
RELIABLE = Topic(
    "estimate/reliable",
    "estimator",
    "the last parameters that passed every validity check",
    "1, 1, kg, 1, 1, W",
    latched=True,
)
PARAMETER_SCALARS = tuple(
    Topic(f"estimate/{name}", "estimator", f"live {text}, for plots", unit, type_name=SCALAR_TYPE)
    for name, text, unit in (
        ("eta", "drive efficiency", "1"),
        ("mu", "regeneration efficiency", "1"),
        ("mass", "mass", "kg"),
        ("c_rr", "rolling resistance", "1"),
        ("c_d", "drag coefficient", "1"),
    )
)
LAG = Topic(
    "estimate/lag",
    "estimator",
    "`lag` by which speed is stamped later than the battery, with its 1-sigma, once known",
    "s",
)
MODEL = Topic(
    "estimate/model",
    "estimator",
    "for the node `energy`: the linear model that predicts power, every 10 s; the label of its "
    "first dimension is `vehicle/version`",
    type_name=ARRAY_TYPE,
    latched=True,
)
POWER_MEASURED = Topic("power/measured", "estimator", "`power`: voltage x current", "W")
POWER_PREDICTED = Topic(
    "power/predicted",
    "estimator",
    "`power` for the newest sample; never uses that sample's voltage or current",
    "W",
)
POWER_SMOOTHED = Topic(
    "power/smoothed",
    "estimator",
    "`power` of the sample `smoothing_lag` before the newest, from speeds up to the newest; never "
    "uses voltage or current of its own or later samples",
    "W",
)
ENERGY_BREAKDOWN = Topic(
    "energy/breakdown",
    "estimator",
    "1 Hz: energy since the start by cause, long stops included: `air, tyres, slope, speed, "
    "brakes, drivetrain, climate, standing, unexplained`, which add up to `measured`; also "
    "`regained`. effort 1-sigma; not published in `mode: paper`",
    "J",
)
ENERGY_STATE = Topic(
    "energy/state",
    "energy",
    "since the last reset: `measured, predicted, rknn, regenerated` and `consumed` (measured "
    "where possible, else predicted): position J, velocity W, effort 1-sigma J",
    "J",
)
ENERGY_CONSUMED = Topic(
    "energy/consumed", "energy", "energy drawn since the last reset", "J", type_name=SCALAR_TYPE
)
ENERGY_TOTALS = Topic(
    "energy/totals",
    "energy",
    "1 Hz: `net, drawn, regenerated` since the last reset, and over the lifetime as "
    "`lifetime_...`",
    "J",
)
ENERGY_CONSUMPTION = Topic(
    "energy/consumption",
    "energy",
    "1 Hz: `wh_per_km_1`, `_10`, `_100` over the last 1, 10, 100 km, `_trip` since the last "
    "reset, `_lifetime`; each once that distance is driven, the last two after 1 km. "
    "`distance_trip`, `distance_lifetime`",
    "Wh/km, m",
)
ENERGY_RANGE = Topic(
    "energy/range",
    "energy",
    "1 Hz: `distance_to_empty` with `distance_lower`, `distance_upper` of its 90 % band, "
    "`usable_energy`, `state_of_charge`, `capacity`, effort 1-sigma; unknown values are left out. "
    "After a plan whose frame has no `/`, the distance is along its route, until the route is "
    "driven or twice its duration has passed",
    "m, J, 1",
)
PLAN = Topic("plan", "planner", "stamped poses; z is elevation", "m", type_name=PATH_TYPE)
SPEED_PROFILE = Topic(
    "plan/speed_profile",
    "planner",
    "joint `distance`: positions m, velocities m/s, `time_from_start`; optional joint "
    "`elevation`: positions m, else the road is flat",
    "m, m/s",
    type_name=TRAJECTORY_TYPE,
)
TRAJECTORY = Topic(
    "plan/trajectory",
    "planner",
    "optional, of Autoware: poses with `longitudinal_velocity_mps` and, where they rise, "
    "`time_from_start`; z is elevation",
    "m, m/s",
    type_name=AUTOWARE_TRAJECTORY_TYPE,
)
CONDITIONS = Topic(
    "plan/conditions",
    "planner",
    "optional, for all later plans: `temperature` degC, `heating` W, `head_wind` m/s, "
    "`payload` kg, `charge` 0..1, `stood` s before the start, `prewarmed` 0..1, `steady` 0 or 1; "
    "NaN or missing: the last known value",
)
FORECAST = Topic(
    "energy/forecast",
    "energy",
    "joint `energy`: positions J, velocities W, effort 1-sigma J; with the plan's header",
    "J, W",
    type_name=TRAJECTORY_TYPE,
)
FORECAST_STATUS = Topic(
    "energy/forecast/status",
    "energy",
    "one for every plan, with the plan's header: OK with `energy`, `sigma`, `battery` and the "
    "`difference` to each plan asked together with it, or WARN with the reason of refusal",
    "J",
    type_name=DIAGNOSTICS_TYPE,
)
FORECAST_BATTERY = Topic(
    "energy/forecast/battery",
    "energy",
    "the battery at the end of the plan; not published while the state of charge is unknown. "
    "Its voltage is NaN until a minute of voltage, current and state of charge was received",
    "1",
    type_name=BATTERY_TYPE,
)
DIAGNOSTICS = Topic(
    "/diagnostics", "all", "1 Hz: state, reasons, counters", type_name=DIAGNOSTICS_TYPE
)

_VALUES = (value if isinstance(value, tuple) else (value,) for value in [*globals().values()])
TOPICS = tuple(dict.fromkeys(topic for topic in chain(*_VALUES) if isinstance(topic, Topic)))
INPUTS = tuple(topic for topic in TOPICS if topic.source in FROM_THE_CAR)


def topic_of(full_name: str) -> Topic | None:
    """The topic of this package with this full name, under any namespace; None if unknown."""
    return next((topic for topic in TOPICS if topic.matches(full_name)), None)
