"""The shape of the house: who may know whom, and what a core never does."""

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "evpinn_ros"

# From the ground up. A part may import what lies below it, and nothing beside or above it.
LAYERS = [
    {""},
    {"common"},
    {"vehicle"},
    {"signals"},
    {"can", "estimation"},
    {"energy"},  # plans and dropouts by the one equation
    {"paper"},  # a mode of the estimator that it does not know
    {"topics"},  # the contract and its messages, without ROS: bags share it
    {"bags"},
    {"drives"},
    {"plans"},
    {"simulation"},
    {"replays"},
    {"reproduction", "fleet"},
    {"report"},
    {"api"},  # what Python may rely on
    {"nodes"},
    {"live", "bridges"},
    {"cli"},
    {"executables"},
    {"__main__"},
    {"benchmarks"},  # beside the package, in a checkout alone
]
RANKS = {part: rank for rank, layer in enumerate(LAYERS) for part in layer}
CORES = {"vehicle", "signals", "estimation", "energy", "paper"}

CLOCKS = {"time", "datetime"}
UNSAFE_MODULES = {"dill", "joblib", "marshal", "pickle", "shelve"}
UNSAFE_YAML = {"yaml.load", "yaml.load_all", "yaml.full_load", "yaml.unsafe_load"}


def modules() -> Iterator[tuple[str, Path]]:
    """Every module: its name below `evpinn_ros` or with `benchmarks`, and its file."""
    for folder, above in ((PACKAGE, PACKAGE), (ROOT / "benchmarks", ROOT)):
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(above).with_suffix("").parts
            name = ".".join(part for part in parts if part != "__init__")
            yield name, path


MODULES = dict(modules())


@cache
def tree(name: str) -> ast.Module:
    return ast.parse(MODULES[name].read_text(), str(MODULES[name]))


def part_of(module: str) -> str:
    """The part of the house that a module belongs to."""
    return module.partition(".")[0]


@cache
def imports(name: str) -> list[str]:
    """The full name of everything a module imports, at its top or inside a function."""
    found: list[str] = []
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{name}: a relative import"
            found += (f"{node.module}.{alias.name}" for alias in node.names)
    return found


@cache
def calls(name: str) -> list[tuple[str, ast.Call]]:
    nodes = [node for node in ast.walk(tree(name)) if isinstance(node, ast.Call)]
    return [(ast.unparse(node.func), node) for node in nodes]


def ros_packages() -> set[str]:
    manifest = ElementTree.parse(ROOT / "package.xml")
    depends = {tag.text for tag in manifest.iter("exec_depend")}
    return {name for name in depends if not name.startswith("python3-")} | {"ament_index_python"}


def without_ros() -> list[str]:
    """Every module but the nodes, the live view of them and what measures them."""
    return [name for name in MODULES if part_of(name) not in ("nodes", "live", "benchmarks")]


def test_every_module_has_its_layer() -> None:
    assert {part_of(name) for name in MODULES} <= RANKS.keys()


def upward(name: str) -> Iterator[tuple[str, str]]:
    """What a module imports that does not lie below it."""
    own = part_of(name)
    for imported in imports(name):
        top, _, inside = imported.partition(".")
        if top in ("benchmarks", "evpinn_ros"):
            other = part_of(inside) if top == "evpinn_ros" else top
            # The version and the like: `from evpinn_ros import __version__`.
            other = other if other in RANKS else ""
            if other != own and RANKS[other] >= RANKS[own]:
                yield name, imported


def known(names: Iterable[str], packages: set[str]) -> list[tuple[str, str]]:
    """Those of the packages that modules import, each with the module."""
    pairs = [(name, imported.partition(".")[0]) for name in names for imported in imports(name)]
    return [pair for pair in pairs if pair[1] in packages]


def test_dependencies_point_down() -> None:
    assert [found for name in MODULES for found in upward(name)] == []


def below(part: str) -> set[str]:
    """The rooms that modules of a room import."""
    found = {
        (imported if imported.startswith("benchmarks") else imported.partition(".")[2])
        for name in MODULES
        if part_of(name) == part
        for imported in imports(name)
        if imported.startswith(("benchmarks.", "evpinn_ros."))
    }
    return {part_of(each) for each in found} & {*ROOMS} - {part}


ROOMS = [part for layer in LAYERS for part in layer if (PACKAGE / part).is_dir() and part]
ROOMS.append("benchmarks")


def test_the_picture_names_rooms_that_are_there() -> None:
    named = re.findall(r'class="room"[^>]*>(\w+)/<', (ROOT / "docs/data_flow.svg").read_text())
    assert {"signals", "estimation", "energy"} <= {*named} <= {*ROOMS}


def test_the_page_shows_who_imports_whom() -> None:
    """The arrows of architecture.md, of which none follows from others."""
    direct = {room: below(room) for room in ROOMS}
    reached: dict[str, set[str]] = {}
    for room in ROOMS:  # from the ground up
        reached[room] = direct[room].union(*(reached[each] for each in direct[room]))
    arrows = {
        room: direct[room] - set().union(*(reached[each] for each in direct[room]))
        for room in ROOMS
    }
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text()
    lines = [line.split("->") for line in page.splitlines() if "->" in line and " -> " in line]
    shown = {room.strip(): {*targets[0].replace(" ", "").split(",")}
             for room, *targets in lines if len(targets) == 1}  # fmt: skip
    assert shown == {room: targets for room, targets in arrows.items() if targets}


def test_only_nodes_know_ros() -> None:
    assert known(without_ros(), ros_packages()) == []


@pytest.mark.nightly
@pytest.mark.slow
def test_everything_but_the_nodes_loads_without_ros() -> None:
    names = [f"evpinn_ros.{name}".rstrip(".") for name in without_ros() if name != "__main__"]
    code = (
        "import importlib, sys\n"
        f"sys.modules.update(dict.fromkeys({ros_packages()}))\n"
        f"for name in {names}:\n"
        "    importlib.import_module(name)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_cores_read_no_clock() -> None:
    assert known([name for name in MODULES if part_of(name) in CORES], CLOCKS) == []


def test_files_are_read_safely() -> None:
    assert known(MODULES, UNSAFE_MODULES) == []
    for name in MODULES:
        for function, call in calls(name):
            options = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
            assert function not in UNSAFE_YAML, (name, ast.unparse(call))
            assert options.get("allow_pickle", "False") == "False", (name, ast.unparse(call))
            if function == "torch.load":
                assert options.get("weights_only") == "True", (name, ast.unparse(call))


SAFE_TO_PRINT = ("printable(", "json.dumps(", "json_text(")
PRINTERS = {"print", "typer.echo", "sys.stdout.write", "sys.stderr.write"}
CONSOLES = {"rich.console.Console": "live.view", "rich.table.Table": None}
"""What shows text, and would obey the escapes and the markup in it."""


def test_what_a_person_sees_goes_through_one_function() -> None:
    """Topics, files and cars have names from anywhere: `printable` is before every terminal."""
    for name in MODULES.keys() - {"cli.console", "common.plain_table"}:  # they are the way
        for imported in imports(name):
            assert CONSOLES.get(imported, name) == name, f"{name} imports {imported}"
        for called, node in calls(name):
            if called in PRINTERS:
                texts = [ast.unparse(argument) for argument in node.args]
                assert all(text.startswith(SAFE_TO_PRINT) for text in texts), f"{name}: {texts}"
            assert not called.endswith((".from_markup", "results.print", "notes.print")), name
            if called == "TextColumn":
                assert any(keyword.arg == "markup" for keyword in node.keywords), name
