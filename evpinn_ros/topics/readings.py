"""Conversion between readings and messages, both ways; errors as in `messages`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
import math
from typing import Any, NamedTuple

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import (
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    GradeReading,
    MotorReading,
    PressureReading,
    Reading,
    SpeedReading,
    TemperatureReading,
    WindReading,
)
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import (
    VEHICLE_FRAME,
    BadMessage,
    NewMessage,
    finite,
    header,
    named_vector,
    not_negative,
    read_named_vector,
    scalar,
    stamp_ns,
    usable,
)

HEATING = "heating"
TORQUE, MOTOR_SPEED = "torque", "speed"
UNIT_TOLERANCE = 0.02  # of |q|^2: passes float32 drivers and rounded logs, but no unset quaternion

# Constants of the message definitions (sensor_msgs 5.x), the same for every class family.
STATUS_FIX, COVARIANCE_UNKNOWN = 0, 0
SUPPLY_UNKNOWN, SUPPLY_DISCHARGING = 0, 2
FLOAT32_MAX = 3.4028234663852886e38
MOST_BATTERIES, LEAST_CHANGES = 8, 10  # batteries that are counted; changes from one to another
OVERFULL = 1.5  # largest charge on a scale of 0..1
NOT_PROVIDED = -1.0  # first element of a covariance: the quantity was not measured


def speed_message(new: NewMessage, reading: SpeedReading) -> Any:
    """Forward speed; an unknown variance is 0, the convention of ROS."""
    variance = 0.0 if math.isnan(reading.variance) else not_negative(reading.variance)
    linear = new("geometry_msgs/msg/Vector3", x=finite(reading.speed))
    twist = new("geometry_msgs/msg/Twist", linear=linear)
    return new(
        topics.SPEED_TYPE,
        header=header(new, reading.stamp_ns, VEHICLE_FRAME),
        twist=new(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=twist,
            covariance=[variance] + 35 * [0.0],
        ),
    )


def battery_message(new: NewMessage, reading: BatteryReading) -> Any:
    """Voltage, current (negative discharges) and charge; the status is never CHARGING."""
    if not (math.isnan(reading.state_of_charge) or 0 <= reading.state_of_charge <= 1):
        raise ValueError(f"state of charge {reading.state_of_charge} is outside 0..1")
    return new(
        topics.BATTERY_TYPE,
        header=header(new, reading.stamp_ns),
        voltage=_float32(reading.voltage),
        current=_float32(reading.current),
        percentage=float(reading.state_of_charge),
        **dict.fromkeys(("temperature", "charge", "capacity", "design_capacity"), math.nan),
        power_supply_status=SUPPLY_DISCHARGING if reading.current < 0 else SUPPLY_UNKNOWN,
        present=True,
    )


def _float32(value: float) -> float:
    if abs(value) > FLOAT32_MAX:
        raise ValueError(f"{value} does not fit a 32-bit number")
    return float(value)


def imu_message(new: NewMessage, reading: GradeReading) -> Any:
    """Attitude only: uphill is negative pitch (REP-103); rates and accelerations not provided."""
    half = -finite(reading.grade) / 2
    not_provided = [NOT_PROVIDED] + 8 * [0.0]
    return new(
        topics.IMU_TYPE,
        header=header(new, reading.stamp_ns, VEHICLE_FRAME),
        orientation=new("geometry_msgs/msg/Quaternion", y=math.sin(half), w=math.cos(half)),
        angular_velocity_covariance=not_provided,
        linear_acceleration_covariance=not_provided,
    )


def altitude_message(new: NewMessage, reading: AltitudeReading) -> Any:
    """Altitude, latitude and longitude, or NaN; STATUS_FIX marks it as valid."""
    return new(
        topics.FIX_TYPE,
        header=header(new, reading.stamp_ns, VEHICLE_FRAME),
        status=new("sensor_msgs/msg/NavSatStatus", status=STATUS_FIX, service=0),
        latitude=reading.latitude,
        longitude=reading.longitude,
        altitude=finite(reading.altitude),
        position_covariance_type=COVARIANCE_UNKNOWN,
    )


def temperature_message(new: NewMessage, reading: TemperatureReading) -> Any:
    """Ambient temperature; variance 0 means unknown."""
    return new(
        topics.TEMPERATURE_TYPE,
        header=header(new, reading.stamp_ns),
        temperature=finite(reading.celsius),
    )


def pressure_message(new: NewMessage, reading: PressureReading) -> Any:
    """Pressure of the outside air; variance 0 means unknown."""
    return new(
        topics.PRESSURE_TYPE,
        header=header(new, reading.stamp_ns),
        fluid_pressure=finite(reading.pascal),
    )


def wind_message(new: NewMessage, reading: WindReading) -> Any:
    """Velocity of the air over ground in the car's frame: a head wind blows towards -x."""
    return new(
        topics.WIND_TYPE,
        header=header(new, reading.stamp_ns, VEHICLE_FRAME),
        vector=new("geometry_msgs/msg/Vector3", x=-finite(reading.head)),
    )


def auxiliary_message(new: NewMessage, reading: AuxiliaryReading) -> Any:
    """Named vector of the loads `heating` and `others`, W."""
    loads = [reading.heating, reading.others]
    return named_vector(new, reading.stamp_ns, [HEATING, "others"], loads)


def motor_message(new: NewMessage, reading: MotorReading) -> Any:
    """Named vector of `torque`, N m, and, if known, of `speed`, rad/s."""
    values = {TORQUE: reading.torque}
    if not math.isnan(reading.speed):
        values[MOTOR_SPEED] = reading.speed
    return named_vector(new, reading.stamp_ns, [*values], [*values.values()])


def reading_message(new: NewMessage, reading: Reading) -> Any:
    """The message of any reading; the inverse of `to_reading`."""
    return _WRITTEN[type(reading)][1](new, reading)


def to_reading(type_name: str, message: Any, mounting: Rotation | None = None) -> Reading:
    """The reading in a message; `mounting` is that of an Imu. BadMessage has the reason."""
    if type_name == topics.IMU_TYPE:
        return grade_reading(message, mounting)
    try:
        reader = _READERS[type_name]
    except KeyError:
        raise BadMessage("unknown_type") from None
    return reader(message)


def reading_messages(new: NewMessage, reading: Reading) -> Iterator[tuple[Topic, Any]]:
    """The message of a reading, and for plots voltage and current; ValueError if not finite."""
    yield READING_TOPICS[type(reading)], reading_message(new, reading)
    if isinstance(reading, BatteryReading):
        if not math.isnan(reading.voltage):
            yield topics.BATTERY_VOLTAGE, scalar(new, reading.voltage)
        if not math.isnan(reading.current):
            yield topics.BATTERY_CURRENT, scalar(new, reading.current)


class Rotation(NamedTuple):
    """An attitude as a unit quaternion."""

    x: float
    y: float
    z: float
    w: float


def rotation(roll: float, pitch: float, yaw: float) -> Rotation:
    """The rotation by roll, then pitch, then yaw about fixed axes, rad (REP-103)."""
    sx, sy, sz = (math.sin(angle / 2) for angle in (roll, pitch, yaw))
    cx, cy, cz = (math.cos(angle / 2) for angle in (roll, pitch, yaw))
    return Rotation(
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz - sx * sy * cz,
        cx * cy * cz + sx * sy * sz,
    )


def grade_reading(message: Any, mounting: Rotation | None = None) -> GradeReading:
    """Grade of an Imu: positive pitch is nose down (REP-103), so grade = -pitch.

    `mounting` is the rotation from `base_link` to the frame of the message; without it, that frame
    must be `base_link`.
    """
    if message.orientation_covariance[0] == NOT_PROVIDED:
        raise BadMessage("no_orientation", lasting=True)
    q = message.orientation
    # Products, because `**` of a huge number raises OverflowError; a product is infinite.
    square = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z
    if not abs(square - 1) <= UNIT_TOLERANCE:
        raise BadMessage("quaternion_not_unit")
    stamp, frame = stamp_ns(message), message.header.frame_id
    in_car = frame.rpartition("/")[2] == VEHICLE_FRAME  # `robot1/base_link` too
    if not in_car and mounting is None:
        raise BadMessage(f"frame '{frame}' is not base_link: set imu_rotation_rpy", lasting=True)
    if not in_car and mounting is not None:
        q = _undo(q, mounting)
    sine = 2 * (q.w * q.y - q.z * q.x) / square
    return GradeReading(stamp, -math.asin(max(-1.0, min(1.0, sine))))


def _undo(q: Any, mounting: Rotation) -> Rotation:
    """The orientation of the car: that of the sensor, q, times the inverse of the mounting."""
    x, y, z, w = -mounting.x, -mounting.y, -mounting.z, mounting.w
    return Rotation(
        q.w * x + q.x * w + q.y * z - q.z * y,
        q.w * y - q.x * z + q.y * w + q.z * x,
        q.w * z + q.x * y - q.y * x + q.z * w,
        q.w * w - q.x * x - q.y * y - q.z * z,
    )


def speed_reading(message: Any) -> SpeedReading:
    """Speed of a TwistWithCovarianceStamped; a variance of 0 or less means unknown."""
    variance = float(message.twist.covariance[0])
    has_variance = 0 < variance < math.inf
    speed = usable(message.twist.twist.linear.x)
    return SpeedReading(stamp_ns(message), speed, variance if has_variance else math.nan)


def odometry_reading(message: Any) -> SpeedReading:
    """Speed over ground of an Odometry, with the sign of its forward component.

    A twist in the frame of a map has no forward component: its magnitude counts.
    """
    forward, sideways = (usable(getattr(message.twist.twist.linear, axis)) for axis in "xy")
    size = math.hypot(forward, sideways)
    speed = size if in_frame_of_map(message) else math.copysign(size, forward)
    return replace(speed_reading(message), speed=speed)


def in_frame_of_map(message: Any) -> bool:
    """True if the twist of an Odometry is in the frame of its pose, not in the car's."""
    return bool(message.child_frame_id) and message.child_frame_id == message.header.frame_id


def velocity_report_reading(message: Any) -> SpeedReading:
    """Speed of a VelocityReport, which has no variance."""
    return SpeedReading(stamp_ns(message), usable(message.longitudinal_velocity))


def battery_reading(message: Any) -> BatteryReading:
    """Voltage and current, NaN if not measured; percentage as sent, NaN outside 0..100."""
    voltage, current, charge = map(float, (message.voltage, message.current, message.percentage))
    charge = charge if 0 <= charge <= 100 else math.nan
    if math.isinf(voltage) or math.isinf(current):
        raise BadMessage("not_finite")
    if math.isnan(voltage) and math.isnan(current) and math.isnan(charge):
        raise BadMessage("nothing_measured")
    return BatteryReading(stamp_ns(message), voltage, current, charge)


class Batteries:
    """Counts the batteries of one topic, by serial number, location and frame."""

    def __init__(self) -> None:
        self.names: dict[str, None] = {}
        self._last, self._changes = "", 0

    def add(self, message: Any) -> None:
        """Count a change if the battery of this message differs from the last one."""
        parts = message.serial_number, message.location, message.header.frame_id
        name = "/".join(filter(None, parts))
        self._changes += bool(self._last) and name != self._last
        self._last = name
        if len(self.names) < MOST_BATTERIES:
            self.names[name] = None

    @property
    def take_turns(self) -> bool:
        """True if batteries alternate; a replaced battery changes only once."""
        return self._changes >= LEAST_CHANGES


class ChargeScale:
    """Scale of a publisher's state of charge: 0..1, or 0..100 once a value is far above 1.

    Decided once, as 1 % would look full on 0..100. Before, values slightly above 1 are unknown.
    """

    def __init__(self) -> None:
        self._full = 1.0

    def reading(self, reading: Reading) -> Reading:
        """The reading with its state of charge as 0..1, or NaN."""
        if not isinstance(reading, BatteryReading) or math.isnan(reading.state_of_charge):
            return reading
        if reading.state_of_charge > OVERFULL:
            self._full = 100.0
        if self._full == 1.0 and reading.state_of_charge <= 1.0:
            return reading
        charge = reading.state_of_charge / self._full
        return replace(reading, state_of_charge=charge if charge <= 1.0 else math.nan)


def altitude_reading(message: Any) -> AltitudeReading:
    """Altitude and, if possible, position of a NavSatFix, valid from STATUS_FIX on."""
    if message.status.status < STATUS_FIX:
        raise BadMessage("no_fix", usual=True)
    stamp, altitude = stamp_ns(message), usable(message.altitude)
    reading = AltitudeReading(stamp, altitude, message.latitude, message.longitude)
    return reading if reading.has_position else AltitudeReading(stamp, altitude)


def temperature_reading(message: Any) -> TemperatureReading:
    """Ambient temperature of a Temperature."""
    return TemperatureReading(stamp_ns(message), usable(message.temperature))


def pressure_reading(message: Any) -> PressureReading:
    """Pressure of a FluidPressure."""
    return PressureReading(stamp_ns(message), usable(message.fluid_pressure))


def wind_reading(message: Any) -> WindReading:
    """Head wind of a Vector3Stamped in `base_link`."""
    if message.header.frame_id != VEHICLE_FRAME:
        raise BadMessage("wind_not_in_base_link")
    return WindReading(stamp_ns(message), -usable(message.vector.x))


def auxiliary_reading(message: Any) -> AuxiliaryReading:
    """The named loads, W: the sum of those with `heating` in their name, and of all others."""
    vector = read_named_vector(message)
    if not vector.values:
        raise BadMessage("nothing_measured")
    heating, others = (
        sum(load for name, load in vector.values.items() if (HEATING in name.lower()) is wanted)
        for wanted in (True, False)
    )
    return AuxiliaryReading(vector.stamp_ns, heating, others)


def motor_reading(message: Any) -> MotorReading:
    """Torque, N m, and speed, rad/s, of a named vector; other names are ignored."""
    vector = read_named_vector(message)
    if TORQUE not in vector.values:
        raise BadMessage("nothing_measured")
    speed = vector.values.get(MOTOR_SPEED, math.nan)
    return MotorReading(vector.stamp_ns, vector.values[TORQUE], speed)


def _named_vector_reading(message: Any) -> AuxiliaryReading | MotorReading:
    """The reading in a JointState: of a motor if it has a `torque`, else of loads."""
    return motor_reading(message) if TORQUE in message.name else auxiliary_reading(message)


_READERS: Mapping[str, Callable[[Any], Reading]] = {
    topics.SPEED_TYPE: speed_reading,
    topics.ODOMETRY_TYPE: odometry_reading,
    topics.VELOCITY_REPORT_TYPE: velocity_report_reading,
    topics.BATTERY_TYPE: battery_reading,
    topics.FIX_TYPE: altitude_reading,
    topics.TEMPERATURE_TYPE: temperature_reading,
    topics.PRESSURE_TYPE: pressure_reading,
    topics.WIND_TYPE: wind_reading,
    topics.NAMED_VECTOR_TYPE: _named_vector_reading,
}

_WRITTEN: Mapping[type[Reading], tuple[Topic, Callable[[NewMessage, Any], Any]]] = {
    SpeedReading: (topics.SPEED, speed_message),
    BatteryReading: (topics.BATTERY, battery_message),
    GradeReading: (topics.IMU, imu_message),
    AltitudeReading: (topics.FIX, altitude_message),
    TemperatureReading: (topics.TEMPERATURE, temperature_message),
    PressureReading: (topics.PRESSURE, pressure_message),
    WindReading: (topics.WIND, wind_message),
    AuxiliaryReading: (topics.AUXILIARY_POWER, auxiliary_message),
    MotorReading: (topics.MOTOR_TORQUE, motor_message),
}
READING_TOPICS = {kind: topic for kind, (topic, _) in _WRITTEN.items()}
"""Topic on which each type of reading is written."""
