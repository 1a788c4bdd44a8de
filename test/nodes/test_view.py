"""`evpinn view` plays a bag to real subscribers, and to no node that would learn from it."""

import subprocess

import pytest

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.view import view
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.topics.messages import named_vector
from test.conftest import ROOT
from test.nodes.processes import EVPINN, await_line, started, stopped
from test.waiting import HANG_S

SECOND = 10**9


def test_a_bag_in_a_loop_comes_as_it_was_recorded_without_its_pauses(bench, tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for second in (9, 10, 100_009):  # a night in between takes ten seconds
            stamp_ns = second * SECOND
            message = named_vector(new_message, stamp_ns, ["power"], [float(second)])
            bag.write(topics.POWER_MEASURED.under("/ev"), message, stamp_ns)
    heard = bench.hear(topics.POWER_MEASURED)
    with started(*EVPINN, "view", tmp_path / "bag", "--rate", 100, "--loop") as running:
        await_line(running, "waiting for a viewer")
        bench.pump(lambda: len(heard) >= 8)
        stopped(running)
    powers = [message.position[0] for message in heard]
    begin = powers.index(9.0)  # who comes late misses the beginning
    assert powers[begin : begin + 6] == 2 * [9.0, 10.0, 100_009.0]


def test_no_bag_is_played_to_nodes_that_would_learn_from_it(bench):
    bench.start(EstimatorNode)
    played = subprocess.run(
        [*EVPINN, "view", "bags/urban"], cwd=ROOT, capture_output=True, text=True, timeout=HANG_S
    )
    assert played.returncode == 1 and "'estimator' runs here" in played.stderr


def test_a_bag_without_messages_is_refused(tmp_path):
    with BagWriter(tmp_path / "bag"):
        pass
    with pytest.raises(InputError, match="holds no messages"):
        view(tmp_path / "bag")
