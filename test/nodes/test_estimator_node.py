"""The estimator node: its services, its state file, and what it does with bad input."""

import math

import pytest
from std_srvs.srv import SetBool

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.identifiable import prior_identifiable
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.topics.messages import Level, read_named_vector
from test.nodes.plans import NOW, VEHICLE


def speed(seconds, value=10.0):
    return SpeedReading(NOW + round(seconds * NANOSECONDS), value)


def drive(bench, node, begin, end, with_battery=True, rate=10):
    for at in (step / rate for step in range(round(begin * rate), round(end * rate))):
        now = speed(at, 10.0 + 5 * math.sin(at / 3))
        if with_battery:
            bench.read(node, BatteryReading(now.stamp_ns, 350.0, -30.0 + math.sin(at)))
        bench.read(node, now)


def test_measured_and_predicted_power_come_with_their_readings(bench):
    node = bench.start(EstimatorNode)
    for step in range(20):
        bench.read(node, BatteryReading(speed(step / 10).stamp_ns, 350.0, -30.0))
        assert node.published[topics.POWER_MEASURED] == step + 1
        bench.read(node, speed(step / 10))
        assert node.published[topics.POWER_PREDICTED] == step + 1
    assert node.estimator.status().dropped == {}


def unsure(node):
    """1-sigma of m / eta relative to that of the vehicle file."""
    prior = prior_identifiable(VEHICLE)[1].mass_over_eta
    return node.estimator.parameters().identifiable_std.mass_over_eta / prior


def said(bench, node):
    return bench.diagnosis(node)["estimate"]


def test_prediction_goes_on_without_the_battery(bench):
    node = bench.start(EstimatorNode)
    bench.listen(topics.POWER_PREDICTED, topics.POWER_SMOOTHED, topics.POWER_MEASURED)
    assert said(bench, node)[:2] == (Level.WARN, "waiting for vehicle/speed: nobody publishes it")
    drive(bench, node, 0, 4)
    assert said(bench, node)[0] is Level.OK and "learning" in said(bench, node)[1]
    measured = node.published[topics.POWER_MEASURED]
    drive(bench, node, 4, 9, with_battery=False)
    bench.settle()
    level, text, values = said(bench, node)
    assert level is Level.WARN and "predicting from speed alone" in text
    assert values["activity"] == "predicting"
    assert len(bench.heard[topics.POWER_MEASURED]) == measured == 40
    for topic in (topics.POWER_PREDICTED, topics.POWER_SMOOTHED):
        vectors = bench.heard[topic]
        assert len(vectors) > 80 and all(math.isfinite(v.position[0]) for v in vectors)
        assert all(v.effort[0] > 0 for v in vectors)
    newest = bench.heard[topics.POWER_PREDICTED][-1].header.stamp
    assert (newest.sec, newest.nanosec) == (1_700_000_008, 900_000_000)


def test_the_breakdown_is_told_live_and_adds_up(bench):
    node = bench.start(EstimatorNode)
    bench.listen(topics.ENERGY_BREAKDOWN)
    drive(bench, node, 0, 35, rate=4)  # three intervals
    bench.settle()
    vector = read_named_vector(bench.heard[topics.ENERGY_BREAKDOWN][-1])
    parts = dict(vector.values)
    measured, _ = parts.pop("measured"), parts.pop("regained")
    assert sum(parts.values()) == pytest.approx(measured)
    assert measured == pytest.approx(350.0 * 30.0 * 30.0, rel=0.3)
    assert all(sigma >= 0.0 for sigma in vector.sigmas.values())


def test_enable_pauses_learning_alone(bench):
    node = bench.start(EstimatorNode)
    new = unsure(node)
    assert bench.call(SetBool, "/ev/estimator/enable", data=False).success
    drive(bench, node, 0, 16, rate=4)
    assert said(bench, node)[:2] == (Level.OK, "predicting; learning is paused by ~/enable")
    assert node.published[topics.POWER_SMOOTHED] > 30
    assert unsure(node) == pytest.approx(new, rel=1e-9)
    bench.call(SetBool, "/ev/estimator/enable", data=True)
    drive(bench, node, 16, 48, rate=4)
    assert unsure(node) < 0.9 * new


def test_nothing_that_is_not_finite_is_published(bench, monkeypatch):
    node = bench.start(EstimatorNode)
    bench.read(node, speed(0.0))
    published = node.published[topics.POWER_PREDICTED]
    predict = node.estimator._learner.predict

    def not_finite(samples):
        return tuple(math.nan * column for column in predict(samples))

    monkeypatch.setattr(node.estimator._learner, "predict", not_finite)
    bench.read(node, speed(0.1))
    assert node.published[topics.POWER_PREDICTED] == published
    assert said(bench, node)[2]["bad.output_not_finite"] == "1"


def test_a_fault_of_ours_is_told_and_the_node_lives(bench, monkeypatch):
    node = bench.start(EstimatorNode)
    monkeypatch.setattr(node.estimator, "add_reading", lambda reading, breakdowns: 1 / 0)
    bench.read(node, speed(0.0), speed(0.1))
    level, text, values = said(bench, node)
    assert level is Level.ERROR and "ZeroDivisionError" in text
    assert [v for k, v in values.items() if k.startswith("fault")] == ["2"]
    monkeypatch.undo()
    bench.read(node, speed(0.2))
    assert node.estimator.status().newest_ns is not None
    bench.faulty.add(node)
