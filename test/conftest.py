"""What a test costs, and what tests share: a control unit on a real bus, an installed package."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
import fcntl
from functools import cache
import gc
from importlib.util import module_from_spec, spec_from_file_location
from itertools import chain, zip_longest
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

from hypothesis import settings
import pytest

if TYPE_CHECKING:
    import can

    from evpinn_ros.can.request import Address

COSTS = frozenset({"ros", "browser", "build", "torch", "slow", "nightly"})
"""Marks of what `--quick` leaves out (`pyproject.toml` says what each means)."""

HEAVY = ("rclpy", "torch")
"""Modules that no test without such a mark may load: each takes seconds."""

# Thousands of tests and what they import are live objects: to look through them for cycles as
# often as Python does by itself takes 7 % of the processor's time.
gc.set_threshold(100_000, 50, 100)

# A shell ignores the first in what it runs in the background, `nohup` the second, and each process
# that a test starts and interrupts would have it from here.
for ignored, handler in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(ignored) is signal.SIG_IGN:
        signal.signal(ignored, handler)

# Without a deadline for an example, which depends on the machine: pytest-timeout ends a hang.
settings.register_profile("default", deadline=None)
settings.load_profile("default")
settings.register_profile("quick", settings.get_profile("ci"), max_examples=25)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--quick", action="store_true", help="only tests without a mark of COSTS (conftest.py)"
    )


@cache
def costs_of(path: Path) -> frozenset[str]:
    """Marks that a file, or the `conftest.py` of a folder, has for all of it: `pytestmark = ...`.

    They are read from the text: importing it may be what costs.
    """
    path = path / "conftest.py" if path.is_dir() else path
    if path.suffix != ".py" or not path.is_file():
        return frozenset()
    marks = [
        node.value
        for node in ast.parse(path.read_bytes()).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"
    ]
    nodes = (node for mark in marks for node in ast.walk(mark))
    return COSTS & {node.attr for node in nodes if isinstance(node, ast.Attribute)}


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Whether `--quick` does not even import this; None lets others decide."""
    return True if config.getoption("quick") and costs_of(collection_path) else None


def pytest_itemcollected(item: pytest.Item) -> None:
    """A folder's marks are those of its tests."""
    for folder in item.path.parents[: len(item.path.relative_to(ROOT).parts) - 1]:
        for name in costs_of(folder):
            item.add_marker(name)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail a test of `--quick` that loads what it has no mark for."""
    before = {*sys.modules}
    yield
    if item.config.getoption("quick"):
        loaded = [name for name in HEAVY if name in sys.modules and name not in before]
        assert not loaded, f"loads {loaded}: mark it (COSTS in test/conftest.py)"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Order files so that no core rests, and leave out what costs where `--quick` is.

    Files that wait and files that compute take turns, each begun with the long ones.
    """
    if config.getoption("quick"):
        loaded = [name for name in HEAVY if name in sys.modules]
        if loaded:
            raise pytest.UsageError(f"collecting loads {loaded}: mark the file that imports it")
        items[:] = [item for item in items if not any(item.get_closest_marker(c) for c in COSTS)]

    def place(path: Path, names: tuple[str, ...]) -> int:
        parts = path.relative_to(ROOT / "test").parts
        return next((at for at, name in enumerate(names) if name in parts), len(names))

    files = defaultdict(list)
    for item in items:
        files[item.path].append(item)
    waiting = [path for path in files if place(path, WAITING) < len(WAITING)]
    computing = [path for path in files if path not in waiting]
    waiting.sort(key=lambda path: place(path, WAITING))
    computing.sort(key=lambda path: place(path, LONG))
    turns = chain.from_iterable(zip_longest(waiting, computing))
    items[:] = [item for path in turns if path is not None for item in files[path]]


WAITING = ("launch", "nodes", "can", "bridges")
"""Folders whose tests mostly wait: for processes, for buses, for each other."""

LONG = (
    *("test_guides.py", "test_browser.py", "cli", "benchmarks", "estimation", "replays", "fleet"),
    *("reproduction", "test_notebooks.py", "test_packaging.py"),
)
"""Long files and folders of them: begun first, they leave no worker alone with one in the end."""

ROOT = Path(__file__).resolve().parents[1]


def load_example(name: str) -> Any:
    """The module of a file in `examples`."""
    spec = spec_from_file_location(Path(name).stem, ROOT / "examples" / name)
    assert spec is not None and spec.loader is not None
    module = sys.modules[spec.name] = module_from_spec(spec)  # dataclasses look there
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def empty_files(tmp_path: Path) -> Callable[..., Path]:
    """Makes empty files by their names in a folder, and gives the folder."""

    def make(*names: str) -> Path:
        for name in names:
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        return tmp_path

    return make


@pytest.fixture(scope="session")
def loads_without() -> Callable[..., None]:
    """Asserts that a Python that has run some code has loaded none of these modules."""

    def check(code: str, *modules: str) -> None:
        code = f"import sys; {code}\nassert not {set(modules)} & {{*sys.modules}}, sys.modules"
        ended = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True
        )
        assert ended.returncode == 0, ended.stderr

    return check


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A folder by its name, filled once for all workers: by the first that asks for it."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def made(name: str, fill: Callable[[Path], object]) -> Path:
        folder, filled = base / name, base / f"{name}.filled"
        with (base / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not filled.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                fill(folder)
                filled.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def source(shared: Callable[..., Path]) -> Path:
    """A copy to build from, so that no build leaves anything behind in the checkout."""
    unwanted = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "install")

    def copy(folder: Path) -> None:
        shutil.copytree(ROOT, folder / "evpinn_ros", ignore=unwanted)

    return shared("source", copy) / "evpinn_ros"


@pytest.fixture(scope="session")
def installed(source: Path, shared: Callable[..., Path]) -> Path:
    """The install space of `colcon build`."""

    def build(space: Path) -> None:
        colcon = (sys.executable, "-m", "colcon", "--log-base", str(space / "log"))
        bases = ("--build-base", str(space / "build"), "--install-base", str(space / "install"))
        ended = subprocess.run(
            [*colcon, "build", "--paths", str(source), *bases],
            cwd=space,
            env=os.environ | {"COLCON_HOME": str(space)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 0, ended.stdout + ended.stderr

    return shared("colcon", build) / "install"


Replies = Mapping[bytes, Callable[[], list[bytes]]]


class SimulatedUnit:
    """Answers each request with what its entry gives now; an empty list is silence.

    Attributes:
        asked: every request so far.
        answers: how many answers to them were sent, or soon are.
    """

    def __init__(self, bus: can.BusABC, address: Address, replies: Replies) -> None:
        import isotp  # the tests of the core work without it

        self.asked: list[bytes] = []
        self.answers = 0
        self._bus, self._replies = bus, replies
        mode = isotp.AddressingMode
        ids: dict[str, Any] = {"txid": address.rx_id, "rxid": address.tx_id}
        if address.target is None:
            kind = mode.Normal_29bits if address.extended else mode.Normal_11bits
        else:
            kind = mode.Extended_11bits
            ids |= {"target_address": address.source, "source_address": address.target}
        self._stack = isotp.CanStack(
            bus,
            address=isotp.Address(kind, **ids),
            params={"tx_padding": 0xAA, "rx_flowcontrol_timeout": 60_000},
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._stack.start()
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._stack.stop()
        self._bus.shutdown()

    def _run(self) -> None:
        while not self._stop.is_set():
            request = self._stack.recv(block=True, timeout=0.02)
            if request is None:
                continue
            payloads = self._replies.get(bytes(request), list)()
            self.answers += len(payloads)  # before `asked`, for whoever waits for the answers
            self.asked.append(bytes(request))
            for payload in payloads:
                self._stack.send(payload)


@pytest.fixture
def simulated_unit() -> Iterator[Callable[..., SimulatedUnit]]:
    """Makes control units and stops them in the end."""
    units: list[SimulatedUnit] = []

    def make(*arguments: Any) -> SimulatedUnit:
        units.append(SimulatedUnit(*arguments))
        return units[-1]

    yield make
    for unit in units:
        unit.close()
