"""Conditions of plans over topics: `plan/conditions` counts for all plans after it."""

import math

from evpinn_ros import topics
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics.messages import named_vector
from test.nodes.test_energy_node import ANSWERS, NOW, TRIP, ask, profile


def conditions(**given: float):
    found = named_vector(new_message, NOW, [*given], [0.0] * len(given), [])
    found.position = [*given.values()]  # NaN is for heating that is not known
    return found


def test_plans_after_it_take_the_conditions(bench):
    node = bench.start(EnergyNode)
    bench.listen(*ANSWERS, topics.FORECAST_STATUS)

    def cost() -> float:
        (found,), _ = ask(bench, node, topics.SPEED_PROFILE, profile(*TRIP))
        return found.points[-1].positions[0]

    mild = cost()
    bench.deliver(node, topics.CONDITIONS, conditions(temperature=-10.0, heating=math.nan))
    cold = cost()
    bench.deliver(node, topics.CONDITIONS, conditions(temperature=300.0))  # refused, and counted
    assert cost() == cold > 1.1 * mild
    bench.pump(lambda: len(bench.heard[topics.FORECAST_STATUS]) > 0)
    values = {
        each.key: each.value for each in bench.heard[topics.FORECAST_STATUS][-1].status[0].values
    }
    assert values["conditions"] == "1.0"
    bench.deliver(node, topics.CONDITIONS, conditions())
    assert cost() == mild
