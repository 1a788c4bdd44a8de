"""What the nodes say of themselves, decided without ROS."""

import dataclasses
import math

import numpy as np
import pytest

from evpinn_ros.can.bridge import BridgeStatus, SignalStatus
from evpinn_ros.can.bus import BusCondition, BusStatus
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.forecast import Air, Forecast
from evpinn_ros.core.energy.forecaster import Basis, PlanAnswer, PlanLog
from evpinn_ros.core.estimation.estimator import Activity, EstimatorStatus
from evpinn_ros.core.estimation.lag import Lag
from evpinn_ros.core.estimation.learner import LearnerReport
from evpinn_ros.core.signals.detector import BATTERY_STUCK, SPEED_STUCK
from evpinn_ros.nodes.can_bridge import bus_status, log_status
from evpinn_ros.nodes.diagnosis import WELL, Condition
from evpinn_ros.nodes.energy_diagnosis import answered_status, plan_status
from evpinn_ros.nodes.estimator_diagnosis import estimator_status
from evpinn_ros.topics.messages import Level

STATUS = EstimatorStatus(
    activity=Activity.LEARNING,
    dropped={"speed_late": 2},
    gated={"standing": 5},
    updates=40,
    accepted=35,
    rejected={"not_better": 5},
    durations=(0.004, 0.006, 0.005),
    newest_ns=1,
)
AIR = Air(celsius=-3.0)


BRIDGE = BridgeStatus(True, "receiving", 9, 2, 1, {}, {"speed": SignalStatus(9, 50.0, 0.0, False)})


def estimator(status=STATUS, health=WELL, age=0.1, problem=None):
    return estimator_status(status, Condition(health, age, 0, problem, "1 publisher"))


@pytest.mark.parametrize(
    ("change", "age", "level", "text"),
    [
        ({"activity": Activity.WAITING}, math.nan, Level.WARN, "waiting for vehicle/speed"),
        ({}, 12.0, Level.WARN, "no vehicle/speed for 12 s: 1 publisher"),
        ({"activity": Activity.PREDICTING}, 0.1, Level.WARN, "battery/state is silent"),
        ({"activity": Activity.PAUSED}, 0.1, Level.OK, "paused"),
        ({"rejected": {"overrun": 9}}, 0.1, Level.WARN, "too slow or busy"),
        ({"stuck": SPEED_STUCK}, 0.1, Level.WARN, "vehicle/speed is stuck at one value"),
        ({"stuck": BATTERY_STUCK}, 0.1, Level.WARN, "battery/state is stuck at one value"),
        ({"report": LearnerReport(suspicion="grade_sign")}, 0.1, Level.WARN, "sign of grade"),
        ({"lag": Lag(0.9, 0.05)}, 0.1, Level.WARN, "vehicle/speed is stamped 0.9 s later than"),
        ({"lag": Lag(-0.9, 0.05)}, 0.1, Level.WARN, "battery/state is stamped 0.9 s later than"),
        ({"lag": Lag(0.9, 0.5)}, 0.1, Level.OK, "learning"),  # not known well
    ],
)
def test_states_of_the_estimator(change, age, level, text):
    status = estimator(dataclasses.replace(STATUS, **change), age=age)
    assert status.level is level and text in status.text


def test_states_of_planning():
    plans = PlanLog()
    plans.answer(Uncertain(0.42, 0.03))
    assert plan_status(plans, Basis.MODEL, AIR).text == "ready"
    for basis in Basis:
        status = plan_status(plans, basis, AIR)
        assert status.values["forecasts_from"] == basis.value
        assert status.level is Level.OK
        assert ("no estimate/model" in status.text) == (basis is Basis.VEHICLE_FILE)
    plans.refuse("time goes back at point 3")
    refused = plan_status(plans, Basis.MODEL, AIR)
    assert (refused.level, refused.text) == (Level.OK, "ready"), "its asker was told"
    assert refused.values["last_refusal"] == "time goes back at point 3"
    assert (refused.values["answered"], refused.values["refused"]) == (1, 1)
    assert refused.values["charge_after"] == 0.42


def test_every_number_of_an_answer_is_read_by_any_language():
    whole = np.array([0.0, 3.6e6])
    answer = PlanAnswer(
        Forecast(np.array([0.0, 60.0]), whole, whole, whole),
        Uncertain(np.float64(0.5), 0.01), math.nan, {"a/0": Uncertain(1.0, np.float64(2.0))},
    )  # fmt: skip
    values = answered_status(answer).values
    assert {key: float(text) for key, text in values.items()} == {
        "energy": 3.6e6, "sigma": 3.6e6, "conditions": 0.0, "battery": 0.5, "battery_sigma": 0.01,
        "difference/a/0": 1.0, "difference_sigma/a/0": 2.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("state", "ok", "level", "text"),
    [
        (BusCondition.OPEN, True, Level.OK, "receiving"),
        (BusCondition.OPEN, False, Level.WARN, "receiving"),
        (BusCondition.SILENT, True, Level.WARN, "silent"),
        (BusCondition.ERRORS, True, Level.WARN, "wrong bit rate"),
        (BusCondition.OFF, True, Level.ERROR, "check bit rate and wiring"),
        (BusCondition.LOST, True, Level.ERROR, "is the adapter plugged in"),
    ],
)
def test_states_of_the_bus(state, ok, level, text):
    problem = "CAN bus: is the adapter plugged in" if state is BusCondition.LOST else None
    status = bus_status(
        BusStatus(state, problem, {"lost": 1}), dataclasses.replace(BRIDGE, ok=ok), WELL
    )
    assert status.level is level and text in status.text
    assert status.values["bus.lost"] == 1 and status.values["speed.rate_hz"] == 50.0


def test_a_refused_profile_is_an_error_and_a_wrong_sign_a_warning():
    bus = BusStatus(BusCondition.OPEN, None, {})
    refused = dataclasses.replace(BRIDGE, ok=False, text="no", refusal="no")
    suspected = dataclasses.replace(BRIDGE, ok=False, text="current_sign: x", fault="x")
    for status in (bus_status(bus, refused, WELL), log_status("playing", None, refused, WELL)):
        assert (status.level, status.text) == (Level.ERROR, "no")
    for status in (bus_status(bus, suspected, WELL), log_status("playing", None, suspected, WELL)):
        assert (status.level, status.text) == (Level.WARN, "current_sign: x")
    assert bus_status(bus, suspected, WELL).values["suspicion"] == "x"
