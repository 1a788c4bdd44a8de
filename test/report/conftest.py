"""A real browser, driven over its debugging pipe, and a live view that has heard everything."""

import base64
from collections import Counter
from collections.abc import Callable, Iterator
import json
import os
from pathlib import Path
import select
import shutil
import subprocess
import time
from typing import Any

import pytest

from evpinn_ros import topics
from evpinn_ros.bags.types import new_message
from evpinn_ros.drives.sources import Source
from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.live.state import LiveState
from evpinn_ros.replays import history
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.run import ReplayOptions, replay
from evpinn_ros.report.drive_page import ReportedDrive
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.topics import Topic
from evpinn_ros.topics.messages import Level, diagnostics, named_vector
from evpinn_ros.topics.readings import battery_message, speed_message
from evpinn_ros.vehicle.files import load_vehicle
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
PATIENCE = 60.0  # s for an answer: other tests run beside this one


class Browser:
    """One page of a headless Chromium.

    Attributes:
        troubles: errors and warnings of the console, exceptions, policy violations.
        requests: every address it asked for.
    """

    def __init__(self, profile: Path) -> None:
        self.troubles: list[str] = []
        self.requests: list[str] = []
        self._number, self._buffer, self._session = 0, b"", None
        commands, self._to = os.pipe()
        self._from, answers = os.pipe()
        # The pipe is where Chromium wants it: commands on 3, answers on 4.
        script = f'exec "$0" "$@" 3<&{commands} 4>&{answers}'
        options = ("--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe")
        quiet = ("--disable-dev-shm-usage", "--no-first-run", f"--user-data-dir={profile}")
        self._process = subprocess.Popen(
            ["bash", "-c", script, CHROMIUM, *options, *quiet, "about:blank"],
            pass_fds=(commands, answers),
            stderr=subprocess.DEVNULL,
        )
        os.close(commands)
        os.close(answers)
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def open(self, page: Path, *, width: int, height: int = 900, dark: bool = False) -> None:
        """Load a file at a width in CSS pixels, and wait until it is drawn."""
        narrow = width < 600
        self.troubles.clear()
        self.requests.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=narrow,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=page.as_uri())
        self.wait_for("document.readyState === 'complete'")
        self.run("new Promise(done => requestAnimationFrame(() => setTimeout(done, 100)))")

    def run(self, expression: str) -> Any:
        """The value of an expression in the page, awaited."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, expression: str) -> None:
        end = time.monotonic() + PATIENCE
        while not self.run(expression):
            assert time.monotonic() < end, expression
            time.sleep(0.05)

    def drag(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the mouse, move, let go."""
        for kind, (x, y) in (
            ("mouseMoved", begin),
            ("mousePressed", begin),
            ("mouseMoved", end),
            ("mouseReleased", end),
        ):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def picture(self, to: Path) -> None:
        """The whole page as PNG."""
        found = self.call("Page.captureScreenshot", captureBeyondViewport=True)
        to.write_bytes(base64.b64decode(found["data"]))

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command of the DevTools protocol."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]
            self._note(answer.get("method"), answer.get("params", {}))

    def _receive(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._from], [], [], max(0.0, end - time.monotonic()))
            assert ready, "the browser does not answer"
            chunk = os.read(self._from, 1 << 20)
            assert chunk, "the browser is gone"
            self._buffer += chunk
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, method: str | None, found: dict[str, Any]) -> None:
        if method == "Runtime.consoleAPICalled" and found["type"] in ("error", "warning"):
            self.troubles.append(str(found["args"]))
        elif method == "Runtime.exceptionThrown":
            self.troubles.append(str(found["exceptionDetails"]))
        elif method == "Log.entryAdded":
            self.troubles.append(found["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(found["request"]["url"])

    def close(self) -> None:
        os.close(self._to)
        os.close(self._from)
        self._process.terminate()
        self._process.wait(30)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium here: apt-get install chromium runs the tests in a browser")
    found = Browser(tmp_path_factory.mktemp("profile"))
    yield found
    found.close()


@pytest.fixture(scope="session")
def reported() -> ReportedDrive:
    """Two minutes and a half in town, the battery silent for 8 s and the speed for 5 s."""
    car = load_vehicle("tesla_model_3_lr")
    drive = simulate(DriveKind.URBAN, car, 150.0, seed=11)
    start = drive.readings[0].stamp_ns
    silent = {BatteryReading: (40.0, 48.0), SpeedReading: (30.0, 35.0)}
    heard = []
    for reading in drive.readings:
        begin, end = silent.get(type(reading), (0.0, 0.0))
        if not begin < (reading.stamp_ns - start) / NANOSECONDS < end:
            heard.append(reading)
    chain = Chain(car, EstimatorSettings(), InlineWorker(time.perf_counter))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history, "MODEL_STEP", 60.0)
        replayed = replay(
            Recorded(heard), chain, ReplayOptions(warm_up=30.0), vehicle=car.key, mode="hybrid"
        )
    return ReportedDrive(replayed.drive, replayed.metrics, car, 30.0, truth=drive.truth.parameters)


class Recorded(Source):
    """Readings in memory, as a source."""

    problem = seconds = None

    def __init__(self, readings: list[Reading]) -> None:
        self.path, self._readings = Path("out/town"), readings
        self.dropped: Counter[str] = Counter()

    def readings(self) -> Iterator[Reading]:
        yield from self._readings


VALUES = (0.912, 0.64, 1847.0, 0.0092, 0.2312, 412.0)
ESTIMATE = {
    "state.eta": "valid",
    "progress.eta": 87,
    "seen.0_30_kmh_braking": 12,
    "seen.over_120_kmh_steady": 3400,
    "in_90_band.predicted": 0.893,
}


PARTS = [  # J and 1-sigma
    ("air", 0.72e6, 0.108e6),
    ("tyres", 1.44e6, 0.18e6),
    ("slope", -0.108e6, 0.036e6),
    ("climate", 0.0, 0.0),
    ("drivetrain", 0.648e6, 0.072e6),
    ("unexplained", 0.018e6, 0.036e6),
    ("measured", 3.96e6, 0.0),
    ("regained", 0.9e6, 0.1e6),
]


def vector(stamp_ns: int, **values: float) -> Any:
    return named_vector(new_message, stamp_ns, list(values), list(values.values()))


def heard(now: float) -> list[tuple[Topic, Any]]:
    """What a running system says in one moment."""
    stamp = int(now * NANOSECONDS)
    sigmas = [value / 20 for value in VALUES]
    bounds = {f"{name}_lower": 0.5 * v for name, v in zip(PARAMETER_NAMES, VALUES, strict=True)}
    bounds |= {f"{name}_upper": 2.0 * v for name, v in zip(PARAMETER_NAMES, VALUES, strict=True)}
    bounds |= {f"{name}_prior_share": 0.25 for name in PARAMETER_NAMES}
    said = [("/ev/estimator: estimate", Level.OK, "learning: 3 of 4 updates accepted", ESTIMATE)]
    return [
        (topics.SPEED, speed_message(new_message, SpeedReading(stamp, 12.5))),
        (topics.BATTERY, battery_message(new_message, BatteryReading(stamp, 352.0, -41.5))),
        (
            topics.PARAMETERS,
            named_vector(new_message, stamp, PARAMETER_NAMES, VALUES, sigmas),
        ),
        (topics.BOUNDS, vector(stamp, **bounds)),
        (topics.POWER_MEASURED, vector(stamp, power=14600.0)),
        (
            topics.POWER_PREDICTED,
            named_vector(new_message, stamp, ["power"], [13900.0], [1200.0]),
        ),
        (topics.ENERGY_STATE, vector(stamp, predicted=3.6e6, consumed=3.96e6)),
        (topics.ENERGY_BREAKDOWN, named_vector(new_message, stamp, *zip(*PARTS, strict=True))),
        (topics.ENERGY_CONSUMPTION, vector(stamp, wh_per_km_trip=163.0)),
        (
            topics.ENERGY_RANGE,
            vector(
                stamp,
                distance_to_empty=2.45e5,
                distance_lower=2.1e5,
                distance_upper=2.9e5,
                state_of_charge=0.614,
            ),
        ),
        (topics.DIAGNOSTICS, diagnostics(new_message, stamp, said)),
    ]


@pytest.fixture
def well() -> Callable[[float], LiveState]:
    """A state that heard everything ten times a second from second 100 to this one."""

    def make(until: float) -> LiveState:
        state = LiveState()
        for tenth in range(1000, int(10 * until) + 1):
            for topic, message in heard(tenth / 10):
                state.take(topic, message, tenth / 10)
        return state

    return make
