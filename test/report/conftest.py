"""A real browser, driven over its debugging pipe, and a drive to report."""

import base64
from collections.abc import Iterator
import json
import os
from pathlib import Path
import select
import shutil
import subprocess
import time
from typing import Any

import pytest

from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays import history
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.run import ReplayOptions, replay
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from evpinn_ros.report.drive_page import ReportedDrive
from test.recorded import Recorded
from test.waiting import wait_until

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
        self.settle()

    def settle(self) -> None:
        """Wait until what came before is drawn: whoever draws asks for a frame or two."""
        for _ in range(4):
            self.run("new Promise(requestAnimationFrame)")

    def run(self, expression: str) -> Any:
        """The value of an expression in the page, awaited."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, expression: str) -> None:
        wait_until(lambda: self.run(expression), report=lambda: expression)

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
        answer = self.call("Page.captureScreenshot", captureBeyondViewport=True)
        to.write_bytes(base64.b64decode(answer["data"]))

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

    def _note(self, method: str | None, event: dict[str, Any]) -> None:
        if method == "Runtime.consoleAPICalled" and event["type"] in ("error", "warning"):
            self.troubles.append(str(event["args"]))
        elif method == "Runtime.exceptionThrown":
            self.troubles.append(str(event["exceptionDetails"]))
        elif method == "Log.entryAdded":
            self.troubles.append(event["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(event["request"]["url"])

    def close(self) -> None:
        os.close(self._to)
        os.close(self._from)
        self._process.terminate()
        self._process.wait()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium here: apt-get install chromium runs the tests in a browser")
    chromium = Browser(tmp_path_factory.mktemp("profile"))
    yield chromium
    chromium.close()


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
            Recorded(heard, Path("out/town")),
            chain,
            ReplayOptions(warm_up=30.0),
            vehicle=car.key,
            mode="hybrid",
        )
    return ReportedDrive(replayed.drive, replayed.metrics, car, 30.0, truth=drive.truth.parameters)
