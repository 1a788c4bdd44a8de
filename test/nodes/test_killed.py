"""The energy node is killed at any moment: what it has shown it never takes back."""

from itertools import pairwise
import random

import pytest

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics.messages import read_named_vector
from evpinn_ros.topics.readings import reading_message
from test.nodes.plans import power
from test.nodes.processes import await_line, node, started

START = 1_700_000_000
RATE = 10  # readings a second
ROUNDING = 1e-9  # of sums
NEVER_FALL = ("lifetime_drawn", "lifetime_regenerated")


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("least", [-2e4, 0.0])
@pytest.mark.parametrize(
    "kills", [pytest.param(3, marks=pytest.mark.slow), pytest.param(20, marks=pytest.mark.nightly)]
)
def test_nothing_shown_is_taken_back_however_often_the_node_is_killed(
    bench, tmp_path, kills, least
):
    """A kill takes back no `consumed` where no power is negative, and none of its sigma."""
    moments = random.Random(kills)
    inputs = (topics.SPEED, topics.POWER_MEASURED, topics.POWER_SMOOTHED)
    command = node("energy", *inputs, energy_file=str(tmp_path / "energy.json"))
    totals, states = bench.hear(topics.ENERGY_TOTALS), bench.hear(topics.ENERGY_STATE)
    step = 0

    def send():
        nonlocal step
        stamp = START * NANOSECONDS + step * NANOSECONDS // RATE
        watts = moments.uniform(least, 4e4)
        bench.send(topics.SPEED, reading_message(new_message, SpeedReading(stamp, 20.0)))
        bench.send(topics.POWER_MEASURED, power(stamp, watts))
        bench.send(topics.POWER_SMOOTHED, power(stamp, watts))
        step += 1

    for _ in range(kills):
        with started(*command) as process:
            await_line(process, "waiting for power/smoothed")
            several = len(totals) + moments.randrange(2, 10)
            bench.pump(lambda several=several: len(totals) > several or send())
            for _ in range(moments.randrange(5 * RATE)):
                send()
    shown = [read_named_vector(message).values for message in totals]
    assert len(shown) > 2 * kills and shown[-1]["lifetime_drawn"] > 2e4 * kills
    for name in NEVER_FALL:
        assert all(a[name] <= b[name] for a, b in pairwise(shown)), name
    vectors = [read_named_vector(message) for message in states]
    assert len(vectors) > 9 * kills
    for old, new in pairwise(vectors):
        assert new.sigmas["consumed"] >= old.sigmas["consumed"] * (1 - ROUNDING)
        assert least < 0.0 or new.values["consumed"] >= old.values["consumed"] * (1 - ROUNDING)
