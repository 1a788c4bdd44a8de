"""The energy node is killed or stopped at any moment, and is away for up to a minute.

What it has shown it never takes back, and what it missed is in sigma.
"""

from itertools import pairwise
import random

import numpy as np
import pytest

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS, SpeedReading
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics.messages import read_named_vector
from evpinn_ros.topics.readings import reading_message
from test.nodes.plans import power
from test.nodes.processes import await_line, node, started, stopped

START_NS = 1_700_000_000 * NANOSECONDS
RATE = 10  # readings a second
ROUNDING = 1e-9  # of sums
NEVER_FALL = ("lifetime_drawn", "lifetime_regenerated")


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("least", [-2e4, 0.0])
@pytest.mark.parametrize(
    "lives", [pytest.param(3, marks=pytest.mark.slow), pytest.param(40, marks=pytest.mark.nightly)]
)
def test_nothing_shown_is_taken_back_and_what_was_missed_is_in_sigma(
    bench, tmp_path, lives, least
):
    """Kills and stops take back no `consumed` where no power is negative, and no sigma of it."""
    moments = random.Random(lives)
    inputs = (topics.SPEED, topics.POWER_MEASURED, topics.POWER_SMOOTHED)
    command = node("energy", *inputs, energy_file=str(tmp_path / "energy.json"))
    totals, states = bench.hear(topics.ENERGY_TOTALS), bench.hear(topics.ENERGY_STATE)
    drawn = []  # at each moment, W

    def send():
        stamp = START_NS + len(drawn) * NANOSECONDS // RATE
        drawn.append(moments.uniform(least, 4e4))
        bench.send(topics.SPEED, reading_message(new_message, SpeedReading(stamp, 20.0)))
        bench.send(topics.POWER_MEASURED, power(stamp, drawn[-1]))
        bench.send(topics.POWER_SMOOTHED, power(stamp, drawn[-1]))

    for life in range(lives):
        with started(*command) as process:
            await_line(process, "waiting for power/smoothed")
            several = len(totals) + moments.randrange(2, 10)
            bench.pump(lambda several=several: len(totals) > several or send())
            for _ in range(moments.randrange(5 * RATE)):
                send()
            if life % 2:
                stopped(process)
        away = range(RATE * moments.randrange(1, 61))
        drawn.extend(moments.uniform(least, 4e4) for _ in away)
    shown = [read_named_vector(message).values for message in totals]
    assert len(shown) > 2 * lives and shown[-1]["lifetime_drawn"] > 2e4 * lives
    for name in NEVER_FALL:
        assert all(a[name] <= b[name] for a, b in pairwise(shown)), name
    vectors = [read_named_vector(message) for message in states]
    assert len(vectors) > 9 * lives
    for old, new in pairwise(vectors):
        assert new.sigmas["consumed"] >= old.sigmas["consumed"] * (1 - ROUNDING)
        assert least < 0.0 or new.values["consumed"] >= old.values["consumed"] * (1 - ROUNDING)
    taken = np.append(0.0, np.cumsum(np.add(drawn[1:], drawn[:-1]) / 2 / RATE))
    for vector in vectors:
        moment = (vector.stamp_ns - START_NS) * RATE // NANOSECONDS
        assert abs(vector.values["consumed"] - taken[moment]) <= 2.0 * vector.sigmas["consumed"]
