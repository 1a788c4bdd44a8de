"""What a node on a car's computer does not load, and does not need."""

import os

import pytest

from evpinn_ros import topics
from evpinn_ros.common.optional import EXTRA_OF
from test.nodes.processes import EVPINN, started, stopped

HEAVY = sorted({*EXTRA_OF, "scipy", "torch"} - {"rclpy"})


RECORDINGS = ("apsw", "mcap", "rosbags", "ruamel")  # what reads and writes bags
BUILDS = ("em", "lark")  # what rclpy loads to make Python of message definitions


OTHERS = {
    "estimator": ("can", "cantools", "evpinn_ros.core.energy.meter"),
    "energy": ("can", "cantools", "evpinn_ros.core.estimation.estimator"),
    "can_bridge": ("isotp", "udsoncan", "evpinn_ros.core.estimation"),
}


@pytest.mark.parametrize("node", OTHERS)
def test_no_default_node_loads_what_it_does_not_need(loads_without, node):
    loads_without(f"from evpinn_ros.nodes import {node}", *HEAVY, *RECORDINGS, *OTHERS[node])


def test_the_equation_of_the_default_seed_loads_no_generator_of_numbers(loads_without):
    code = "from evpinn_ros.core.estimation.terms import Equation"
    load = "from evpinn_ros.core.vehicle.files import load_vehicle"
    loads_without(f"{code}; {load}; Equation(load_vehicle('generic'))", "numpy.random")


@pytest.mark.parametrize("node", ["estimator", "energy", "can_bridge"])
def test_an_executable_loads_no_openssl(loads_without, node):
    load = "from evpinn_ros import executables; from evpinn_ros.nodes import running"
    code = f"{load}; running.run = lambda node: 0; executables.{node}(); import numpy.random"
    loads_without(f"{code}; assert not sys.modules['_hashlib'] and not sys.modules['_ssl']", "ssl")


def test_a_node_that_is_up_has_loaded_nothing_that_builds_messages(loads_without):
    code = "from evpinn_ros.nodes import running; import rclpy; running.load_no_generator()"
    loads_without(f"{code}; rclpy.init(); rclpy.create_node('up')", *BUILDS)


def test_a_car_drives_and_is_recorded_without_any_of_it(bench, can_log, tmp_path):
    """All of Python in that process, and of what it starts, finds none of these packages."""
    absent = f"import sys; sys.modules.update(dict.fromkeys({HEAVY}))"
    (tmp_path / "sitecustomize.py").write_text(absent)
    places = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", "")))
    log = f"{{log_file: {can_log('urban', 20.0)}, log_rate: 2.5}}"
    params = tmp_path / "car.param.yaml"
    params.write_text(f"/**/can_bridge:\n  ros__parameters: {log}\n")
    options = ("--vehicle", "tesla_model_3_lr", "--params", params, "--record", tmp_path / "bag")
    with started(*EVPINN, "run", *options, env=os.environ | {"PYTHONPATH": places}) as process:
        bench.listen(topics.POWER_SMOOTHED, topics.ENERGY_STATE)
        bench.pump(lambda: bench.heard[topics.POWER_SMOOTHED] and bench.heard[topics.ENERGY_STATE])
        _, said = stopped(process)
    assert "saved the drive" in said, said
