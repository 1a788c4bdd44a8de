"""The end of a process that runs nodes: nothing may keep it once all is saved."""

import json
import signal
import subprocess
import sys

from test.nodes.processes import await_line, started
from test.waiting import HANG_S

NODE = """
import ctypes, sys
from functools import partial
from evpinn_ros.nodes import running
from evpinn_ros.nodes.energy import EnergyNode

def hang():
    # In C and with the interpreter held, as a middleware that waits for a lock of its own.
    lock, lib = ctypes.create_string_buffer(64), ctypes.PyDLL(None)
    lib.pthread_mutex_lock(lock)
    lib.pthread_mutex_lock(lock)

class Node(EnergyNode):
    def close(self):
        problem = super().close()
        print("closed", flush=True)
        return problem
{methods}
{settings}
arguments = ["--ros-args", "-r", "__ns:=/ev", "-p", "energy_file:=" + sys.argv[1]]
raise SystemExit(running.run(Node, args=arguments))
"""
HANGS_AT_THE_END = """
    def destroy_node(self):
        hang()
"""
HANGS_AT_THE_START = """
    def advertise(self, *topics):
        hang()
"""
TAKES_LONG = """
    def destroy_node(self):
        for line in sys.stdin:
            running.ONE_WISH = float(line)
            print("still here", flush=True)
"""
SHUTS_DOWN = """
    def __init__(self, **options):
        super().__init__(**options)
        # As rclpy's thread does at a signal.
        self.every(0.2, lambda: self.context.handle.shutdown())
"""
EXECUTOR = """
import weakref
from rclpy.signals import get_current_signal_handlers_options
make = running.new_executor
def executor():
    made = make()
    option = get_current_signal_handlers_options
    weakref.finalize(made, lambda: print("executor ends;", option().name, flush=True))
    return made
running.new_executor = executor
"""


def one_node(methods, settings, path):
    """A process of one node."""
    code = NODE.format(methods=methods, settings=settings)
    return started(sys.executable, "-c", code, path, stdin=subprocess.PIPE)


def test_a_middleware_that_hangs_cannot_keep_a_process_that_has_saved(bench, tmp_path):
    path = tmp_path / "car.json"
    settings = "running.FAREWELL, running.ONE_WISH = 1.0, float('inf')"
    with one_node(HANGS_AT_THE_END, settings, path) as process:
        await_line(process, "waiting for power/smoothed")
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=HANG_S)
        assert process.returncode == 1 and "Timeout" in said
        assert "in hang" in said and "in destroy_node" in said  # where it hung
    assert json.loads(path.read_text())["energy"]["vehicle"] == "generic"


def test_a_start_that_hangs_ends_and_says_where(tmp_path):
    said, seconds = "", 1.0
    while "in advertise" not in said:  # on a busy computer it takes longer to get there
        settings, seconds = f"running.START = {seconds}", 4.0 * seconds
        with one_node(HANGS_AT_THE_START, settings, tmp_path / "car.json") as process:
            _, said = process.communicate(timeout=HANG_S)
            assert process.returncode == 1 and "Timeout" in said


def test_a_later_signal_ends_at_once_what_has_saved(bench, tmp_path):
    path = tmp_path / "car.json"
    settings = "running.FAREWELL, running.ONE_WISH = 600.0, float('inf')"
    with one_node(TAKES_LONG, settings, path) as process:
        await_line(process, "waiting for power/smoothed")
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "closed\n"
        process.send_signal(signal.SIGINT)  # as a launch does when Ctrl-C reached all its nodes
        print("0", file=process.stdin, flush=True)
        assert process.stdout.readline() == "still here\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(HANG_S) == 0
    assert path.exists()


def test_the_executor_outlives_the_thread_that_wakes_it_at_signals(bench, tmp_path):
    """Else that thread wakes an executor of the past at the second signal."""
    with one_node(SHUTS_DOWN, EXECUTOR, tmp_path / "car.json") as process:
        out, said = process.communicate(timeout=HANG_S)
        assert process.returncode == 0, said
        assert out.splitlines()[0] == "closed" and "ends; ALL" not in out
