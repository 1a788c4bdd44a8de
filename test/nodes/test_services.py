"""Services of the nodes: what each answers is true, after whichever other it is called."""

from itertools import permutations
import shutil

import pytest
from std_srvs.srv import SetBool, Trigger

from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode

RESET, SAVE = (Trigger, "reset", {}), (Trigger, "save", {})
ENABLE, PAUSE = (SetBool, "enable", {"data": True}), (SetBool, "enable", {"data": False})


@pytest.mark.parametrize(
    ("make", "file", "calls"),
    [
        (EstimatorNode, "state_file", (RESET, SAVE, ENABLE, PAUSE)),
        (EnergyNode, "energy_file", (RESET, SAVE)),
    ],
)
@pytest.mark.parametrize("writable", [True, False])
def test_every_service_after_every_other_answers_what_was_done(
    bench, tmp_path, make, file, calls, writable
):
    """A save that fails logs a warning, a reset that succeeds none, on the same road."""
    path = tmp_path / "car.json" if writable else tmp_path / "missing" / "car.json"
    node = bench.start(make, **{file: str(path)})
    if not writable:
        shutil.rmtree(path.parent)
        path.parent.write_text("a file where a folder should be")
    for order in permutations(calls, 2):
        for kind, name, request in order:
            answer = bench.call(kind, f"/ev/{node.get_name()}/{name}", **request)
            works = writable or name != "save"
            assert answer.success == works, (order, name, answer.message)
            assert answer.message
            assert "internal fault" not in answer.message
    counted = bench.diagnosis(node)
    values = next(iter(counted.values()))[2]
    for _, name, _ in calls:
        assert int(values[f"calls.~/{name}"]) >= 2
