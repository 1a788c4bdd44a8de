"""One car, one plan, one condition: whoever is asked forecasts the same energy."""

import json
import math

import numpy as np
import pandas as pd
import pytest

import evpinn_ros as ev
from evpinn_ros import topics
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.remaining import Cost, remaining
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics.messages import named_vector
from test.cli.conftest import run_here
from test.nodes.conftest import VEHICLE
from test.nodes.plans import ANSWERS, NOW, profile

TRIP = ((0, 0, 0), (20, 150, 15), (330, 4800, 15), (350, 5000, 0))
CUT = (*TRIP[:1], (8, 24, 6), TRIP[1], (73, 945, 15), (301, 4365, 15), *TRIP[2:])
COLD, STOOD = -5.0, 600  # degrees C, s


def drive(estimator):
    """Some minutes of a car that heats, so that its cabin is warmer at the end."""
    for second in range(400):
        speed = 14.0 + 8.0 * math.sin(second / 4)
        watts = 12e3 + 3000.0 * speed * math.cos(second / 4)
        estimator.add(second, speed, 350.0, watts / 350.0, soc_pct=60.0, ambient_c=COLD)


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """State files of a car in the middle of a drive, and after it."""
    folder, estimator = tmp_path_factory.mktemp("states"), ev.Estimator(VEHICLE)
    drive(estimator)
    estimator.save(folder / "in a drive")
    estimator.begin_next_drive()
    estimator.save(folder / "between drives")
    return folder


@pytest.mark.parametrize("saved", ["in a drive", "between drives"])
def test_command_python_topic_and_range_agree(bench, states, tmp_path, saved):
    state, plan, answer = (tmp_path / name for name in ("car.json", "plan.csv", "answer.json"))
    state.write_bytes((states / saved).read_bytes())
    table = pd.DataFrame(TRIP, columns=["t_s", "distance_m", "speed_mps"])
    table.to_csv(plan, index=False)

    given = f"--vehicle {VEHICLE} --state {state} --temperature {COLD} --stood {STOOD / 3600!r}"
    ended = run_here("forecast", plan, *given.split(), "--json", answer, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    (by_command,) = json.loads(answer.read_text())

    known = ev.Estimator(VEHICLE, state=state)
    by_python = ev.forecast(table, known, temperature_c=COLD, stood_h=STOOD / 3600)
    cold_start = ev.forecast(table, known, temperature_c=COLD)
    assert by_python.energy_j.iloc[-1] < 0.99 * cold_start.energy_j.iloc[-1], "still warm"

    node = bench.start(EnergyNode, energy_file=str(state))
    bench.start(EstimatorNode, state_file=str(state))
    bench.listen(*ANSWERS)
    bench.pump(lambda: node.received[topics.MODEL])
    stood = named_vector(new_message, NOW, ["temperature", "stood"], [COLD, float(STOOD)])
    bench.post(node, topics.CONDITIONS, stood)
    bench.post(node, topics.SPEED_PROFILE, profile(*TRIP))
    bench.pump(lambda: bench.heard[topics.FORECAST])
    points = bench.heard[topics.FORECAST][0].points

    same = pytest.approx(by_python.energy_j.iloc[-1], rel=1e-9)
    assert by_command["energy_j"] == same
    assert points[-1].positions[0] == same
    assert node.account.route.energy[-1] == same
    same = pytest.approx(by_python.sigma_j.iloc[-1], rel=1e-9)
    assert by_command["sigma_j"] == same and points[-1].effort[0] == same
    # A battery that holds what the plan takes up to its middle is empty there, to the metre.
    rows = ev.forecast(table, known, temperature_c=COLD, stood_h=STOOD / 3600, every_m=100.0)
    used = float(np.interp(2400.0, rows.distance_m, rows.energy_j))
    ahead = node.account.route.ahead(node.account.odometer, Cost(1.0, 1.0, 0.1))
    empty = remaining(Uncertain(used, 0.0), ahead)
    assert empty.distance == pytest.approx(2400.0, abs=1.0)

    bench.post(node, topics.SPEED_PROFILE, profile(*CUT))
    bench.pump(lambda: len(bench.heard[topics.FORECAST]) > 1)
    (*_, last) = bench.heard[topics.FORECAST][1].points
    assert [*last.positions, *last.effort] == pytest.approx(
        [*points[-1].positions, *points[-1].effort], rel=1e-9
    )
    ahead = node.account.route.ahead(node.account.odometer, Cost(1.0, 1.0, 0.1))
    assert remaining(Uncertain(used, 0.0), ahead) == pytest.approx(empty, rel=1e-9)
