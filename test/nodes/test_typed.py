"""The package `evpinn_msgs`: its files are those of the contract, and its topics equal the others.

`make test` builds it where a compiler is; EVPINN_MSGS names another folder it is installed in.
"""

from pathlib import Path
import re
from xml.etree import ElementTree

import pytest

import evpinn_ros
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.energy.plan import CONDITION_RANGES
from evpinn_ros.core.estimation.breakdown import REGAINED, UNEXPLAINED, WHOLE, Part
from evpinn_ros.core.vehicle.identifiable import IDENTIFIABLE_NAMES
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.typed import RATE, SIGMA, TYPED
from evpinn_ros.topics.energies import FLOWS
from evpinn_ros.topics.estimates import POWER, UNMEASURED_ENERGY

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "evpinn_msgs"
FILES = sorted(f for kind in ("msg", "srv", "action") for f in PACKAGE.glob(f"{kind}/*.{kind}"))


PARTS = tuple(part.name.lower() for part in list(Part)[WHOLE])
COSTS = tuple(f"wh_per_km_{over}" for over in ("1", "10", "100", "trip", "lifetime"))
CHARGE = ("usable_energy", "state_of_charge", "capacity")
QUANTITIES = {
    "VehicleParameters": PARAMETER_NAMES,
    "IdentifiableCombinations": IDENTIFIABLE_NAMES,
    "BatteryPower": (POWER, UNMEASURED_ENERGY),
    "BatteryEnergy": (*FLOWS, "consumed"),
    "EnergyBreakdown": (*PARTS, UNEXPLAINED, "measured", REGAINED),
    "EnergyConsumption": (*COSTS, "distance_trip", "distance_lifetime"),
    "RemainingRange": ("distance_to_empty", "distance_lower", "distance_upper", *CHARGE),
}
OF_NO_BOUND = {"distance_lower_sigma", "distance_upper_sigma"}
ENDS = {"BatteryEnergy": ("", RATE, SIGMA), "EnergyConsumption": ("",)}


@pytest.mark.parametrize(("name", "quantities"), list(QUANTITIES.items()))
def test_a_message_file_has_the_quantities_of_its_vector(name, quantities):
    text = (PACKAGE / "msg" / f"{name}.msg").read_text()
    fields = re.findall(r"^float64 (\w+)", text, re.MULTILINE)
    ends = ENDS.get(name, ("", SIGMA))
    expected = [f"{quantity}{end}" for quantity in quantities for end in ends]
    assert fields == [field for field in expected if field not in OF_NO_BOUND]


def test_every_typed_topic_has_its_message_file():
    assert {topic.type_name.rpartition("/")[2] for topic in TYPED.values()} == {*QUANTITIES}


def test_conditions_are_those_of_the_named_vector():
    text = (PACKAGE / "msg" / "PlanConditions.msg").read_text()
    assert re.findall(r"^float64\[<=1\] (\w+)", text, re.MULTILINE) == [*CONDITION_RANGES]


def test_every_file_is_built_and_the_version_is_one():
    built = {*re.findall(r"(?:msg|srv|action)/\w+\.\w+", (PACKAGE / "CMakeLists.txt").read_text())}
    assert built == {f"{f.parent.name}/{f.name}" for f in FILES}
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert manifest.findtext("version") == evpinn_ros.__version__


def test_nothing_but_typed_topics_needs_their_package(bench):
    with pytest.raises(InputError, match="evpinn_msgs is not installed"):
        bench.start(EnergyNode, named_vectors=False)


def test_typed_and_standard_topics_are_equal_and_plans_are_compared(run_with_messages):
    run_with_messages("typed_check.py")
