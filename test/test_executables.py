"""A signal while Python still imports: the process ends well, at once, and says nothing."""

from pathlib import Path
import re
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.build

ROOT = Path(__file__).resolve().parents[1]
ESTIMATOR = ("-m", "evpinn_ros.executables", "estimator")
RUN = ("-m", "evpinn_ros", "run", "--vehicle", "nissan_leaf", "--can-interface", "virtual")


def hears(process: subprocess.Popen, number: signal.Signals) -> bool:
    """Whether the process has a handler of its own for a signal (Linux)."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return bool(int(re.search(r"SigCgt:\s*(\w+)", status)[1], 16) >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("command", "number", "delay"),
    [
        (ESTIMATOR, signal.SIGINT, 0.0),
        (ESTIMATOR, signal.SIGTERM, 0.3),
        (ESTIMATOR, signal.SIGINT, 0.7),
        (ESTIMATOR, signal.SIGHUP, 0.2),
        (RUN, signal.SIGTERM, 0.0),
        (RUN, signal.SIGINT, 0.2),
        (RUN, signal.SIGTERM, 1.0),
    ],
)
def test_a_signal_ends_a_process_that_still_starts(command, number, delay):
    process = subprocess.Popen(
        [sys.executable, *command], cwd=ROOT, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    try:
        while not hears(process, signal.SIGTERM):  # Python itself has none for this one
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.005)
        time.sleep(delay)
        process.send_signal(number)
        _, said = process.communicate(timeout=20)
        assert process.returncode == 0
        assert all(line.startswith(b"[INFO]") for line in said.splitlines()), said
    finally:
        process.kill()
        process.communicate()


def test_nothing_that_takes_time_is_imported_before_signals_are_heard(loads_without):
    loads_without("import evpinn_ros.executables", "numpy", "rclpy", "torch", "typer")
