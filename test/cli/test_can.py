"""`evpinn can inspect` on logs and on a live bus, and commands that meet a wrong profile."""

import itertools
import json
import os
from pathlib import Path
import pty
import signal
import subprocess
import sys
import time
import tty
from types import SimpleNamespace

import can
import pytest
from typer.testing import CliRunner

from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.inspection import Inspection
from evpinn_ros.can.logs import LogFile, write_log
from evpinn_ros.can.profile import load_profile
from evpinn_ros.cli import can as can_command
from evpinn_ros.cli.main import app
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.waiting import wait_until

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "80", "OMP_NUM_THREADS": "1"}
GROUP = "239.74.163.91"
CONFIG = share_directory() / "config" / "can"


def frames(profile, seconds=12.0):
    encoder = Encoder(load_profile(profile))
    for index in range(int(100 * seconds)):
        stamp = index * 10_000_000
        yield encoder.battery(BatteryReading(stamp, 380.0 - index % 7, -10.0 - index % 30))
        if index % 2:
            yield encoder.speed(SpeedReading(stamp, 10.0 + index % 50 / 100))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("can")
    for profile in ("tesla_model_3", "tesla_model_3_2019"):
        write_log(folder / f"{profile}.log", frames(profile))
    return folder


def test_a_log_for_scripts(evpinn, folder):
    ended = evpinn(
        "can", "inspect", "tesla_model_3.log", "--json", "-", "--seconds", 2, cwd=folder
    )
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert document["best"] == "tesla_model_3" == document["profiles"][0]["profile"]
    assert (
        document["frames"] == 301
        and document["duration_s"] == 2.0
        and document["bitrate"] == 500_000
    )
    battery, speed = document["ids"]
    assert (battery["id"], battery["lengths"]) == ("0x132", {"8": 201})
    assert speed["rate_hz"] == pytest.approx(50.0)
    assert 0.0 < document["bus_load"]["least"] < document["bus_load"]["most"] < 0.1
    first = document["profiles"][0]
    assert first["verdict"] == "fits" and first["proven"]
    assert first["values"]["voltage"]["highest"] == pytest.approx(380.0)
    assert first["current_sign"] == {"told": False, "suspicion": None}


def test_a_profile_of_ones_own_is_ranked(evpinn, folder):
    for suffix in (".yaml", ".dbc"):
        text = (CONFIG / f"tesla_model_3{suffix}").read_bytes()
        (folder / f"my_car{suffix}").write_bytes(text)
    own = (folder / "my_car.yaml").read_text().replace("tesla_model_3.dbc", "my_car.dbc")
    (folder / "my_car.yaml").write_text(own)
    ended = evpinn(
        *("can", "inspect", "tesla_model_3.log", "--json", "-", "--can-profile", "my_car.yaml"),
        cwd=folder,
    )
    profiles = json.loads(ended.stdout)["profiles"]
    assert {"my_car", "tesla_model_3"} == {profile["profile"] for profile in profiles[:2]}


def test_a_damaged_log_shows_what_it_holds_and_fails(evpinn, folder):
    whole = (folder / "tesla_model_3.log").read_text()
    (folder / "cut.log").write_text(whole[: len(whole) // 2])
    ended = evpinn("can", "inspect", "cut.log", cwd=folder)
    assert ended.returncode == 1
    assert "Fits: tesla_model_3" in ended.stdout and "cut.log: cut off" in ended.stderr


def test_a_live_bus(folder, monkeypatch):
    """Time goes on with each frame that has come: a hundredth of a second."""
    port = 20_000 + (os.getpid() + 1) % 20_000
    options = ("--interface", "udp_multicast", "--channel", GROUP)
    more = ("--bus-options", f"port={port} hop_limit=0")
    try:
        bus = can.Bus(GROUP, interface="udp_multicast", port=port, hop_limit=0)
    except (OSError, can.CanError) as error:
        pytest.skip(f"no multicast here: {error}")
    frames, taken = itertools.cycle(LogFile(folder / "tesla_model_3.log").frames()), []
    add_frame = Inspection.add_frame
    monkeypatch.setattr(
        Inspection, "add_frame", lambda self, frame: add_frame(self, frame) or taken.append(frame)
    )

    def send(seconds):
        for _ in range(round(100 * seconds)):
            frame, before = next(frames), len(taken)
            bus.send(
                can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)
            )
            wait_until(lambda n=before: len(taken) > n)

    clock = SimpleNamespace(monotonic=lambda: len(taken) / 100, sleep=send, time_ns=time.time_ns)
    monkeypatch.setattr(can_command, "time", clock)
    with bus:
        command = ["can", "inspect", *options, *more, "--seconds", "4", "--json", "-"]
        ended = CliRunner().invoke(app, command)
    assert ended.exit_code == 0, ended.output
    document = json.loads(ended.stdout)
    assert document["best"] == "tesla_model_3" and document["frames"] == 400
    assert document["source"] == f"udp_multicast {GROUP}"


def heard_by_adapter(*options, cwd):
    """What `evpinn run` tells a serial adapter before it reads."""
    own, channel = pty.openpty()
    tty.setraw(channel)
    command = [sys.executable, "-m", "evpinn_ros", "run", "--vehicle", "nissan_leaf"]
    bus = ["--can-interface", "slcan", "--can-channel", os.ttyname(channel)]
    heard = b""
    with subprocess.Popen([*command, *bus, *options], cwd=cwd, env=ENVIRONMENT) as process:
        try:
            while not heard.rstrip(b"\r").endswith((b"O", b"L")):
                heard += os.read(own, 100)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)
            os.close(own)
            os.close(channel)
    return heard.replace(b"\r", b" ").split()[:3]


def test_run_hands_options_to_the_adapter(folder):
    options = ("--bitrate", "250000", "--bus-options", "listen_only=true sleep_after_open=0.05")
    assert heard_by_adapter(*options, cwd=folder) == [b"C", b"S5", b"L"]


@pytest.mark.parametrize("command", [("convert",), ("replay", "--out")])
def test_a_wrong_profile_is_refused_by_name(evpinn, folder, command):
    name, *out = command
    arguments = (name, "tesla_model_3_2019.log", *out, "refused", "--can-profile", "tesla_model_3")
    ended = evpinn(*arguments, cwd=folder)
    assert ended.returncode == 1
    (line,) = ended.stderr.strip().splitlines()
    assert "tesla_model_3_2019.log: profile 'tesla_model_3' contradicts the traffic" in line
    assert "'tesla_model_3_2019' fits better; use --can-profile tesla_model_3_2019, or" in line
    assert not (folder / "refused").exists() or name == "replay"


def test_a_wrong_profile_can_be_insisted_on(evpinn, folder):
    ended = evpinn(
        *("convert", "tesla_model_3_2019.log", "trusted", "--can-profile", "tesla_model_3"),
        "--trust-profile",
        cwd=folder,
    )
    assert ended.returncode == 0, ended.stderr
    assert "out_of_range" in ended.stderr


def test_check_params_checks_the_profile_of_a_vehicle_file_too(evpinn, tmp_path):
    text = (CONFIG.parent / "vehicles" / "nissan_leaf.yaml").read_text()
    assert "can_profile: nissan_leaf" in text
    own = text.replace("can_profile: nissan_leaf", "can_profile: nowhere.yaml")
    (tmp_path / "car.yaml").write_text(own)
    ended = evpinn("check-params", tmp_path / "car.yaml", cwd=CONFIG)
    assert ended.returncode == 1 and f"{tmp_path / 'nowhere.yaml'}: No such file" in ended.stderr
