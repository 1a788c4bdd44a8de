"""What leaves the checkout: the wheel, the colcon install, and the dependencies both declare."""

import ast
from collections.abc import Iterable, Iterator
from email import message_from_string
from functools import cache
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest
import yaml

import evpinn_ros
from evpinn_ros.common.optional import EXTRA_OF

pytestmark = pytest.mark.build

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
DEPENDS = {tag.text for tag in MANIFEST.iter("exec_depend")}
ROS_PACKAGES = {name for name in DEPENDS if not name.startswith("python3-")}
OPTIONAL = "optional_imports()", "suppress(ImportError)", "TYPE_CHECKING"
OURS = {"benchmarks", "evpinn_ros"}  # the first in a checkout alone, as the examples that use it
EXECUTABLES = {"can_bridge", "energy", "estimator", "evpinn"}
EXAMPLES = {path.name for path in (ROOT / "examples").glob("*.py")}

# What is imported: its name at the package index and its rosdep key, where it has one.
NAMES = {
    "asammdf": ("asammdf", None),
    "can": ("python-can", "python3-can"),
    "cantools": ("cantools", "python3-cantools-pip"),
    "distributed": ("dask", None),
    "isotp": ("can-isotp", None),
    "jinja2": ("jinja2", None),
    "libsumo": ("libsumo", None),
    "kuksa_client": ("kuksa-client", None),
    "lz4": ("lz4", None),
    "matplotlib": ("matplotlib", None),
    "mcap": ("mcap", None),
    "numpy": ("numpy", "python3-numpy"),
    "openpyxl": ("openpyxl", None),
    "paho": ("paho-mqtt", None),
    "pandas": ("pandas", None),
    "polars": ("polars", None),
    "pyarrow": ("pyarrow", None),
    "pydantic": ("pydantic", None),
    "pydantic_core": ("pydantic", None),
    "rasterio": ("rasterio", None),
    "rclpy": ("ros-rclpy", "rclpy"),
    "rich": ("rich", "python3-rich"),
    "rosbags": ("rosbags", "python3-rosbags-pip"),
    "scipy": ("scipy", "python3-scipy"),
    "serial": ("pyserial", "python3-serial"),
    "sumo": ("eclipse-sumo", None),
    "threadpoolctl": ("threadpoolctl", None),
    "torch": ("torch", "python3-torch"),
    "typer": ("typer", "python3-typer"),
    "udsoncan": ("udsoncan", None),
    "yaml": ("pyyaml", "python3-yaml"),
    "zstandard": ("zstandard", None),
}


def run(*command: object, **options: object) -> str:
    ended = subprocess.run(
        [str(part) for part in command], stdin=subprocess.DEVNULL, capture_output=True, **options
    )
    assert ended.returncode == 0, (ended.stdout + ended.stderr).decode()
    return ended.stdout.decode()


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel")
    run(*pip, "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source)
    return ZipFile(next(folder.glob("*.whl")))


def in_workspace(installed: Path, *command: object) -> str:
    """The output of a command in a shell that sourced the workspace, away from the checkout."""
    return run("sh", "-c", '. ./local_setup.sh && "$@"', "sh", *command, cwd=installed)


def read_info(wheel: ZipFile, name: str) -> str:
    return wheel.read(f"evpinn_ros-{evpinn_ros.__version__}.dist-info/{name}").decode()


def requirements(wheel: ZipFile) -> dict[str, set[str]]:
    """Names of what is required, by extra; the empty one is what every installation has."""
    lines = message_from_string(read_info(wheel, "METADATA")).get_all("Requires-Dist")
    by_extra: dict[str, set[str]] = {}
    for line in lines:
        extra = re.search(r'extra == "(\w+)"', line)
        names = by_extra.setdefault(extra[1] if extra else "", set())
        names.add(re.match(r"[\w-]+", line)[0].lower())
    return by_extra


def imports(nodes: Iterable[ast.AST]) -> set[str]:
    """Packages that statements import, without Python's own and ours."""
    names = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module)
    return {name.partition(".")[0] for name in names} - sys.stdlib_module_names - OURS


@cache
def trees(folder: str) -> list[ast.Module]:
    return [ast.parse(path.read_text()) for path in (ROOT / folder).rglob("*.py")]


def third_party_imports(folder: str) -> set[str]:
    return set().union(*(imports(ast.walk(tree)) for tree in trees(folder)))


def required_imports(folder: str) -> set[str]:
    """Packages without which some file of a folder fails other than by `optional_imports`."""
    names = set()
    for tree in trees(folder):
        blocks = {kind: list(blocks_of(tree, kind)) for kind in OPTIONAL}
        inside = {node for nodes in blocks.values() for node in nodes}
        outside = imports(node for node in ast.walk(tree) if node not in inside)
        names |= outside - imports(blocks["optional_imports()"])
    return names


def blocks_of(tree: ast.Module, head: str) -> Iterator[ast.AST]:
    """All nodes in the blocks that begin with an expression, after `with` or `if`."""
    for block in ast.walk(tree):
        if isinstance(block, ast.With | ast.If):
            first = block.test if isinstance(block, ast.If) else block.items[0].context_expr
            if ast.unparse(first) == head:
                yield from ast.walk(block)


def test_version_is_one(wheel: ZipFile) -> None:
    metadata = message_from_string(read_info(wheel, "METADATA"))
    assert metadata["Version"] == MANIFEST.findtext("version") == evpinn_ros.__version__
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == evpinn_ros.__version__
    heading = f"## {citation['version']} - {citation['date-released']}\n"
    assert heading in (ROOT / "CHANGELOG.md").read_text()


def test_manifest_declares_what_every_installation_has(wheel: ZipFile) -> None:
    """By its rosdep key; what has none is named in a comment."""
    keys, required = dict(NAMES.values()), requirements(wheel)[""]
    of_can = "python3-msgpack"  # of python-can[multicast]
    assert {*(keys[name] for name in required), of_can} - {None} == DEPENDS - ROS_PACKAGES
    text = (ROOT / "package.xml").read_text()
    named = re.search(r"Without a rosdep key: ([^.]+)\.", text)[1].split(", ")
    assert {*named} == {name for name in required if keys[name] is None}


def test_wheel_declares_what_is_imported(wheel: ZipFile) -> None:
    imported = third_party_imports("evpinn_ros") | third_party_imports("examples")
    needed = {NAMES[name][0] for name in imported - ROS_PACKAGES}
    imported -= {"launch", "launch_ros"}  # no wheels: launch files alone import what needs them
    needed |= {f"ros-{name.replace('_', '-')}" for name in imported & ROS_PACKAGES}
    declared = requirements(wheel)
    del declared["dev"]
    assert needed <= set().union(*declared.values())


def test_every_installation_has_what_is_not_imported_as_optional(wheel: ZipFile) -> None:
    imported = required_imports("evpinn_ros") - ROS_PACKAGES
    assert {NAMES[name][0] for name in imported} <= requirements(wheel)[""]


def test_an_optional_package_comes_with_the_extra_that_is_named(wheel: ZipFile) -> None:
    declared = requirements(wheel)
    for module, extra in EXTRA_OF.items():
        assert NAMES[module][0] in declared[extra], module


def test_constraints_pin_every_requirement(wheel: ZipFile) -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.partition("==")[0].lower() for line in lines if "==" in line}
    assert pinned == set().union(*requirements(wheel).values())


def test_wheel_holds_every_file(wheel: ZipFile) -> None:
    files = {
        path.relative_to(ROOT).as_posix()
        for folder in ("evpinn_ros", "config", "launch")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert "evpinn_ros/core/energy/rknn_weights.npz" in files
    share = f"evpinn_ros-{evpinn_ros.__version__}.data/data/share/evpinn_ros/"
    held = {name.removeprefix(share) for name in wheel.namelist()}
    assert files <= held


def test_a_release_is_what_its_tag_says_and_needs_its_tests() -> None:
    flow = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text())
    assert flow[True] == {"push": {"tags": ["v*"]}}  # YAML 1.1 reads `on` as true
    jobs = flow["jobs"]
    assert jobs["publish"]["needs"] == "build" and jobs["build"]["needs"] == "test"
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
    words = " ".join(step.get("run", "") for step in jobs["build"]["steps"])
    check = re.search(r"python3 -c '(.+?)'", words)[1]
    for tag, accepted in ((f"v{evpinn_ros.__version__}", True), ("v99.0.0", False)):
        named = os.environ | {"GITHUB_REF_NAME": tag}
        ended = subprocess.run([sys.executable, "-c", check], cwd=ROOT, env=named)
        assert (ended.returncode == 0) == accepted


def test_colcon_installs_the_package(installed: Path) -> None:
    prefix = installed / "evpinn_ros"
    assert (prefix / "share/evpinn_ros/config/vehicles/generic.yaml").is_file()
    assert (prefix / "share/evpinn_ros/package.xml").is_file()
    assert (prefix / "share/ament_index/resource_index/packages/evpinn_ros").is_file()
    executables = {path.name for path in (prefix / "lib/evpinn_ros").iterdir()}
    assert executables == EXECUTABLES | EXAMPLES


def test_colcon_install_uses_its_own_files(installed: Path) -> None:
    code = (
        "from evpinn_ros.common import package_data as data\n"
        "print(data.__file__, data.share_directory())"
    )
    for path in in_workspace(installed, sys.executable, "-c", code).split():
        assert Path(path).is_relative_to(installed / "evpinn_ros")


def test_installed_command_runs(installed: Path) -> None:
    assert "replay" in in_workspace(installed, "evpinn_ros/lib/evpinn_ros/evpinn", "--help")


@pytest.mark.parametrize("name", ["eco_speed_planner.py", "simulated_robot.py"])
def test_installed_example_is_what_one_reads(installed: Path, name: str) -> None:
    example = installed / "evpinn_ros" / "lib" / "evpinn_ros" / name
    assert example.read_bytes() == (ROOT / "examples" / example.name).read_bytes()
    assert os.access(example, os.X_OK)


def test_installed_nodes_load(installed: Path) -> None:
    """Everything an executable does, short of calling the function it found."""
    code = (
        "from importlib.metadata import distribution\n"
        "for entry_point in distribution('evpinn_ros').entry_points:\n"
        "    print(entry_point.load().__code__.co_filename)"
    )
    loaded = in_workspace(installed, sys.executable, "-c", code).split()
    assert len(loaded) == len(EXECUTABLES)
    assert all(Path(path).is_relative_to(installed) for path in loaded)


@pytest.fixture(scope="module")
def linked(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The install space of the guide's lines, with links in place of copies."""
    space = tmp_path_factory.mktemp("linked")
    (space / "src").mkdir()
    shutil.copytree(source, space / "src" / "evpinn_ros")
    (space / "src" / "evpinn_msgs").symlink_to("evpinn_ros/evpinn_msgs")
    without_messages = ("--packages-skip", "evpinn_msgs")  # `make test` compiles them, a minute
    ended = subprocess.run(
        [sys.executable, "-m", "colcon", "build", "--symlink-install", *without_messages],
        cwd=space, env=os.environ | {"COLCON_HOME": str(space)}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "arning" not in ended.stderr, ended.stderr  # of LICENSE; of a package left out
    return space / "install"


@pytest.mark.nightly
def test_a_workspace_of_links_runs_what_is_in_its_source(linked: Path) -> None:
    code = "from evpinn_ros.common import package_data as data; print(data.__file__)"
    path = Path(in_workspace(linked, sys.executable, "-c", code).strip())
    name = "evpinn_ros/common/package_data.py"
    assert path.resolve() == (linked.parent / "src" / "evpinn_ros" / name).resolve()
    assert "replay" in in_workspace(linked, "evpinn_ros/lib/evpinn_ros/evpinn", "--help")
    shown = in_workspace(linked, "evpinn_ros/lib/evpinn_ros/evpinn", "vehicles")
    assert "bmw_i3" in shown
    assert (linked / "evpinn_ros/share/evpinn_ros/launch/evpinn.launch.py").is_symlink()


def test_colcon_test_runs_the_tests(installed: Path, source: Path) -> None:
    """As far as one file of them; all would start this one again."""
    space = installed.parent
    colcon = (sys.executable, "-m", "colcon", "--log-base", space / "log")
    bases = ("--build-base", space / "build", "--install-base", space / "install")
    which = ("--return-code-on-test-failure", "--pytest-args", "test/common/test_errors.py")
    home = os.environ | {"COLCON_HOME": str(space)}
    run(*colcon, "test", "--paths", source, *bases, *which, cwd=space, env=home)
    result = run(*colcon, "test-result", "--all", "--test-result-base", space / "build", env=home)
    assert re.search(r"Summary: [1-9]\d* tests, 0 errors, 0 failures", result)
