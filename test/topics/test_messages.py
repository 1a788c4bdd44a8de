from collections.abc import Callable
from dataclasses import astuple
import importlib
import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.bags.types import decode, encode, new_message, typestore
from evpinn_ros.core.signals.readings import (
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    GradeReading,
    MotorReading,
    PressureReading,
    SpeedReading,
    TemperatureReading,
    WindReading,
)
from evpinn_ros.topics import (
    DIAGNOSTICS,
    INPUTS,
    PLAN,
    POWER_SMOOTHED,
    RELIABLE,
    SPEED,
    TOPICS,
    messages,
    topic_of,
)
from evpinn_ros.topics import readings as reading_messages
from evpinn_ros.topics.messages import BadMessage, Level

NOW = 1_700_000_000_123_456_789
NUMBERS = st.floats(-1e6, 1e6, width=32)
STAMPS = st.integers(1, 2**31 * 10**9 - 1)
READINGS = st.one_of(
    st.builds(SpeedReading, STAMPS, NUMBERS, st.floats(1e-9, 1e3) | st.just(math.nan)),
    st.builds(BatteryReading, STAMPS, NUMBERS, NUMBERS, st.floats(0, 1, width=32)),
    st.builds(BatteryReading, STAMPS, NUMBERS, st.just(math.nan)),
    st.builds(AltitudeReading, STAMPS, NUMBERS),
    st.builds(AltitudeReading, STAMPS, NUMBERS, st.floats(-90, 90), st.floats(-180, 180)).filter(
        lambda reading: reading.has_position
    ),
    st.builds(TemperatureReading, STAMPS, NUMBERS),
    st.builds(PressureReading, STAMPS, NUMBERS),
    st.builds(WindReading, STAMPS, NUMBERS),
    st.builds(AuxiliaryReading, STAMPS, NUMBERS, NUMBERS),
    st.builds(MotorReading, STAMPS, NUMBERS, NUMBERS | st.just(math.nan)),
)


def rclpy_message(type_name: str, /, **fields: Any) -> Any:
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)(check_fields=True, **fields)


def through_cdr(message: Any) -> Any:
    return decode(message.__msgtype__, encode(message))


@settings(deadline=None)
@given(READINGS)
def test_a_reading_survives_the_message_and_its_bytes(reading):
    message = through_cdr(reading_messages.reading_message(new_message, reading))
    again = reading_messages.to_reading(message.__msgtype__, message)
    assert type(again) is type(reading)
    assert astuple(again) == pytest.approx(astuple(reading), rel=0, abs=0, nan_ok=True)


@settings(deadline=None)
@given(STAMPS, st.floats(-1.5, 1.5))
def test_grade_survives_the_quaternion(stamp, grade):
    message = reading_messages.imu_message(new_message, GradeReading(stamp, grade))
    assert reading_messages.grade_reading(message).grade == pytest.approx(grade, abs=1e-7)


def test_grade_is_minus_pitch():
    pitch = 0.1  # about the y axis, which points left: the nose goes down
    q = new_message("geometry_msgs/msg/Quaternion", y=math.sin(pitch / 2), w=math.cos(pitch / 2))
    imu = new_message(
        "sensor_msgs/msg/Imu", header=messages.header(new_message, NOW, "base_link"), orientation=q
    )
    assert reading_messages.grade_reading(imu).grade == pytest.approx(-0.1)


ANGLE = st.floats(-math.pi, math.pi)


def matrix_of(angles):
    """A rotation as a matrix, by other means than the code under test."""
    (cr, cp, cy), (sr, sp, sy) = ([f(a) for a in angles] for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def imu_in(frame, angles):
    q = reading_messages.rotation(*angles)
    return new_message(
        "sensor_msgs/msg/Imu",
        header=messages.header(new_message, NOW, frame),
        orientation=new_message("geometry_msgs/msg/Quaternion", **q._asdict()),
    )


@settings(deadline=None)
@given(st.tuples(ANGLE, st.floats(-1.4, 1.4), ANGLE), st.tuples(ANGLE, ANGLE, ANGLE))
def test_an_imu_mounted_anyhow_tells_the_grade_of_the_car(car, mounted):
    matrix = matrix_of(car) @ matrix_of(mounted)
    pitch = math.asin(max(-1.0, min(1.0, -matrix[2, 0])))
    roll, yaw = math.atan2(matrix[2, 1], matrix[2, 2]), math.atan2(matrix[1, 0], matrix[0, 0])
    if abs(pitch) > 1.5:
        return  # roll and yaw are one there
    message = imu_in("imu_link", (roll, pitch, yaw))
    mounting = reading_messages.rotation(*mounted)
    grade = reading_messages.grade_reading(message, mounting).grade
    assert grade == pytest.approx(-car[1], abs=1e-6)


def test_an_imu_of_another_frame_is_refused_without_its_mounting():
    looks_down = imu_in("camera_imu_optical_frame", (0.0, 0.4, 0.0))
    with pytest.raises(messages.BadMessage, match="'camera_imu_optical_frame' is not base_link"):
        reading_messages.grade_reading(looks_down)
    with pytest.raises(messages.BadMessage, match="'' is not base_link"):
        reading_messages.grade_reading(imu_in("", (0.0, 0.4, 0.0)))
    mounting = reading_messages.rotation(0.0, 0.4, 0.0)
    assert reading_messages.grade_reading(looks_down, mounting).grade == pytest.approx(0.0)
    prefixed = imu_in("robot1/base_link", (0.0, 0.1, 0.0))
    assert reading_messages.grade_reading(prefixed, mounting).grade == pytest.approx(-0.1)


def stamped(type_name: str, **fields: Any) -> Any:
    return new_message(type_name, header=messages.header(new_message, NOW), **fields)


def no_fix() -> Any:
    status = new_message("sensor_msgs/msg/NavSatStatus", status=-1)
    return stamped("sensor_msgs/msg/NavSatFix", status=status, altitude=400.0)


def nan_speed() -> Any:
    message = reading_messages.speed_message(new_message, SpeedReading(NOW, 1.0))
    message.twist.twist.linear.x = math.nan
    return message


BAD: list[tuple[str, Callable[[], Any]]] = [
    ("no_stamp", lambda: new_message(SPEED.type_name)),
    ("not_finite", nan_speed),
    ("not_finite", lambda: stamped("sensor_msgs/msg/BatteryState", voltage=math.inf)),
    ("nothing_measured", lambda: stamped(
        "sensor_msgs/msg/BatteryState", voltage=math.nan, current=math.nan, percentage=-1.0)),
    ("no_orientation", lambda: stamped(
        "sensor_msgs/msg/Imu", orientation_covariance=[-1.0] + 8 * [0.0])),
    ("quaternion_not_unit", lambda: stamped("sensor_msgs/msg/Imu")),
    ("quaternion_not_unit", lambda: stamped(  # found by fuzzing: its power raises
        "sensor_msgs/msg/Imu",
        orientation=new_message("geometry_msgs/msg/Quaternion", w=1e200))),
    ("no_fix", no_fix),
    ("not_finite", lambda: stamped("sensor_msgs/msg/NavSatFix", altitude=math.nan)),
    ("not_finite", lambda: stamped("sensor_msgs/msg/Temperature", temperature=math.nan)),
    ("nothing_measured", lambda: stamped("sensor_msgs/msg/JointState")),
    ("lengths_differ", lambda: stamped("sensor_msgs/msg/JointState", name=["a", "b"],
                                       position=[1.0])),
    ("lengths_differ", lambda: stamped("sensor_msgs/msg/JointState", name=["a"])),
    ("lengths_differ", lambda: stamped("sensor_msgs/msg/JointState", name=["a", "a"],
                                       position=[1.0, 2.0])),
    ("not_finite", lambda: stamped("sensor_msgs/msg/JointState", name=["a"],
                                   position=[math.inf])),
    ("unknown_type", lambda: new_message("std_msgs/msg/Float64")),
]  # fmt: skip


@pytest.mark.parametrize(("reason", "make"), BAD)
def test_a_bad_message_says_why(reason, make):
    message = make()
    with pytest.raises(BadMessage) as caught:
        reading_messages.to_reading(message.__msgtype__, message)
    assert caught.value.reason == reason


def test_motor_torque_is_told_by_name_and_an_unknown_speed_is_left_out():
    message = reading_messages.motor_message(new_message, MotorReading(NOW, -30.0))
    assert (message.name, list(message.position)) == (["torque"], [-30.0])
    vector = messages.named_vector(
        new_message, NOW, ["temperature", "speed", "torque"], [60.0, 400.0, 120.0]
    )
    assert reading_messages.motor_reading(vector) == MotorReading(NOW, 120.0, 400.0)
    vector = messages.named_vector(new_message, NOW, ["speed"], [400.0])
    with pytest.raises(BadMessage, match="nothing_measured"):
        reading_messages.motor_reading(vector)
    with pytest.raises(ValueError):
        reading_messages.motor_message(new_message, MotorReading(NOW, math.nan, 400.0))


def test_auxiliary_power_is_heating_by_its_name_and_the_sum_of_all_else():
    names = ["Cabin_Heating", "aircon", "lights"]
    vector = messages.named_vector(new_message, NOW, names, [1500.0, 250.0, 100.0])
    assert reading_messages.auxiliary_reading(vector) == AuxiliaryReading(NOW, 1500.0, 350.0)


def charges(*percentages) -> list[float]:
    """States of charge of one publisher of these percentages."""
    scale = reading_messages.ChargeScale()
    return [
        scale.reading(
            reading_messages.battery_reading(
                stamped("sensor_msgs/msg/BatteryState", voltage=400.0, percentage=percentage)
            )
        ).state_of_charge
        for percentage in percentages
    ]


def test_whether_a_percentage_counts_to_one_or_to_hundred_is_decided_once():
    assert charges(87.0, 2.0, 1.0, 0.5) == pytest.approx([0.87, 0.02, 0.01, 0.005])
    assert charges(1.0, 0.9, 0.0) == [1.0, 0.9, 0.0]
    full, *later = charges(1.02, 1.0, 0.9)
    assert math.isnan(full) and later == [1.0, 0.9], "an overfull battery is none at 1 %"
    assert all(map(math.isnan, charges(-1.0, 101.0, math.nan)))


def test_regeneration_is_not_called_charging():
    message = reading_messages.battery_message(new_message, BatteryReading(NOW, 400.0, 50.0))
    assert message.power_supply_status == message.POWER_SUPPLY_STATUS_UNKNOWN
    message = reading_messages.battery_message(new_message, BatteryReading(NOW, 400.0, -50.0))
    assert message.power_supply_status == message.POWER_SUPPLY_STATUS_DISCHARGING


def test_altitude_is_a_valid_fix_without_a_place():
    message = reading_messages.altitude_message(new_message, AltitudeReading(NOW, 570.0))
    assert message.status.status >= message.status.STATUS_FIX
    assert math.isnan(message.latitude) and math.isnan(message.longitude)


@pytest.mark.parametrize("place", [(0.0, 0.0), (91.0, 11.0), (48.0, 181.0), (math.nan, 11.0)])
def test_what_is_no_place_leaves_its_altitude(place):
    message = reading_messages.altitude_message(new_message, AltitudeReading(NOW, 570.0, *place))
    read = reading_messages.altitude_reading(message)
    assert read.altitude == 570.0 and math.isnan(read.latitude) and math.isnan(read.longitude)


def test_a_named_vector_reads_back_by_name():
    message = messages.named_vector(
        new_message, NOW, ["eta", "mass"], np.array([0.9, 1800.0]), [0.1, 50.0], [0.0, 1.0]
    )
    vector = messages.read_named_vector(through_cdr(message))
    assert vector == messages.NamedVector(
        NOW, {"eta": 0.9, "mass": 1800.0}, {"eta": 0.1, "mass": 50.0}, {"eta": 0.0, "mass": 1.0}
    )


def test_unknown_sigmas_are_left_out():
    message = messages.named_vector(new_message, NOW, ["a", "b"], [1.0, 2.0], [0.1, math.nan])
    assert len(message.effort) == 0 and len(message.velocity) == 0


NOT_FINITE = [
    lambda: messages.named_vector(new_message, NOW, ["a"], [math.nan]),
    lambda: messages.named_vector(new_message, NOW, ["a"], [1.0], [math.inf]),
    lambda: messages.named_vector(new_message, NOW, ["a"], [1.0], [-1.0]),
    lambda: messages.named_vector(new_message, NOW, ["a"], [1.0], None, [math.inf]),
    lambda: messages.named_vector(new_message, NOW, ["a", "b"], [1.0]),
    lambda: messages.scalar(new_message, math.inf),
    lambda: reading_messages.speed_message(new_message, SpeedReading(NOW, math.nan)),
    lambda: reading_messages.speed_message(new_message, SpeedReading(NOW, 1.0, math.inf)),
    lambda: reading_messages.battery_message(new_message, BatteryReading(NOW, 1e39, 0.0)),
    lambda: reading_messages.battery_message(new_message, BatteryReading(NOW, 400.0, 0.0, 87.0)),
    lambda: reading_messages.imu_message(new_message, GradeReading(NOW, math.nan)),
    lambda: reading_messages.altitude_message(new_message, AltitudeReading(NOW, math.nan)),
    lambda: reading_messages.temperature_message(new_message, TemperatureReading(NOW, math.inf)),
    lambda: messages.header(new_message, -1),
    lambda: messages.header(new_message, 2**31 * 10**9),
]


@pytest.mark.parametrize("build", NOT_FINITE)
def test_nothing_non_finite_is_built(build):
    with pytest.raises(ValueError):
        build()


def every_message(new: messages.NewMessage) -> list[tuple[str, Any]]:
    readings = [
        SpeedReading(NOW, 12.5, 0.01),
        BatteryReading(NOW, 390.1, -20.25),
        GradeReading(NOW, 0.05),
        AltitudeReading(NOW, 570.0),
        TemperatureReading(NOW, 21.5),
        AuxiliaryReading(NOW, 1500.0, 250.0),
        MotorReading(NOW, 120.5, 400.0),
    ]
    kinds = reading_messages.READING_TOPICS
    level_reasons = {"updates": 3, "sigma": 0.5, "state": "predicting"}
    return [
        *((kinds[type(r)].type_name, reading_messages.reading_message(new, r)) for r in readings),
        ("std_msgs/msg/Float64", messages.scalar(new, np.float64(3.5))),
        ("sensor_msgs/msg/JointState",
         messages.named_vector(new, NOW, ["a", "b"], np.array([1.0, 2.0]), [0.1, 0.2], [3, 4])),
        ("diagnostic_msgs/msg/DiagnosticArray",
         messages.diagnostics(new, NOW, [("estimator", Level.WARN, "no battery", level_reasons),
                                         ("energy", Level.OK, "", {})])),
    ]  # fmt: skip


@pytest.mark.ros
def test_the_same_builders_give_the_same_bytes_with_rclpy():
    serialization = pytest.importorskip("rclpy.serialization")
    for (name, ours), (_, theirs) in zip(
        every_message(new_message), every_message(rclpy_message), strict=True
    ):
        raw = serialization.serialize_message(theirs)
        # Fast CDR leaves chance bytes in the padding and after the end: write it anew.
        assert encode(decode(name, raw)) == encode(ours), name


def test_every_topic_is_listed_once_with_a_type_that_exists():
    names = [topic.name for topic in TOPICS]
    assert len(set(names)) == len(names)
    assert all(topic.type_name in typestore().fielddefs for topic in TOPICS)
    assert not any("joint_states" in name for name in names)


def test_names_and_namespaces():
    assert SPEED.under() == "/ev/vehicle/speed"
    assert SPEED.under("/") == "/vehicle/speed"
    assert DIAGNOSTICS.under("/car") == "/diagnostics"
    assert topic_of("/fleet/car7/vehicle/speed") is SPEED
    assert topic_of("/diagnostics") is DIAGNOSTICS
    assert topic_of("/ev/vehicle/speeds") is None
    assert topic_of("/ev/my_vehicle/speed") is None
    assert topic_of("/ev/typed/energy/state") is None  # another type, beside that of the contract


def test_quality_of_service():
    assert all(not topic.subscriber_qos.reliable for topic in INPUTS)
    assert all(topic.publisher_qos.reliable for topic in TOPICS)
    assert PLAN.subscriber_qos.reliable
    power = POWER_SMOOTHED.subscriber_qos  # a node that rests for four seconds misses none
    assert power.reliable and power.depth >= 40
    assert RELIABLE.publisher_qos.transient_local and RELIABLE.publisher_qos.depth == 1
    assert RELIABLE.subscriber_qos.transient_local
