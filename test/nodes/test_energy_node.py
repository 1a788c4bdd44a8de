"""The energy node answers planners."""

import dataclasses
import math

import pytest

from evpinn_ros import topics
from evpinn_ros.core.energy.forecast import DIRECTION_LENGTH, forecast_plan
from evpinn_ros.core.energy.forecaster import Forecaster
from evpinn_ros.core.energy.plan import plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel, Weather, vehicle_model
from evpinn_ros.core.energy.remaining import usual_cost
from evpinn_ros.core.estimation.hybrid import HybridLearner
from evpinn_ros.core.estimation.unevenness import Unevenness
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    PressureReading,
    SpeedReading,
    TemperatureReading,
    WindReading,
)
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES
from evpinn_ros.nodes.diagnosis import LATELY
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics.messages import Level, named_vector
from evpinn_ros.topics.model import model_message
from test.nodes.plans import ANSWERS, NOW, TRIP, VEHICLE, WEATHER, ask, path, profile


def charge(bench, node, state_of_charge):
    bench.read(node, BatteryReading(NOW, 350.0, -10.0, state_of_charge))


def answer_of(bench, node):
    """The forecast of the trip, of which the state of charge is not asked."""
    (answer,), _ = ask(bench, node, topics.SPEED_PROFILE, profile(*TRIP))
    return answer


def test_a_plan_is_answered_from_the_vehicle_file_first(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS)
    message = profile(*TRIP)
    (answer,), batteries = ask(bench, node, topics.SPEED_PROFILE, message)
    assert batteries == [], "the state of charge is unknown"
    assert answer.header == message.header and list(answer.joint_names) == ["energy"]
    plan = plan_from_speed_profile(*zip(*TRIP, strict=True))
    expected = forecast_plan(plan, vehicle_model(VEHICLE), WEATHER)
    assert [p.positions[0] for p in answer.points] == list(expected.energy)
    assert [p.velocities[0] for p in answer.points] == list(expected.power)
    assert [p.effort[0] for p in answer.points] == list(expected.sigma)
    assert [p.time_from_start.sec for p in answer.points] == [0, 20, 120, 140]
    assert expected.energy[-1] > 0 and expected.sigma[-1] > 0
    assert "vehicle file" in bench.diagnosis(node)["plan"][1]


def test_the_battery_at_the_end_follows_the_state_of_charge(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS)
    charge(bench, node, 0.5)
    charge(bench, node, math.nan)  # says nothing new
    message = profile(*TRIP)
    (answer,), (battery,) = ask(bench, node, topics.SPEED_PROFILE, message)
    used = answer.points[-1].positions[0] / VEHICLE.battery_capacity
    assert battery.percentage == pytest.approx(0.5 - used, abs=1e-7)
    assert battery.header == message.header
    assert math.isnan(battery.voltage)
    charge(bench, node, 0.0)
    _, (battery,) = ask(bench, node, topics.SPEED_PROFILE, message)
    assert battery.percentage == 0.0


def test_forecasts_take_the_air_outside_while_it_is_fresh(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS)

    def cost():
        return answer_of(bench, node).points[-1].positions[0]

    calm = cost()
    assert bench.diagnosis(node)["plan"][2]["head_wind_mps"] == "unknown"
    bench.read(node, TemperatureReading(NOW, -10.0), PressureReading(NOW, 103_000.0))
    bench.read(node, WindReading(NOW, 8.0))
    plan = plan_from_speed_profile(*zip(*TRIP, strict=True))
    cold = Weather(103_000.0 / (287.05 * 263.15), -10.0)
    windy = forecast_plan(plan, vehicle_model(VEHICLE), cold, 8.0, DIRECTION_LENGTH).energy[-1]
    assert cost() == pytest.approx(windy) and windy > 1.1 * calm
    values = bench.diagnosis(node)["plan"][2]
    assert [values[name] for name in ("air_celsius", "air_pascal", "head_wind_mps")] == [
        "-10.0",
        "103000.0",
        "8.0",
    ]
    later = node.now_ns() + 601 * NANOSECONDS
    assert node.forecaster.air(later) == (-10.0, 103_000.0, None)
    assert node.forecaster.air(later + 1200 * NANOSECONDS) == (None, None, None)
    assert node.forecaster.air(NANOSECONDS) == (None, None, None), "the clock went far back"


def test_forecasts_follow_the_estimate(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS)
    before = answer_of(bench, node)
    light = [1.0, 0.8, 0.009, 0.6, 800.0]
    vector = named_vector(new_message, NOW, IDENTIFIABLE_NAMES, light, [0.0] * 5)
    bench.deliver(node, topics.IDENTIFIABLE, vector)
    after = answer_of(bench, node)
    assert after.points[-1].positions[0] < before.points[-1].positions[0]
    # What is left is of the way between its points: the car itself is known.
    assert after.points[-1].effort[0] < 0.5 * before.points[-1].effort[0]
    assert bench.diagnosis(node)["plan"][:2] == (Level.OK, "ready")


def drive_unevenly(estimator):
    """Feed an estimator driving that speeds up and brakes all the time, and the next morning."""
    for second in (*range(300), *range(40_000, 40_005)):
        stamp, speed = NOW + second * NANOSECONDS, 14.0 + 8.0 * math.sin(second / 4)
        force = 2000.0 * math.cos(second / 4)
        watts = 8e3 + speed * (force if force > 0.0 else 0.4 * force)  # braking gives some back
        for reading in (BatteryReading(stamp, 350.0, -watts / 350.0), SpeedReading(stamp, speed)):
            estimator.add_readings([reading])


def test_forecasts_follow_the_model_and_expect_the_uneven_speed_that_the_car_has_shown(bench):
    sender = bench.start(EstimatorNode)
    drive_unevenly(sender.estimator)
    node = bench.start(EnergyNode)  # later, and yet it hears the model
    bench.pump(lambda: node.received[topics.MODEL] == 1)
    sender.publish_model()
    bench.pump(lambda: node.received[topics.MODEL] == 2)
    bench.listen(*ANSWERS)
    answer = answer_of(bench, node)
    learned = sender.estimator.model()
    even = dataclasses.replace(learned, unevenness=Unevenness.none())
    plan = plan_from_speed_profile(*zip(*TRIP, strict=True))
    expected, other = (forecast_plan(plan, PowerModel(c), WEATHER) for c in (learned, even))
    assert [p.positions[0] for p in answer.points] == list(expected.energy)
    assert [p.effort[0] for p in answer.points] == list(expected.sigma)
    assert expected.energy[-1] > 1.1 * other.energy[-1], "it brakes more than others"
    assert node.account.usual == usual_cost(learned) > 0.0
    level, text, values = bench.diagnosis(node)["plan"]
    assert (level, text, values["forecasts_from"]) == (Level.OK, "ready", "estimate/model")


def implausible(model):
    """Finite models and combinations that leave no plan a finite answer, each on its topic."""
    for change in (
        {"mean": model.mean * 1e300},
        {"noise": model.noise * 1e200},
        {"unevenness": dataclasses.replace(model.unevenness, squares=1e300)},
    ):
        wrong = dataclasses.replace(model, **change)
        yield topics.MODEL, model_message(new_message, VEHICLE.key, wrong)
    for values, sigmas in (
        ([0.0] * 5, [0.0] * 5),
        ([1e308] * 5, [1.0] * 5),
        ([1.0] * 5, [1e308] * 5),
    ):
        yield (
            topics.IDENTIFIABLE,
            named_vector(new_message, NOW, IDENTIFIABLE_NAMES, values, sigmas),
        )


def test_no_finite_model_leaves_a_plan_unanswered(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS)
    good = HybridLearner(VEHICLE).model()
    before = answer_of(bench, node)
    for topic, message in implausible(good):
        bench.deliver(node, topic, message)
        assert answer_of(bench, node) == before
    values = bench.diagnosis(node)["meter"][2]
    assert values["bad.estimate/model: out_of_range"] == "3"
    assert values["bad.estimate/identifiable: out_of_range"] == "3"


def test_a_plan_that_we_fail_at_is_refused_with_the_reason_and_the_error_goes_away(
    bench, monkeypatch
):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS)
    now = node.steady_s()
    monkeypatch.setattr(node, "steady_s", lambda: now)  # on a busy machine asking takes longer
    monkeypatch.setattr(Forecaster, "answer", lambda *_: 1 / 0)
    assert ask(bench, node, topics.SPEED_PROFILE, profile(*TRIP)) == ([], [])
    said = bench.diagnosis(node)
    assert said["plan"][2]["last_refusal"] == "internal fault: ZeroDivisionError"
    assert said["meter"][0] is Level.ERROR and "ZeroDivisionError" in said["meter"][1]
    monkeypatch.undo()
    monkeypatch.setattr(node, "steady_s", lambda: now + LATELY)
    said = bench.diagnosis(node)
    assert said["meter"][:2] == (Level.WARN, "waiting for power/smoothed")
    assert [v for k, v in said["meter"][2].items() if k.startswith("fault")] == ["1"]
    bench.faulty.add(node)


def no_distance():
    message = profile(*TRIP)
    message.joint_names = ["wheel"]
    return message


def no_speed():
    message = profile(*TRIP)
    message.points[2].velocities = []
    return message


REFUSED = (
    (topics.SPEED_PROFILE, no_distance(), "no joint 'distance' in this profile"),
    (topics.SPEED_PROFILE, no_speed(), "velocities are missing at point 3"),
    (topics.SPEED_PROFILE, profile(), "needs at least two points"),
    (topics.PLAN, path((0.0, 0.0, 0.0), (math.inf, 0.0, 0.0)), "x is not finite"),
)


def test_a_plan_that_cannot_be_driven_is_refused_with_the_reason(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS, topics.FORECAST_STATUS)
    answers = bench.heard[topics.FORECAST_STATUS]
    for number, (topic, message, reason) in enumerate(REFUSED, 1):
        assert ask(bench, node, topic, message) == ([], [])
        bench.pump(lambda n=number: len(answers) == n)
        (status,) = answers[-1].status
        assert answers[-1].header == message.header and reason in status.message
        assert (status.name, status.hardware_id) == ("/ev/energy: plan", "/ev")
        assert int.from_bytes(status.level, "little") == Level.WARN
        level, text, values = bench.diagnosis(node)["plan"]
        assert level is Level.OK and reason not in text, "the car is well: the asker was told"
        assert reason in values["last_refusal"] and values["refused"] == str(number)
    assert len(ask(bench, node, topics.SPEED_PROFILE, profile(*TRIP))[0]) == 1
    assert "last_refusal" not in bench.diagnosis(node)["plan"][2]


def test_plans_asked_together_are_compared(bench):
    node = bench.start(EnergyNode)
    bench.listen(topics.FORECAST_STATUS)
    slow, fast = TRIP, [(time // 2, distance, 2 * speed) for time, distance, speed in TRIP]
    for index, trip in enumerate((slow, slow, fast)):
        bench.deliver(node, topics.SPEED_PROFILE, profile(*trip, frame=f"planner/{index}"))
    bench.deliver(node, topics.SPEED_PROFILE, profile(*fast, frame="alone"))
    heard = bench.heard[topics.FORECAST_STATUS]
    bench.pump(lambda: len(heard) == 4)
    first, same, third, alone = (
        {p.key: float(p.value) for p in m.status[0].values} for m in heard
    )
    assert not [key for key in (*first, *alone) if key.startswith("difference")]
    assert same["difference/planner/0"] == 0.0
    more = third["energy"] - first["energy"]
    assert third["difference/planner/0"] == pytest.approx(more)
    assert third["difference_sigma/planner/0"] < math.hypot(first["sigma"], third["sigma"])
    assert third["difference_sigma/planner/1"] == third["difference_sigma/planner/0"]


def conditions(**given: float):
    message = named_vector(new_message, NOW, [*given], [0.0] * len(given), [])
    message.position = [*given.values()]  # NaN is for heating that is not known
    return message


def test_plans_after_it_take_the_conditions(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS, topics.FORECAST_STATUS)

    def cost() -> float:
        return answer_of(bench, node).points[-1].positions[0]

    mild = cost()
    bench.deliver(node, topics.CONDITIONS, conditions(temperature=-10.0, heating=math.nan))
    cold = cost()
    bench.deliver(node, topics.CONDITIONS, conditions(temperature=300.0))  # refused, and counted
    assert cost() == cold > 1.1 * mild
    refused = "plan/conditions refused (temperature is 300, not -60 to 60); those before hold"
    assert any(refused in status[1] for status in bench.diagnosis(node).values())
    bench.pump(lambda: len(bench.heard[topics.FORECAST_STATUS]) > 0)
    values = {
        value.key: value.value
        for value in bench.heard[topics.FORECAST_STATUS][-1].status[0].values
    }
    assert values["conditions"] == "1.0"
    bench.deliver(node, topics.CONDITIONS, conditions())
    assert cost() == mild
