"""What nodes log: one line at the start, one a transition, nothing that comes again and again."""

from itertools import islice
import json

import pytest
from std_srvs.srv import SetBool, Trigger

from evpinn_ros import topics
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode


@pytest.fixture
def logged(bench, capfd):
    """All that nodes have logged so far."""
    found = []
    return lambda: found.append(capfd.readouterr().err) or "".join(found)


def test_the_estimator_logs_what_changes(bench, logged, urban, tmp_path):
    path = tmp_path / "car.json"
    node = bench.start(EstimatorNode, state_file=str(path))
    assert "tesla_model_3_lr (hybrid) begins with the vehicle file; waiting for" in logged()
    drive = ((topic, message) for topic, _, message in urban(360.0))
    bench.pump(lambda: "learning" in logged() or bench.deliver(node, *next(drive)))
    bench.call(Trigger, "/ev/estimator/save")
    bench.call(SetBool, "/ev/estimator/enable", data=False)
    bench.call(Trigger, "/ev/estimator/reset")
    bench.pump(lambda: "started again from the vehicle file" in logged())
    lines = [line.partition("]: ")[2] for line in logged().splitlines() if "estimator]" in line]
    assert f"written to {path}" in lines and "paused: predicting only" in lines
    assert len(lines) == len(set(lines)), lines
    assert json.loads(path.read_text())["learned"]["vehicle"] == "tesla_model_3_lr"
    bench.start(EstimatorNode, state_file=str(path))
    assert f"continues from {path}" in logged()


def test_silence_of_the_battery_is_logged_once_and_without_counters(bench, logged, urban):
    node, drive = bench.start(EstimatorNode), urban(360.0)
    for topic, _, message in islice(drive, 100):
        bench.deliver(node, topic, message)
    speeds = (message for topic, _, message in drive if topic is topics.SPEED)
    bench.pump(
        lambda: (
            "predicting from speed alone: battery/state is silent" in logged()
            or bench.deliver(node, topics.SPEED, next(speeds))
        )
    )
    assert logged().count("battery/state is silent") == 1


def test_the_meter_logs_what_changes(bench, logged):
    node = bench.start(EnergyNode)
    assert "counts from zero; waiting for power/smoothed" in logged()
    bench.call(Trigger, "/ev/energy/reset")
    assert "energy counts from zero; the lifetime's goes on" in logged()
    bench.await_reports(node, 3)
    assert logged().count("[INFO]") == 2
