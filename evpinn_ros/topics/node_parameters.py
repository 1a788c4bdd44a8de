"""Table of all parameters of the nodes, from which they are declared, checked and documented.

It imports neither ROS nor the cores; a test compares the words and limits repeated here with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import TypeAlias

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.vehicle.files import load_vehicle

OF_EVERY_NODE = ("use_sim_time", "qos_overrides", "start_type_description_service")
"""First words of the parameters that rclpy adds to every node."""

FRAMES = "can_msgs"
"""`interface` of a bus that another node reads, and package of that node's messages."""

Value: TypeAlias = bool | int | float | str

TYPE_NAMES: Mapping[type, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number with a decimal point",
    str: "text",
}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a node."""

    name: str  # in the parameter file
    default: Value  # also defines the type
    description: str  # one line for people
    unit: str = ""  # SI, empty if it has none
    lower: float = -math.inf  # smallest value of a number
    upper: float = math.inf  # largest value of a number
    choices: tuple[str, ...] = ()  # allowed texts, empty if any is allowed
    read_only: bool = True  # fixed once the node runs
    # further check of a text that is not empty; raises InputError
    verify: Callable[[str], object] | None = None

    def problem(self, value: object) -> str | None:
        """Reason why a value is refused, None if it is accepted."""
        if type(value) is not type(self.default):
            return f"{self.name} = {value} must be {TYPE_NAMES[type(self.default)]}"
        if isinstance(value, (int, float)) and not self.lower <= value <= self.upper:
            return f"{self.name} = {value:g} is outside [{self.lower:g}, {self.upper:g}]"
        if self.choices and value not in self.choices:
            return f"{self.name} '{value}' is not one of {', '.join(self.choices)}"
        if self.verify is not None and value:
            try:
                self.verify(str(value))
            except InputError as error:
                return f"{self.name}: {error}"
        return None


def _known_profile(name: str) -> None:
    # Imported here: cantools takes long to import, and only a bus needs it.
    from evpinn_ros.can.profile import load_profile

    load_profile(name)


def _known_interface(name: str) -> None:
    from evpinn_ros.can.bus import INTERFACES  # imported here: python-can takes long too

    if name != FRAMES and name not in INTERFACES:
        raise InputError(f"known are {', '.join(sorted({FRAMES, *INTERFACES}))}")


VEHICLE = Parameter(
    "vehicle",
    "generic",
    "Name of a vehicle in config/vehicles, or path of a vehicle file.",
    verify=load_vehicle,
)
TIME_JUMP_POLICY = Parameter(
    "time_jump_policy",
    "auto",
    "When the stamps of vehicle/speed go back, as when a bag restarts: reset to the state at the "
    "start (energy: the trip only, as lifetime totals never fall), hold what was learned or "
    "counted and continue at the new time, or ignore late messages; auto resets if /clock went "
    "back too, and holds otherwise.",
    choices=("auto", "reset", "hold", "ignore"),
    read_only=False,
)
TIME_JUMP_THRESHOLD = Parameter(
    "time_jump_threshold",
    2.0,
    "Least step back of an input's stamps that counts as a jump of time; smaller ones are "
    "messages out of order.",
    "s",
    0.05,
    3600.0,
    read_only=False,
)

MANAGED = Parameter(
    "managed",
    False,
    "Make this a managed (lifecycle) node, which waits to be configured and activated: `ros2 "
    "lifecycle set ...`. Until it is active it sends only /diagnostics.",
)
AUTOSTART = Parameter(
    "autostart", False, "Let a managed node configure and activate itself at its start."
)
NAMED_VECTORS = Parameter(
    "named_vectors",
    True,
    "Publish estimates as named vectors too. False, if evpinn_msgs is installed: only as typed "
    "messages, except the three that the node energy reads.",
)

ESTIMATOR = (
    VEHICLE,
    MANAGED,
    AUTOSTART,
    NAMED_VECTORS,
    Parameter(
        "mode",
        "hybrid",
        "Learner: hybrid (filter and network, the default) or paper (EV-PINN as published).",
        choices=("hybrid", "paper"),
    ),
    Parameter(
        "regen_form",
        "recovery",
        "Form of the paper's eq. 21; only for mode paper.",
        choices=("printed", "recovery", "wheel_power"),
    ),
    Parameter(
        "paper_optimizer",
        "adam",
        "Optimizer of mode paper: adam, as published, or gauss_newton, which reaches a lower "
        "loss.",
        choices=("adam", "gauss_newton"),
    ),
    Parameter(
        "smoothing_lag",
        0.3,
        "Delay of power/smoothed, so that it can use later speeds.",
        "s",
        0.0,
        1.5,
    ),
    Parameter(
        "allowed_lateness",
        0.3,
        "Time to wait for late readings before they are sorted by stamp.",
        "s",
        0.0,
        10.0,
    ),
    Parameter("max_gap", 2.5, "Longest gap of speed or battery that is bridged.", "s", 0.1, 60.0),
    Parameter(
        "grade_source",
        "auto",
        "Source of the grade; auto uses vehicle/imu if it is received, otherwise vehicle/fix.",
        choices=("auto", "none", "imu", "fix"),
    ),
    Parameter(
        "imu_rotation_rpy",
        "",
        "How the IMU is mounted: roll, pitch and yaw from base_link to the frame it reports in, "
        "as a static transform has them: '0 0 1.571'. Empty: only an IMU in base_link is used.",
        "rad",
        verify=lambda text: roll_pitch_yaw(text),
    ),
    Parameter("seed", 0, "Seed of the networks.", lower=0, upper=2**31 - 1),
    Parameter(
        "wait_for_update",
        False,
        "Wait for each windowed update: same numbers at any speed of replay. Not for live use.",
    ),
    Parameter(
        "state_file",
        "",
        "File that keeps what was learned between drives: read at the start, written once a "
        "minute, at ~/save and at the end. Empty: none.",
    ),
    TIME_JUMP_POLICY,
    TIME_JUMP_THRESHOLD,
)
ENERGY = (
    VEHICLE,
    MANAGED,
    AUTOSTART,
    NAMED_VECTORS,
    Parameter(
        "integrator",
        "rknn",
        "Integrator of the predicted power while the battery is not measured: the paper's "
        "Runge-Kutta network, or the trapezoidal rule. energy/state has both.",
        choices=("rknn", "trapezoid"),
    ),
    Parameter("max_gap", 2.0, "Longest gap of power that is integrated.", "s", 0.1, 2.0),
    Parameter(
        "nominal_speed",
        0.0,
        "Speed assumed for a plan without times; 0: that of the vehicle file, or 50 km/h if it "
        "has none. For a robot its usual speed, such as 1.0.",
        "m/s",
        0.0,
        100.0,
        read_only=False,
    ),
    Parameter(
        "energy_file",
        "",
        "File that keeps totals, consumption and learned capacity between drives: read at the "
        "start, appended to before they are published, written anew once a minute, at ~/save and "
        "at the end. Empty: none.",
    ),
    TIME_JUMP_POLICY,
    TIME_JUMP_THRESHOLD,
)
CAN_BRIDGE = (
    VEHICLE,
    MANAGED,
    AUTOSTART,
    Parameter(
        "can_profile",
        "",
        "Name of a CAN profile in config/can, or path of a profile. Empty: that of the vehicle.",
        verify=_known_profile,
    ),
    Parameter(
        "trust_profile",
        False,
        "Publish values even if the traffic of the bus contradicts the profile.",
    ),
    Parameter(
        "interface",
        "socketcan",
        "Driver of the CAN adapter, as python-can calls it; or can_msgs: frames of a topic, as "
        "ros2_socketcan publishes them.",
        verify=_known_interface,
    ),
    Parameter(
        "channel",
        "can0",
        "Channel of the adapter: can0, /dev/ttyACM0...; for can_msgs the topic: from_can_bus.",
    ),
    Parameter(
        "bitrate",
        500_000,
        "Bit rate of the bus; 0 leaves it to the driver.",
        "bit/s",
        0,
        8_000_000,
    ),
    Parameter(
        "bus_options",
        "",
        "More options of the driver, as 'name=value name=value', for example 'listen_only=true'.",
        verify=lambda text: bus_options(text),
    ),
    Parameter(
        "poll",
        False,
        "Send read requests for the values that the profile requests. They keep the car awake, "
        "which drains its 12 V battery: see docs/explanation/can.md.",
    ),
    Parameter(
        "log_file",
        "",
        "CAN log, or bag of raw frames, to replay with its stamps instead of reading a bus.",
    ),
    Parameter(
        "log_rate",
        1.0,
        "Speed of that replay: 1 is real time, 0 as fast as possible.",
        lower=0.0,
        upper=1000.0,
    ),
    Parameter(
        "log_delay",
        2.0,
        "Time before that replay begins, so that its subscribers can connect.",
        "s",
        0.0,
        3600.0,
    ),
)

TABLES: Mapping[str, tuple[Parameter, ...]] = {
    "can_bridge": CAN_BRIDGE,
    "estimator": ESTIMATOR,
    "energy": ENERGY,
}


def of_node(name: str, values: Mapping[str, Value]) -> dict[str, Value]:
    """The values that are parameters of this node."""
    names = {parameter.name for parameter in TABLES[name]}
    return {key: value for key, value in values.items() if key in names}


def refuse_wrong(table: tuple[Parameter, ...], values: Mapping[str, object]) -> None:
    """Raise InputError for wrong values; missing ones have defaults, unknown ones are ignored."""
    all_values = {
        parameter.name: values.get(parameter.name, parameter.default) for parameter in table
    }
    for parameter in table:
        if problem := parameter.problem(all_values[parameter.name]):
            raise InputError(problem)
    late, jump = all_values.get("allowed_lateness"), all_values.get("time_jump_threshold")
    if isinstance(late, float) and isinstance(jump, float) and jump <= late:
        raise InputError(
            f"time_jump_threshold = {jump:g} must be above allowed_lateness = {late:g}"
        )


def roll_pitch_yaw(text: str) -> tuple[float, float, float] | None:
    """The three angles of `imu_rotation_rpy`, rad, or None if empty; InputError if wrong."""
    if not text.strip():
        return None
    try:
        roll, pitch, yaw = map(float, text.replace(",", " ").split())
    except ValueError as error:
        raise InputError(f"'{text}' is not three angles in rad") from error
    if not all(abs(angle) <= 2 * math.pi for angle in (roll, pitch, yaw)):
        raise InputError(f"'{text}': an angle exceeds a full turn; give rad, not degrees")
    return roll, pitch, yaw


def bus_options(text: str) -> dict[str, Value]:
    """Options of a bus from `name=value name=value`; InputError if wrong."""
    options: dict[str, Value] = {}
    for word in text.split():
        name, equals, value = word.partition("=")
        if not (name.isidentifier() and equals and value):
            raise InputError(f"'{word}' is not of the form name=value")
        options[name] = _value(value)
    return options


def _value(text: str) -> Value:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
