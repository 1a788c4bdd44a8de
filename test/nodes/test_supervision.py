"""Units for systemd: they are valid, and the process keeps what they expect of it."""

import json
import os
from pathlib import Path
import shlex
import shutil
import signal
import socket
import subprocess
import sys

import pytest

from evpinn_ros import topics
from test.conftest import ROOT
from test.nodes.processes import node, started
from test.waiting import HANG_S

UNITS = ROOT / "config" / "systemd"
VEHICLE = "tesla_model_3_lr"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_finds_nothing_wrong_with_the_units(tmp_path):
    for unit in UNITS.glob("*.service"):
        shutil.copy(unit, tmp_path)
    (tmp_path / "evpinn-can@.service").rename(tmp_path / "evpinn-can@can0.service")
    for unit in ("evpinn.service", "evpinn-can@can0.service"):
        ended = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", str(tmp_path / unit)],
            env={**os.environ, "SYSTEMD_UNIT_PATH": f"{tmp_path}:"},
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 0 and "evpinn" not in ended.stderr, ended.stderr


@pytest.fixture
def systemd(tmp_path):
    """The socket that systemd listens on, and the environment that it gives."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inlet:
        inlet.bind(str(tmp_path / "notify"))
        inlet.settimeout(HANG_S)
        given = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "400000"}
        yield inlet, {**os.environ, **given}


def test_a_node_tells_that_it_is_up_that_it_works_and_that_it_ends(bench, systemd):
    inlet, environment = systemd
    with started(*node("energy"), env=environment) as process:
        assert inlet.recv(100) == b"READY=1"
        assert [inlet.recv(100) for _ in range(3)] == 3 * [b"WATCHDOG=1"]
        process.send_signal(signal.SIGTERM)
        assert last_word(inlet) == b"STOPPING=1" and process.wait(HANG_S) == 0


def last_word(inlet):
    """The next of what is said that is no sign of life."""
    return next(said for said in iter(lambda: inlet.recv(100), b"") if said != b"WATCHDOG=1")


def entry(unit, key):
    """What a unit says; of several, all in one."""
    lines = (UNITS / unit).read_text().splitlines()
    return " ".join(line.partition("=")[2] for line in lines if line.startswith(f"{key}="))


@pytest.mark.nightly
def test_what_the_unit_starts_keeps_its_promises(bench, can_log, systemd, tmp_path):
    """ExecStart as written, with what systemd and the guide's evpinn.env set, and a drive."""
    inlet, environment = systemd
    params, activate = tmp_path / "evpinn.param.yaml", tmp_path / "activate"
    log = str(can_log("urban", 360.0))
    values = {"log_file": log, "log_rate": 8.0, "log_delay": 4.0}
    params.write_text(json.dumps({"/**/can_bridge": {"ros__parameters": values}}))
    activate.write_text(f"PATH={Path(sys.executable).parent}:$PATH\n")
    assert entry("evpinn.service", "StateDirectory") == "evpinn"
    environment |= dict(
        pair.split("=", 1) for pair in entry("evpinn.service", "Environment").split()
    )
    environment |= {
        "STATE_DIRECTORY": str(tmp_path),  # of which systemd makes /var/lib/evpinn
        "VEHICLE": VEHICLE,
        "SETUP": str(activate),
        "OPTIONS": f"--params {params}",
    }
    command = shlex.split(entry("evpinn.service", "ExecStart"))
    with started(*command, cwd=tmp_path, env=environment) as process:
        assert inlet.recv(100) == b"READY=1"
        bench.listen(topics.POWER_SMOOTHED)
        bench.pump(lambda: bench.heard[topics.POWER_SMOOTHED])
        assert inlet.recv(100) == b"WATCHDOG=1"
        process.send_signal(signal.SIGTERM)  # KillMode=mixed: to the main process alone
        assert last_word(inlet) == b"STOPPING=1"
        assert process.wait(HANG_S) == 0
    state = json.loads((tmp_path / "car.json").read_text())
    learned, counted = state["learned"], state["energy"]
    assert learned["vehicle"] == counted["vehicle"] == VEHICLE


IN_A_NETWORK_OF_ITS_OWN = ("unshare", "--map-root-user", "--net", "sh", "-c")


@pytest.mark.skipif(not shutil.which("ip"), reason="no `ip` (iproute2) here")
@pytest.mark.skipif(not shutil.which("unshare"), reason="no `unshare` here")
def test_ip_understands_what_brings_the_interface_up(tmp_path):
    """The real `ip`: it tells a kernel without CAN from an option that it does not know."""
    name, code, words = shlex.split(
        entry("evpinn-can@.service", "ExecStart").replace("%i", "can9")
    )
    default = dict(pair.split("=") for pair in entry("evpinn-can@.service", "Environment").split())

    def said(line):
        make = next(f"ip link add can9 type {kind} && " for kind in KINDS if can_be_made(kind))
        ended = subprocess.run(
            [*IN_A_NETWORK_OF_ITS_OWN, f"{make} {shlex.join([name, code, line])}"],
            env=os.environ | default, capture_output=True, text=True,
        )  # fmt: skip
        return ended.stderr

    if not any(map(can_be_made, KINDS)):
        pytest.skip("no network namespace with an interface can be made here")
    assert said(words) in ("", NO_CAN)
    assert "unknown option" in said(words.replace("listen-only", "listening"))


KINDS = ("vcan", "dummy", "ifb")
NO_CAN = "RTNETLINK answers: Operation not supported\n"


def can_be_made(kind):
    make = [*IN_A_NETWORK_OF_ITS_OWN, f"ip link add can9 type {kind}"]
    return subprocess.run(make, capture_output=True).returncode == 0


@pytest.mark.skipif(not shutil.which("udevadm"), reason="no `udevadm` (udev) here")
def test_udev_finds_nothing_wrong_with_the_rule():
    rule = UNITS / "90-evpinn-can.rules"
    ended = subprocess.run(["udevadm", "verify", str(rule)], capture_output=True, text=True)
    if "Unknown command" in ended.stderr:
        pytest.skip("this udevadm cannot verify; systemd 254 can")
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_launch_files_load_without_what_the_nodes_need(loads_without):
    """`ros2` runs in the Python of ROS, which need not have our dependencies."""
    code = "from evpinn_ros import topics; from evpinn_ros.core.vehicle import files"
    loads_without(code, "can", "cantools", "torch", "scipy", "polars")
