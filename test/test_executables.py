"""A signal while Python still imports: the process ends well, at once, and says nothing."""

from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest

from test.waiting import HANG_S, wait_until

pytestmark = pytest.mark.build

ROOT = Path(__file__).resolve().parents[1]
ESTIMATOR = ("-m", "evpinn_ros.executables", "estimator")
RUN = ("-m", "evpinn_ros", "run", "--vehicle", "nissan_leaf", "--can-interface", "virtual")


def hears(process: subprocess.Popen, number: signal.Signals) -> bool:
    """Whether the process has a handler of its own for a signal (Linux)."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return bool(int(re.search(r"SigCgt:\s*(\w+)", status)[1], 16) >> (number - 1) & 1)


@pytest.mark.parametrize(
    ("command", "number", "library"),
    [
        (ESTIMATOR, signal.SIGINT, ""),
        (ESTIMATOR, signal.SIGTERM, "_rclpy_pybind11"),
        (ESTIMATOR, signal.SIGINT, "_multiarray_umath"),
        (ESTIMATOR, signal.SIGHUP, "typesupport_introspection"),
        (RUN, signal.SIGTERM, ""),
        (RUN, signal.SIGINT, "_umath_linalg"),
        (RUN, signal.SIGTERM, "libfastdds"),
    ],
)
def test_a_signal_ends_a_process_that_still_starts(command, number, library):
    """As soon as it hears signals, and where it has just loaded some library."""
    process = subprocess.Popen(
        [sys.executable, *command], cwd=ROOT, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    try:
        maps = Path(f"/proc/{process.pid}/maps")
        # Python itself has no handler for this one.
        wait_until(lambda: hears(process, signal.SIGTERM) and library in maps.read_text())
        process.send_signal(number)
        _, said = process.communicate(timeout=HANG_S)
        assert process.returncode == 0
        assert all(line.startswith(b"[INFO]") for line in said.splitlines()), said
    finally:
        process.kill()
        process.communicate()


def test_nothing_that_takes_time_is_imported_before_signals_are_heard(loads_without):
    loads_without("import evpinn_ros.executables", "numpy", "rclpy", "torch", "typer")


@pytest.mark.parametrize("megabytes", [200, 500, 1400])
@pytest.mark.parametrize("command", [RUN, ("-m", "evpinn_ros", "info", "bags/urban"), ESTIMATOR])
def test_too_little_address_space_is_one_line(command, megabytes):
    """Polars and BLAS abort in the middle of an import, or end in a NameError."""
    limited = ["bash", "-c", f'ulimit -v {megabytes}000; exec "$@"', "", sys.executable, *command]
    ended = subprocess.run(limited, cwd=ROOT, capture_output=True, text=True, timeout=HANG_S)
    assert ended.returncode == 1 and ended.stdout == ""
    assert re.fullmatch(r"evpinn: \d+ MB of address space .* reserve 1500 MB\n", ended.stderr)
