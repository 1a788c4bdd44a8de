"""An ELM327 as a bus: against ELM327-emulator, and an adapter whose lines are told here."""

from contextlib import contextmanager
import math
import os
from pathlib import Path
import pty
import select
import socket
import subprocess
import sys
import threading
import time
import tty

import can
import pytest

from evpinn_ros.can import elm327 as elm327_module
from evpinn_ros.can.bus import BusReader
from evpinn_ros.can.elm327 import Elm327Bus
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import LiveBridge, running
from test.waiting import HANG_S, wait_until

pytest.importorskip("elm", reason="ELM327-emulator is not installed")
EMULATOR = Path(__file__).with_name("elm327_emulator.py")
KONA, I3 = load_profile("hyundai_kia"), load_profile("bmw_i3")


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Adapters may take their time, as on a busy computer."""
    monkeypatch.setattr(elm327_module, "RESET_S", HANG_S)
    monkeypatch.setattr(elm327_module, "ANSWER_S", HANG_S)


@contextmanager
def emulated(kind, folder, tcp=False):
    """The place of an emulated adapter."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = [str(free.getsockname()[1])] if tcp else []
    process = subprocess.Popen(
        [sys.executable, EMULATOR, kind, *port],
        cwd=folder,  # it leaves a log
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        said = next(line for line in process.stdout if line.startswith("at "))
        threading.Thread(target=process.stdout.read, daemon=True).start()
        yield said.removeprefix("at ").strip()
    finally:
        process.kill()
        process.wait()


def elm327(place, profile=KONA, clock_s=time.time):
    """A bridge behind an adapter, which asks."""
    broadcast = {message.key[0] for message in profile.messages.values()}
    options = {"requests": profile.requests, "broadcast": broadcast, "clock_s": clock_s}
    return LiveBridge("elm327", place, profile, **options)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "tcp"), [("good", False), ("good", True), ("lossy", False)])
def test_a_car_is_asked_through_an_adapter(tmp_path, kind, tcp):
    before_ns = time.time_ns()
    with emulated(kind, tmp_path, tcp) as place, elm327(place) as live:
        wait_until(lambda: len(live.of(BatteryReading)) > 3 and len(live.of(SpeedReading)) > 3)
    for reading in live.of(BatteryReading):
        assert (reading.voltage, reading.current) == (pytest.approx(404.7), pytest.approx(12.3))
        assert reading.state_of_charge == pytest.approx(0.64)
        assert before_ns < reading.stamp_ns < time.time_ns()
    for reading in live.of(SpeedReading):
        assert reading.speed == pytest.approx(88 / 3.6)
    counters = live.counters
    assert counters["answered"] <= counters["asked"]


@pytest.mark.slow
def test_a_lying_adapter_adds_nothing(tmp_path):
    with emulated("lying", tmp_path) as place, elm327(place) as live:
        wait_until(lambda: len(live.of(BatteryReading)) > 3 and len(live.of(SpeedReading)) > 3)
        status = live.reader.status()
    assert {round(reading.voltage, 1) for reading in live.of(BatteryReading)} == {404.7}
    assert {round(reading.speed * 3.6) for reading in live.of(SpeedReading)} == {88}
    assert status.counters["garbled"] and status.counters["error_frames"]


class Adapter:
    """An adapter on a pty that says what it is told to, and keeps what it hears.

    Its ids and data are not made by the code under test. `now_s` is the time of the epoch, which
    passes with its answers, `delay` s for each.
    """

    def __init__(self, answers, banner=b"ELM327 v1.5", delay=0.0):
        self.now_s, self._delay = 1.7e9, delay
        self.heard, self.answers = [], {"ATZ": banner, **answers}
        self._own, port = pty.openpty()
        tty.setraw(port)
        self.place, self._port = os.ttyname(port), port
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self):
        rest = b""
        while not self._ends.is_set():
            if not select.select([self._own], [], [], 0.05)[0]:
                continue
            got = os.read(self._own, 100)
            if got == b" ":  # ends monitoring
                self.heard.append(" ")
                self.say(b"STOPPED\r\r>")
                continue
            *lines, rest = (rest + got).split(b"\r")
            for line in lines:
                word = line.decode().strip()
                self.heard.append(word)
                answer = self.answers.get(word, b"OK")
                self.now_s += self._delay
                if answer is not None:
                    self.say(answer + (b"" if word == "ATMA" else b"\r\r>"))

    def say(self, text):
        os.write(self._own, text)

    def close(self):
        self._ends.set()
        self._thread.join()
        os.close(self._own)
        os.close(self._port)


@pytest.fixture
def adapter(monkeypatch):
    monkeypatch.setattr(elm327_module, "WAKE_S", HANG_S)
    made = []

    def make(answers=None, **kwargs):
        made.append(Adapter(answers or {}, **kwargs))
        return made[-1]

    yield make
    for made_adapter in made:
        made_adapter.close()


def test_broadcast_frames_are_monitored_and_nothing_is_sent(adapter):
    """Frames of a Leaf's bus, `candump` of the shared captures: battery and speed."""
    frames = b"1DB0037EA4A4F0055F7\r28400000000123456FF\r" * 3  # without spaces, as after ATS0
    leaf = adapter({"ATMA": frames})
    seen = []
    reader = BusReader("elm327", leaf.place, seen.append, time.time_ns, broadcast={0x1DB, 0x284})
    with running(reader):
        wait_until(lambda: len(seen) == 6)
    assert (seen[0].can_id, seen[0].data.hex()) == (0x1DB, "0037ea4a4f0055f7")
    assert (seen[1].can_id, seen[1].data.hex()) == (0x284, "00000000123456ff")
    # 001 1101 1011 and 010 1000 0100 have these bits in common: 1.. .0.. 1.0. ....
    assert leaf.heard.index("ATCF080") < leaf.heard.index("ATCM4A0") < leaf.heard.index("ATMA")
    assert {word[:2] for word in leaf.heard if word.strip()} == {"AT"}


def test_monitoring_stops_for_a_question_and_goes_on(adapter):
    bolt = load_profile("chevrolet_bolt")
    car = adapter({"ATMA": b"", "222885": b"7E90562288593A0", "222414": b"7E905622414001F"})
    with elm327(car.place, bolt) as live:
        wait_until(lambda: live.of(BatteryReading))
        wait_until(lambda: car.heard[-1] == "ATMA")
    reading = live.of(BatteryReading)[0]
    assert (reading.voltage, reading.current) == (pytest.approx(377.92), pytest.approx(-1.55))
    assert " " in car.heard and "ATSH7E1" in car.heard and "ATCRA7E9" in car.heard


def test_voltage_and_current_behind_a_slow_adapter_keep_their_own_stamps(adapter):
    """A second from one to the other: no power of one moment, and nothing is thrown away."""
    answers = {"22D107": b"660F10562D107012C", "22DD68": b"607F10562DD689088"}
    answers["22DD69"] = b"607F1100762DD690000\r607F12103E8"
    car = adapter(answers, delay=0.25)
    with elm327(car.place, I3, lambda: car.now_s) as live:
        wait_until(lambda: len(live.of(BatteryReading)) > 5 and live.of(SpeedReading))
        counters = live.counters
    assert live.of(SpeedReading)[0].speed == pytest.approx(30.0 / 3.6)
    volts = [r for r in live.of(BatteryReading) if not math.isnan(r.voltage)]
    amps = [r for r in live.of(BatteryReading) if not math.isnan(r.current)]
    assert {r.voltage for r in volts} == {370.0} and {r.current for r in amps} == {
        10.0
    }  # charging
    assert {r.stamp_ns for r in volts}.isdisjoint(r.stamp_ns for r in amps)
    stamps = [reading.stamp_ns for reading in live.of(BatteryReading)]
    assert stamps == sorted(stamps) and counters["answered"] >= len(stamps)
    # Of its extended addresses:
    for word in ("ATSH6F1", "ATCEA60", "ATCEA07", "ATCRA607", "ATFCSD07300000", "ATFCSM1"):
        assert word in car.heard


def test_only_the_questions_of_the_profile_leave(adapter):
    car = adapter()
    made = Elm327Bus(car.place, requests=KONA.requests, broadcast=())
    for can_id, data in [
        (0x7E4, "0322f19000000000"),  # reads something else
        (0x7E4, "0211010000000000"),  # resets
        (0x7E0, "0322010100000000"),  # another control unit
        (0x123, "0000000000000000"),
    ]:
        message = can.Message(
            arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False
        )
        with pytest.raises(PermissionError):
            made.send(message)
    pack, drive = (
        can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False)
        for can_id, data in [(0x7E4, "0322010100000000"), (0x7B3, "0322010000000000")]
    )
    for question in (pack, pack, pack, drive):  # one that waits is not asked again
        made.send(question)
    wait_until(lambda: "220100" in car.heard, meanwhile=lambda: made.recv(0.01))
    made.shutdown()
    assert [word for word in car.heard if word.startswith("22")] == ["220101", "220100"]


@pytest.mark.timeout(30)
@pytest.mark.parametrize("unanswered", ["", "ATZ", "ATE0"])
def test_an_adapter_without_a_prompt_delays_no_stop(adapter, monkeypatch, unanswered):
    for patience in ("WAKE_S", "RESET_S", "ANSWER_S"):
        monkeypatch.setattr(elm327_module, patience, math.inf)
    car = adapter({unanswered: None})
    reader = BusReader("elm327", car.place, lambda _frame: None, time.time_ns)
    with running(reader):
        wait_until(lambda: unanswered in car.heard)
    assert reader.status().counters == {}  # it was never opened


def test_an_adapter_that_begins_anew_is_prepared_anew(adapter):
    car = adapter({"ATMA": b""})
    reader = BusReader("elm327", car.place, lambda _frame: None, time.time_ns)
    with running(reader):
        wait_until(lambda: "ATMA" in car.heard)
        car.say(b"\r\rELM327 v1.5\r\r>")
        wait_until(lambda: car.heard.count("ATH1") == 2)
        assert "restarted" in reader.status().problem
