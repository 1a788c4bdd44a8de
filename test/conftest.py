"""A control unit on a real bus, this package as colcon installs it; what `--quick` leaves out."""

from collections.abc import Callable, Iterator, Mapping
import os
from pathlib import Path
import shutil
import subprocess
import sys
import threading
from typing import Any

import can
from hypothesis import settings
import isotp
import pytest

from evpinn_ros.can.request import Address

NOT_QUICK = frozenset(
    {
        *("api", "benchmarks", "cli", "fleet", "nodes", "paper", "reproduction"),
        *("test_docs.py", "test_executables.py", "test_guides.py", "test_notebooks.py"),
        *("test_packaging.py", "test_reproduction_page.py", "test_site.py"),
        *("test_browser.py", "test_drive_page.py", "test_captures.py", "test_logs_fuzz.py"),
        *("test_golden.py", "test_order.py", "test_replay.py", "test_output.py"),
        *("test_drives.py", "test_estimator.py", "test_evidence.py", "test_faults.py"),
        *("test_payload.py", "test_published.py", "test_state_schema.py"),
        *("test_metric_table.py", "test_recorded.py", "test_rknn_training.py"),
        *("test_robustness.py", "test_state.py", "estimation/test_stuck.py"),
        *("test_codec_properties.py", "test_mcap_file.py"),
        *("test_power_loss.py", "test_stream_properties.py", "test_any_format.py"),
        *("test_pinn.py", "test_first_change.py"),
        *("test_car_filter.py", "test_comparison.py", "test_grade_detector.py"),
        *("test_inspection.py", "test_owner_text.py", "test_current_sign.py"),
        *("test_bombs.py", "test_recover.py", "test_storage.py"),
        *("test_ledger.py", "test_simulate.py"),
    }
)
"""Folders and files that start ROS, a browser, colcon or processes, load torch, or take long.

Single tests of other files are marked `slow`.
"""

settings.register_profile("quick", settings.get_profile("ci"), max_examples=25)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--quick", action="store_true", help="leave out NOT_QUICK of test/conftest.py"
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Whether `--quick` does not even import this; None lets others decide."""
    names = {collection_path.name, f"{collection_path.parent.name}/{collection_path.name}"}
    return True if config.getoption("quick") and names & NOT_QUICK else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the long ones, and leave out those marked `slow` where `--quick` is."""
    if config.getoption("quick"):
        items[:] = [item for item in items if item.get_closest_marker("slow") is None]

    def turn(item: pytest.Item) -> int:
        folders = item.path.relative_to(ROOT / "test").parts
        return next((at for at, name in enumerate(LONG) if name in folders), len(LONG))

    items.sort(key=turn)


LONG = ("launch", "nodes", "cli", "benchmarks", "estimation", "replays", "fleet", "reproduction")
"""Folders of long files: begun first, they leave no worker alone with one in the end."""

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def loads_without() -> Callable[..., None]:
    """Asserts that a Python that has run some code has loaded none of these modules."""

    def check(code: str, *modules: str) -> None:
        code = f"import sys; {code}\nassert not {set(modules)} & {{*sys.modules}}, sys.modules"
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr

    return check


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy to build from, so that no build leaves anything behind in the checkout."""
    copy = tmp_path_factory.mktemp("source") / "evpinn_ros"
    unwanted = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "install")
    return shutil.copytree(ROOT, copy, ignore=unwanted)


@pytest.fixture(scope="session")
def installed(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The install space of `colcon build`."""
    space = tmp_path_factory.mktemp("colcon")
    colcon = (sys.executable, "-m", "colcon", "--log-base", str(space / "log"))
    bases = ("--build-base", str(space / "build"), "--install-base", str(space / "install"))
    done = subprocess.run(
        [*colcon, "build", "--paths", str(source), *bases],
        cwd=space,
        env=os.environ | {"COLCON_HOME": str(space)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return space / "install"


Replies = Mapping[bytes, Callable[[], list[bytes]]]


class SimulatedUnit:
    """Answers each request with what its entry gives now; an empty list is silence.

    Attributes:
        asked: every request so far.
    """

    def __init__(self, bus: can.BusABC, address: Address, replies: Replies) -> None:
        self.asked: list[bytes] = []
        self._bus, self._replies = bus, replies
        mode = isotp.AddressingMode
        ids: dict[str, Any] = {"txid": address.rx_id, "rxid": address.tx_id}
        if address.target is None:
            kind = mode.Normal_29bits if address.extended else mode.Normal_11bits
        else:
            kind = mode.Extended_11bits
            ids |= {"target_address": address.source, "source_address": address.target}
        self._stack = isotp.CanStack(
            bus, address=isotp.Address(kind, **ids), params={"tx_padding": 0xAA}
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._stack.start()
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(5)
        self._stack.stop()
        self._bus.shutdown()

    def _run(self) -> None:
        while not self._stop.is_set():
            request = self._stack.recv(block=True, timeout=0.02)
            if request is None:
                continue
            self.asked.append(bytes(request))
            for payload in self._replies.get(bytes(request), list)():
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
