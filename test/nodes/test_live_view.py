"""The live view on a real terminal (a pty) and in a pipe, of real nodes over DDS."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import fcntl
import json
import os
import re
import select
import signal
import struct
import subprocess
import sys
import termios

import pytest

from evpinn_ros import topics
from evpinn_ros.nodes.live.data import NOTHING
from test.conftest import ROOT
from test.nodes.processes import EVPINN, started, stopped
from test.waiting import HANG_S, wait_until

ALTERNATE, BACK = b"\x1b[?1049h", b"\x1b[?1049l"  # xterm: to the alternate screen and back
CTRL_C = b"\x03"


class Terminal:
    """A process with a terminal of its own, and all that it wrote."""

    def __init__(self, *command: str, **environment: str) -> None:
        self._master, slave = os.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        # Names of variables that would make rich doubt the terminal are not inherited.
        kept = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "COLUMNS", "LINES")}
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            env={**kept, "TERM": "xterm", **environment},
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(slave)
        self.written = b""

    def read_until(self, condition: Callable[[bytes], bool]) -> None:
        wait_until(lambda: condition(self.written) or not self._read(), report=self._last)
        assert condition(self.written), self._last()

    def _last(self) -> str:
        return self.written[-3000:].decode(errors="replace")

    def _read(self) -> bool:
        """Whether there may be more to read."""
        if select.select([self._master], [], [], 0.2)[0]:
            try:
                self.written += os.read(self._master, 65536)
            except OSError:  # nobody has the other end any more
                return False
        return True

    def type(self, keys: bytes) -> None:
        os.write(self._master, keys)

    def end(self) -> int:
        """The exit code, once everything was read."""
        wait_until(lambda: not self._read(), report=self._last)
        return self.process.wait(HANG_S)

    def close(self) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        os.close(self._master)


@contextmanager
def terminal(*command: str, **environment: str) -> Iterator[Terminal]:
    running = Terminal(*command, **environment)
    try:
        yield running
    finally:
        running.close()


@pytest.fixture
def drive(can_log, tmp_path) -> tuple[str, ...]:
    """The options of `evpinn run` that play two minutes of a drive as if from a bus."""
    log, params = can_log("urban", 360.0), tmp_path / "params.yaml"
    values = {"/**/can_bridge": {"ros__parameters": {"log_file": str(log), "log_rate": 3.0}}}
    params.write_text(json.dumps(values))  # which is YAML too
    return "run", "--vehicle", "tesla_model_3_lr", "--params", str(params)


def learned(written: bytes) -> bool:
    """Whether the newest whole picture has a value of eta and a rate of speed messages."""
    picture = written.rpartition(b"evpinn ")[0].rpartition(b"evpinn ")[2].decode(errors="ignore")
    row = next((line for line in picture.splitlines() if line.startswith("eta ")), "- - -")
    return "parameters" in picture and row.split()[2] != "-" and "speed 0.0/s" not in picture


def test_run_on_a_terminal_shows_parameters_and_says_in_the_end_what_was_saved(drive, tmp_path):
    bag, state = tmp_path / "my drive", tmp_path / "car.json"
    files = ("--record", str(bag), "--state", str(state))
    with terminal(*EVPINN, *drive, *files, NO_COLOR="1") as screen:
        screen.read_until(lambda written: ALTERNATE in written)
        screen.read_until(learned)
        screen.type(CTRL_C)
        assert screen.end() == 0
    before, _, shown = screen.written.partition(ALTERNATE)
    shown, _, after = shown.rpartition(BACK)
    assert before.strip() == b""
    assert b"\x1b[3" not in shown  # no colour, but a line of power
    # The terminal echoes Ctrl-C anywhere, also within a character.
    assert re.search("[⠁-⣿]", shown.decode(errors="ignore"))
    assert b"Traceback" not in after and b"decoding" in after  # what was logged comes last
    assert after.decode().splitlines()[-2:] == [
        f"evpinn: saved the drive: {bag}, what was learned: {state}",
        f"evpinn: next: evpinn replay '{bag}' --vehicle tesla_model_3_lr --report drive.html",
    ]


def test_a_mistake_is_told_on_the_terminal_and_not_on_the_view():
    with terminal(*EVPINN, "run", "--vehicle", "nope") as screen:
        assert screen.end() == 1
    said = screen.written.rpartition(BACK)[2]
    assert b"no vehicle named 'nope'" in said and b"Traceback" not in screen.written


ENDED_AT_ITS_START = """
import os, signal
import rclpy
from evpinn_ros.nodes.live import view
from waiting import wait_until

class Ended(view.LiveListener):
    def __init__(self, *arguments):
        os.kill(os.getpid(), signal.SIGTERM)
        wait_until(lambda: not rclpy.ok())
        super().__init__(*arguments)

view.LiveListener = Ended
view.watch(plain=True)
"""


def test_a_view_that_is_ended_while_it_begins_ends_quietly():
    path = os.pathsep.join((str(ROOT), str(ROOT / "test")))
    ended = subprocess.run(
        [sys.executable, "-c", ENDED_AT_ITS_START],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, timeout=HANG_S,
    )  # fmt: skip
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_watch_in_a_pipe_gives_a_line_a_second_until_stopped(bench, urban):
    with started(*EVPINN, "watch", env={**os.environ, "FORCE_COLOR": "1"}) as running:
        assert "nothing received yet" in running.stdout.readline()
        messages = [message for topic, _, message in urban(1.0) if topic == topics.SPEED]
        bench.publisher(topics.SPEED)
        line = ""
        while "- km/h" in line or "km/h" not in line:
            bench.send(topics.SPEED, messages[0])
            line = running.stdout.readline()
        speed = messages[0].twist.twist.linear.x
        assert line.startswith(f"{3.6 * speed:.1f} km/h; charge  -  range")
        (line,) = stopped(running)[1].splitlines()
        assert "saved nothing" in line and "evpinn run --record FOLDER --state FILE" in line


def test_watch_without_nodes_says_so_in_a_pipe():
    environment = {**os.environ, "ROS_DOMAIN_ID": "85"}  # where no test of ours has nodes
    with started(*EVPINN, "watch", "--json", "-", env=environment) as running:
        assert NOTHING in running.stdout.readline()
        running.send_signal(signal.SIGINT)
        assert running.communicate(timeout=HANG_S)[1] == f"evpinn: {NOTHING}\n"
