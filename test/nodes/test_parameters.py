"""One table of parameters: the file, the declaration and every check say the same."""

from itertools import chain
import math

import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter as RosParameter
import yaml

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.energy.meter import Integrator
from evpinn_ros.core.energy.plan import MAX_SPEED
from evpinn_ros.core.energy.quadrature import MAX_GAP
from evpinn_ros.core.energy.rknn import STEP_LIMIT
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode, PaperOptimizer
from evpinn_ros.core.signals.road import GradeSource
from evpinn_ros.core.signals.time_jump import JumpPolicy
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.nodes import parameters
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.topics.node_parameters import TABLES, refuse_wrong
from evpinn_ros.topics.parameter_file import check_parameter_file, read_parameter_file

FILE = share_directory() / "config" / "evpinn.param.yaml"


def table(node):
    return {parameter.name: parameter for parameter in TABLES[node]}


def test_the_file_holds_every_default():
    check_parameter_file(FILE)
    whole = yaml.safe_load(FILE.read_text())
    sections = {name.rpartition("/")[2]: s["ros__parameters"] for name, s in whole.items()}
    defaults = {node: {p.name: p.default for p in table} for node, table in TABLES.items()}
    assert sections == defaults
    assert all(read_parameter_file(FILE, node) == defaults[node] for node in TABLES)


def test_a_mistyped_parameter_is_reported_with_the_nearest_name(bench):
    lines = bench.log_lines()
    given = {"nominal_sped": 1.0, "smoothing_lag": 0.3, "qos_overrides./x.publisher.depth": 1}
    bench.start(EnergyNode, **given)
    bench.pump(lambda: any("unknown parameter" in line for line in lines))
    said = [line for line in lines if "unknown parameter" in line]
    assert len(said) == 1 and "'nominal_sped'" in said[0] and "mean nominal_speed" in said[0]


def test_every_default_passes_its_own_check():
    for parameter in chain.from_iterable(TABLES.values()):
        assert parameter.problem(parameter.default) is None, parameter.name
        assert parameter.description.endswith("."), parameter.name


def test_choices_and_defaults_are_those_of_the_cores():
    estimator, settings = table("estimator"), EstimatorSettings(mode=Mode.PAPER)
    for name, kind in (
        ("mode", Mode),
        ("regen_form", RegenForm),
        ("paper_optimizer", PaperOptimizer),
        ("grade_source", GradeSource),
        ("time_jump_policy", JumpPolicy),
    ):
        assert set(estimator[name].choices) == {member.value for member in kind}
    assert estimator["mode"].default == EstimatorSettings().mode.value
    assert estimator["regen_form"].default == settings.regen_form.value
    assert estimator["paper_optimizer"].default == settings.optimizer.value
    assert estimator["grade_source"].default == settings.stream.grade_source.value
    for name in ("smoothing_lag", "allowed_lateness", "max_gap"):
        assert estimator[name].default == getattr(settings.stream, name)
    energy = table("energy")
    assert (energy["max_gap"].default, energy["max_gap"].upper) == (MAX_GAP, STEP_LIMIT)
    assert set(energy["integrator"].choices) == {member.value for member in Integrator}
    assert energy["integrator"].default == Integrator.RKNN.value
    speed = energy["nominal_speed"]
    assert (speed.default, speed.upper) == (0.0, MAX_SPEED)


@pytest.mark.parametrize(
    ("node", "name", "value", "reason"),
    [
        ("estimator", "max_gap", math.inf, "outside"),
        ("estimator", "max_gap", 2, "with a decimal point"),
        ("estimator", "seed", True, "a whole number"),
        ("estimator", "mode", "clever", "not one of hybrid, paper"),
        ("estimator", "vehicle", "tesla", "several vehicles match 'tesla'"),
        ("estimator", "time_jump_threshold", 0.3, "above allowed_lateness"),
        ("can_bridge", "interface", "usb", "interface: known are"),
        ("can_bridge", "bus_options", "hop_limit", "not of the form name=value"),
    ],
)
def test_wrong_values_are_refused_with_the_reason(node, name, value, reason):
    with pytest.raises(InputError, match=reason):
        refuse_wrong(TABLES[node], {name: value})


GOOD = """
/**:
  ros__parameters: {use_sim_time: true, vehicle: nissan_leaf}
ev:
  energy:
    ros__parameters:
      max_gap: 1e0
      qos_overrides: {/ev/plan: {subscription: {depth: 3}}}
"""


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("/ev/estimator:\n  ros__parameters:\n    max_gap: .nan", 3, "outside"),
        ("/ev/estimator:\n  ros__parameters:\n    max_gpa: 1.0", 3, "unknown parameter 'max_gpa'"),
        ("/ev/estimator:\n  ros__parameters:\n\n    max_gap: 1", 4, "with a decimal point"),
        ("estimator:\n  max_gap: 1.0", 2, "expected 'name: value' lines"),
        ("/**:\n  ros__parameters:\n    {allowed_lateness: 3.0}", 3, "above allowed_lateness"),
        ("a: b: c", 1, "not YAML"),
    ],
)
def test_a_wrong_file_is_refused_with_line_and_reason(tmp_path, text, line, reason):
    path = tmp_path / "car.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=reason) as error:
        check_parameter_file(path)
    assert str(error.value).startswith(f"{path}:{line}: ")


def test_a_right_file_of_any_form_passes(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text(GOOD)
    assert read_parameter_file(path, "energy") == {"vehicle": "nissan_leaf", "max_gap": 1.0}
    assert read_parameter_file(path, "estimator") == {"vehicle": "nissan_leaf"}


def test_what_rclpy_declares_is_not_checked_against_the_table(bench, monkeypatch):
    """Ninety parameters of QoS: the vehicle file was read for each, half a second of the start."""
    asked = []
    monkeypatch.setattr(parameters, "refuse_wrong", lambda *given: asked.append(given))
    bench.start(EnergyNode)
    assert len(asked) == 1


def test_a_running_node_takes_right_changes_and_refuses_wrong_ones_as_a_whole(bench):
    node = bench.start(EnergyNode)

    def change(**values):
        parameters = [RosParameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        name = "/ev/energy/set_parameters_atomically"
        return bench.call(SetParametersAtomically, name, parameters=parameters).result

    assert change(nominal_speed=20.0).successful and node.values["nominal_speed"] == 20.0
    refused = change(nominal_speed=10.0, time_jump_policy="guess")
    assert not refused.successful and "not one of" in refused.reason
    assert not change(nominal_speed=math.nan).successful
    assert not change(max_gap=1.0).successful, "read only"
    assert node.values["nominal_speed"] == 20.0 and node.values["max_gap"] == 2.0
    description = node.describe_parameter("nominal_speed")
    assert description.floating_point_range[0].to_value == 100.0 and description.description


@pytest.mark.parametrize("kind", [SetParameters, SetParametersAtomically])
def test_a_parameter_of_a_type_that_there_is_not_ends_no_node(bench, kind):
    """rclpy raises in its own callback, and one request ended the node."""
    node = bench.start(EnergyNode)
    names = {SetParameters: "set_parameters", SetParametersAtomically: "set_parameters_atomically"}
    usual = node.values["nominal_speed"]
    wrong = Parameter(name="nominal_speed", value=ParameterValue(type=200))
    answer = bench.call(kind, f"/ev/energy/{names[kind]}", parameters=[wrong])
    assert not getattr(answer, "results", None) and node.values["nominal_speed"] == usual
    (fault,) = node.health().faults
    assert fault.endswith(f"{names[kind]}: ValueError")
    bench.faulty.add(node)
