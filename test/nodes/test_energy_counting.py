"""The energy node counts."""

import pytest
from std_srvs.srv import Trigger

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.energy import EnergyNode
from test.nodes import plans
from test.nodes.plans import NOW


def power(second, watts):
    return plans.power(NOW + second * NANOSECONDS, watts)


def test_energy_is_counted_and_reset(bench):
    node = bench.start(EnergyNode)
    bench.listen(topics.ENERGY_STATE, topics.ENERGY_CONSUMED)
    for second in range(11):
        bench.deliver(node, topics.POWER_MEASURED, power(second, 2000.0))
        bench.deliver(node, topics.POWER_SMOOTHED, power(second, 2100.0))
    bench.settle()
    assert bench.heard[topics.ENERGY_CONSUMED][-1].data == 20_000.0
    state = bench.heard[topics.ENERGY_STATE][-1]
    energies = dict(zip(state.name, state.position, strict=True))
    assert energies["measured"] == 20_000.0 and energies["predicted"] == 21_000.0
    assert energies["rknn"] == pytest.approx(21_000.0, rel=1e-3)
    assert state.header.stamp.sec == 1_700_000_010
    assert bench.call(Trigger, "/ev/energy/reset").success
    bench.deliver(node, topics.POWER_SMOOTHED, power(11, 2100.0))
    bench.settle()
    assert bench.heard[topics.ENERGY_CONSUMED][-1].data == 0.0


@pytest.mark.parametrize(("integrator", "flow"), [("trapezoid", "predicted"), ("rknn", "rknn")])
def test_both_integrals_are_published_and_the_chosen_one_bridges_a_silence(
    bench, integrator, flow
):
    node = bench.start(EnergyNode, integrator=integrator)
    bench.listen(topics.ENERGY_STATE)
    for tick in range(5):
        bench.deliver(node, topics.POWER_SMOOTHED, power(tick, 9e3 * (-1) ** tick + 2e3))
    bench.pump(lambda: len(bench.heard[topics.ENERGY_STATE]) == 5)
    last = bench.heard[topics.ENERGY_STATE][-1]
    values = dict(zip(last.name, last.position, strict=True))
    assert values["predicted"] != values["rknn"]
    assert values["consumed"] == values[flow]
