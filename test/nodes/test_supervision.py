"""Units for systemd: they are valid, and the process keeps what they expect of it."""

import os
from pathlib import Path
import shutil
import signal
import socket
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNITS = ROOT / "config" / "systemd"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_finds_nothing_wrong_with_the_units(tmp_path):
    for unit in UNITS.glob("*.service"):
        shutil.copy(unit, tmp_path)
    (tmp_path / "evpinn-can@.service").rename(tmp_path / "evpinn-can@can0.service")
    for unit in ("evpinn.service", "evpinn-can@can0.service"):
        done = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", str(tmp_path / unit)],
            env={**os.environ, "SYSTEMD_UNIT_PATH": f"{tmp_path}:"},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0 and "evpinn" not in done.stderr, done.stderr


@pytest.fixture
def systemd(tmp_path):
    """The socket that systemd listens on, and the environment that it gives."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inlet:
        inlet.bind(str(tmp_path / "notify"))
        inlet.settimeout(60.0)
        given = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "400000"}
        yield inlet, {**os.environ, **given}


def test_a_node_tells_that_it_is_up_that_it_works_and_that_it_ends(bench, systemd):
    inlet, environment = systemd
    command = ("-m", "evpinn_ros.executables", "energy", "--ros-args", "-r", "__ns:=/ev")
    process = subprocess.Popen([sys.executable, *command], cwd=ROOT, env=environment)
    try:
        assert inlet.recv(100) == b"READY=1"
        assert [inlet.recv(100) for _ in range(3)] == 3 * [b"WATCHDOG=1"]
        process.send_signal(signal.SIGTERM)
        while (heard := inlet.recv(100)) == b"WATCHDOG=1":
            pass
        assert heard == b"STOPPING=1" and process.wait(20) == 0
    finally:
        process.kill()
        process.wait()


def test_a_process_that_hangs_says_nothing_more(bench, systemd):
    inlet, environment = systemd
    command = ("-m", "evpinn_ros.executables", "energy", "--ros-args", "-r", "__ns:=/ev")
    process = subprocess.Popen([sys.executable, *command], cwd=ROOT, env=environment)
    try:
        while inlet.recv(100) != b"WATCHDOG=1":
            pass
        process.send_signal(signal.SIGSTOP)
        inlet.settimeout(1.0)
        with pytest.raises(TimeoutError):
            while inlet.recv(100):
                pass
    finally:
        process.kill()
        process.wait()


def test_launch_files_load_without_what_the_nodes_need(loads_without):
    """`ros2` runs in the Python of ROS, which need not have our dependencies."""
    code = "from evpinn_ros.nodes import topics; from evpinn_ros.vehicle import files"
    loads_without(code, "can", "cantools", "torch", "scipy", "polars")
