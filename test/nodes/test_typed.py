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
from evpinn_ros.nodes.typed import LAYOUTS, definition, is_installed

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "evpinn_msgs"


@pytest.mark.parametrize("layout", {layout.name: layout for layout in LAYOUTS.values()}.values())
def test_a_message_file_is_what_the_contract_says(layout):
    assert (PACKAGE / "msg" / f"{layout.name}.msg").read_text() == definition(layout)


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
    assert "power/predicted" in done.stdout and "service" in done.stdout
