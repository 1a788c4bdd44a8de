"""The package `evpinn_msgs`: its files are those of the contract, and its topics equal the others.

`make test` builds it where a compiler is; EVPINN_MSGS names another folder it is installed in.
"""

import os
from pathlib import Path
import re
import subprocess
import sys
import sysconfig
from xml.etree import ElementTree

import pytest

import evpinn_ros
from evpinn_ros.nodes.typed import RATE, SIGMA, TYPED, is_installed
from evpinn_ros.topics.estimates import FLOWS, POWER, UNMEASURED_ENERGY
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "evpinn_msgs"


CHARGE = ("usable_energy", "state_of_charge", "capacity")
QUANTITIES = {
    "Parameters": PARAMETER_NAMES,
    "Power": (POWER, UNMEASURED_ENERGY),
    "Energy": (*FLOWS, "consumed"),
    "Range": ("distance_to_empty", "distance_lower", "distance_upper", *CHARGE),
}


@pytest.mark.parametrize(("name", "quantities"), QUANTITIES.items())
def test_a_message_file_has_the_quantities_of_its_vector(name, quantities):
    text = (PACKAGE / "msg" / f"{name}.msg").read_text()
    fields = re.findall(r"^float64 (\w+)", text, re.MULTILINE)
    ends = ("", RATE, SIGMA) if name == "Energy" else ("", SIGMA)
    assert fields == [f"{each}{end}" for each in quantities for end in ends]


def test_every_typed_topic_has_its_message_file():
    assert {each.type_name.rpartition("/")[2] for each in TYPED.values()} == {*QUANTITIES}


def test_every_file_is_built_and_the_version_is_one():
    built = {
        *re.findall(r"(?:msg|srv)/\w+\.(?:msg|srv)", (PACKAGE / "CMakeLists.txt").read_text())
    }
    assert built == {f"{f.parent.name}/{f.name}" for f in PACKAGE.glob("*/*.[ms][sr][gv]")}
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert manifest.findtext("version") == evpinn_ros.__version__


def test_typed_and_standard_topics_are_equal_and_plans_are_compared():
    prefix = Path(os.environ.get("EVPINN_MSGS", Path(sys.prefix, "msgs")))
    package = sysconfig.get_path("purelib", vars={"base": str(prefix)})
    if not (Path(package, "evpinn_msgs").is_dir() or is_installed()):
        pytest.skip("evpinn_msgs is not built: `make test` does it where a compiler is")
    environment = dict(os.environ)
    for name, folder in (("PYTHONPATH", package), ("LD_LIBRARY_PATH", prefix / "lib")):
        environment[name] = os.pathsep.join((str(folder), os.environ.get(name, "")))
    environment["PYTHONPATH"] += f"{os.pathsep}{ROOT}"
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("typed_check.py")],
        env=environment, capture_output=True, text=True, timeout=150,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    print(done.stdout)
    assert "power/predicted" in done.stdout and "service" in done.stdout
