"""The shape of the house: who may know whom, and what a core never does."""

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
import re
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "evpinn_ros"

# Each door and the doors behind it: it may import these, and what these may import.
DOORS = {
    "common": "",
    "core": "common",
    "can": "common core",
    "topics": "common core can",
    "bags": "common core can topics",
    "logs": "common core can topics bags",
    "replays": "common core can topics bags logs",
    "report": "common core topics bags replays",
    "nodes": "common core can topics bags logs",
    "api": "common core logs replays report",
    "cli": "common core can topics bags logs replays report nodes api",
    "extras": "common core can topics logs replays report nodes api cli",  # nobody imports it
}
"""What the modules behind each door import from others, no less and no more."""
STARTS = {"", "executables", "__main__", "benchmarks"}
"""What starts the others: it may import each of them."""

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


def door_of(module: str) -> str:
    """The door behind which a module lies."""
    return module.partition(".")[0]


@cache
def imports(name: str) -> list[str]:
    """The full name of everything a module imports, at its top or inside a function."""
    modules: list[str] = []
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            modules += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{name}: a relative import"
            modules += (f"{node.module}.{alias.name}" for alias in node.names)
    return modules


@cache
def calls(name: str) -> list[tuple[str, ast.Call]]:
    nodes = [node for node in ast.walk(tree(name)) if isinstance(node, ast.Call)]
    return [(ast.unparse(node.func), node) for node in nodes]


def ros_packages() -> set[str]:
    manifest = ElementTree.parse(ROOT / "package.xml")
    depends = {tag.text for tag in manifest.iter("exec_depend")}
    return {name for name in depends if not name.startswith("python3-")} | {"ament_index_python"}


def without_ros() -> list[str]:
    """Every module but the nodes and what measures them."""
    return [name for name in MODULES if door_of(name) not in ("nodes", "benchmarks")]


def test_every_module_is_behind_a_door() -> None:
    assert {door_of(name) for name in MODULES} <= DOORS.keys() | STARTS


def test_imports_follow_the_arrows_and_every_arrow_is_taken() -> None:
    taken: dict[str, set[str]] = {door: set() for door in DOORS}
    for name in MODULES:
        door = door_of(name)
        if door not in STARTS:
            inner = [path.split(".") for path in imports(name) if path.startswith("evpinn_ros.")]
            taken[door] |= {path[1] for path in inner} - {door, "__version__"}
    assert taken == {door: set(others.split()) for door, others in DOORS.items()}


def test_the_page_shows_the_arrows() -> None:
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([a-z -]+) \|$", page, re.MULTILINE)
    assert sorted(rows) == sorted((door, others or "-") for door, others in DOORS.items())


def known(names: Iterable[str], packages: set[str]) -> list[tuple[str, str]]:
    """Those of the packages that modules import, each with the module."""
    pairs = [(name, imported.partition(".")[0]) for name in names for imported in imports(name)]
    return [pair for pair in pairs if pair[1] in packages]


def test_only_nodes_know_ros() -> None:
    assert known(without_ros(), ros_packages()) == []


def test_cores_read_no_clock() -> None:
    assert known([name for name in MODULES if door_of(name) == "core"], CLOCKS) == []


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
CONSOLES = {"rich.console.Console": "nodes.live.view", "rich.table.Table": None}
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
