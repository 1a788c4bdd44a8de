"""The ready layouts for Foxglove and PlotJuggler show topics and fields that exist."""

import json
from pathlib import Path
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message, typestore
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.meter import EnergyMeter, EnergyState, Flow
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.estimate import ParameterEstimate, ParameterSet, Trust
from evpinn_ros.core.estimation.terms import COUNT
from evpinn_ros.core.vehicle.files import vehicle_names
from evpinn_ros.core.vehicle.identifiable import Identifiable
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.topics import NAMESPACE, TOPICS, Topic
from evpinn_ros.topics.estimates import (
    breakdown_messages,
    output_messages,
)

VIEWS = Path(__file__).parents[1] / "config" / "views"
FOXGLOVE = json.loads((VIEWS / "foxglove.json").read_text())
PLOTJUGGLER = ElementTree.parse(VIEWS / "plotjuggler.xml").getroot()
BY_NAME = {topic.under(NAMESPACE): topic for topic in TOPICS}
# Which fields of a named vector PlotJuggler makes series of, by name of the quantity.
VECTOR_FIELDS = {"position", "velocity", "effort"}


def panels(node) -> list[str]:
    """The ids of all panels in a layout's tree."""
    if isinstance(node, str):
        return [node]
    assert node["direction"] in ("row", "column") and 0 < node["splitPercentage"] < 100
    return [*panels(node["first"]), *panels(node["second"])]


def paths() -> list[dict]:
    return [p for config in FOXGLOVE["configById"].values() for p in config.get("paths", ())]


def field(type_name: str, path: list[str]) -> str:
    """The base type that a path of fields leads to, an index into an array if there is one."""
    _, fields = typestore().fielddefs[type_name]
    name, index = re.fullmatch(r"(\w+)(\[\d+\])?", path[0]).groups()
    kind, detail = dict(fields)[name]
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        assert index, f"{name} is an array"
        kind, detail = detail[0]
    else:
        assert index is None, f"{name} is no array"
    if kind == Nodetype.NAME:
        return field(detail, path[1:])
    assert path[1:] == []
    return detail[0]


def vector_names() -> dict[Topic, list[str]]:
    """The names in each named vector that the nodes publish when all is known."""
    estimate = ParameterEstimate(0.5, 0.1, 0.5, 0.0, 1.0, Trust.VALID)
    fives = Identifiable(1.0, 1.0, 1.0, 1.0, 1.0)
    found = ParameterSet(1, dict.fromkeys(PARAMETER_NAMES, estimate), fives, fives, True)
    flow = Flow(1.0, 1.0, 1.0)
    state = EnergyState(1, flow, flow, flow, flow, 1.0, 0.0, 0, 0, 0.0, 0.0, True)
    account = EnergyAccount(EnergyMeter(load_rknn()), "bmw_i3", 7e7)
    messages = [
        *output_messages(new_message, found),
        *output_messages(new_message, state),
        *output_messages(new_message, account.summary()),
    ]
    names = {t: m.name for t, m in messages if t.type_name == topics.NAMED_VECTOR_TYPE}
    powers = (topics.POWER_MEASURED, topics.POWER_PREDICTED, topics.POWER_SMOOTHED)
    parts = Breakdown(energy=np.zeros(COUNT), covariance=np.zeros((COUNT, COUNT)))
    ((_, breakdown),) = breakdown_messages(new_message, 1, parts)
    ranges = ["distance_to_empty", "distance_lower", "distance_upper", "state_of_charge"]
    return names | {
        **{power: ["power"] for power in powers},
        topics.ENERGY_BREAKDOWN: breakdown.name,
        topics.ENERGY_RANGE: ranges,
        topics.ENERGY_CONSUMPTION: [f"wh_per_km_{over}" for over in ("1", "10", "100", "trip")],
    }


NAMES = vector_names()


SCRIPTS = [each["sourceCode"] for each in FOXGLOVE["userNodes"].values()]


def exported(script: str) -> tuple[str, str, list[str]]:
    """The topic that a user script takes, the topic that it gives, and the fields of that."""
    topic = re.search(r'inputs = \["(.+)"\]', script)[1]
    output = re.search(r'output = "(.+)"', script)[1]
    return topic, output, re.findall(r"(\w+): number", script.partition("type Output")[2])


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: exported(script)[1])
def test_foxglove_scripts_read_what_is_there_by_name(script):
    name, output, fields = exported(script)
    assert output.startswith("/studio_script/") and f'Input<"{name}">' in script
    wanted = re.findall(r'(\w+): at\("(\w+)"\)', script)
    if BY_NAME[name] is not topics.FORECAST:
        assert [field for field, _ in wanted] == fields
        assert {quantity for _, quantity in wanted} <= set(NAMES[BY_NAME[name]])


def test_foxglove_plots_what_scripts_give_and_no_quantity_by_index():
    known = {f"{output}.{f}" for _, output, fields in map(exported, SCRIPTS) for f in fields}
    values = [path["value"] for path in paths()]
    assert {each for each in values if each.startswith("/studio_script/")} <= known
    assert {output for _, output, _ in map(exported, SCRIPTS)} == {
        each.rpartition(".")[0] for each in values if each.startswith("/studio_script/")
    }
    assert all(each.endswith("[0]") for each in values if "[" in each)  # vectors of one name


@pytest.mark.parametrize(
    "path",
    [path for path in paths() if not path["value"].startswith("/studio_script/")],
    ids=lambda path: path["value"],
)
def test_foxglove_plots_numbers_that_exist(path):
    name, _, inside = path["value"].partition(".")
    topic = BY_NAME[name]
    assert field(topic.type_name, inside.split(".")).startswith("float")
    has_header = any(each == "header" for each, _ in typestore().fielddefs[topic.type_name][1])
    assert path["timestampMethod"] == ("headerStamp" if has_header else "receiveTime")


def test_foxglove_shows_diagnostics():
    shown = [c["topicToRender"] for c in FOXGLOVE["configById"].values() if "topicToRender" in c]
    assert shown == 2 * ["/diagnostics"]
    chosen = FOXGLOVE["configById"]["DiagnosticStatusPanel!estimator"]
    car, _, namespace = chosen["selectedHardwareId"].partition(" ")  # as `status_message` has it
    assert car in vehicle_names() and namespace == NAMESPACE
    assert chosen["selectedName"] == f"{NAMESPACE}/estimator: estimate"


@pytest.mark.parametrize("curve", [c.get("name") for c in PLOTJUGGLER.iter("curve")])
def test_plotjuggler_draws_series_that_exist(curve):
    """Series are named by topic and field; those of a named vector by quantity and field."""
    if curve.startswith("/diagnostics/"):
        said = re.fullmatch("/diagnostics/(.+) /ev//ev/estimator: estimate/progress\\.(.+)", curve)
        assert said[1] in vehicle_names() and said[2] in PARAMETER_NAMES
        return
    name = max((each for each in BY_NAME if curve.startswith(f"{each}/")), key=len)
    topic, path = BY_NAME[name], curve.removeprefix(f"{name}/").split("/")
    if topic.type_name == topics.NAMED_VECTOR_TYPE:
        quantity, kind = path
        assert quantity in NAMES[topic] and kind in VECTOR_FIELDS
    else:
        assert field(topic.type_name, path).startswith("float")
