"""The end of a process that runs nodes: nothing may keep it once all is saved."""

import json
import signal
import subprocess
import sys

from test.nodes.processes import await_line, started
from test.waiting import HANG_S, wait_until

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
            running.SAME_SIGNAL = float(line)
            print("still here", flush=True)
"""
SIGNALLED = """
import os, signal
from itertools import count
import rclpy
from rclpy.event_handler import EventHandler
numbers, add = count(1), EventHandler.add_to_wait_set

def add_and_signal(self, wait_set):
    add(self, wait_set)
    if next(numbers) == 2:  # one is entered, others are not
        os.kill(os.getpid(), signal.SIGINT)
        turns = range(100_000)  # in which a thread of rclpy would shut the context down
        any(not rclpy.ok() for _ in turns)

EventHandler.add_to_wait_set = add_and_signal
"""


def one_node(methods, settings, path):
    """A process of one node."""
    code = NODE.format(methods=methods, settings=settings)
    return started(sys.executable, "-c", code, path, stdin=subprocess.PIPE)


def test_a_middleware_that_hangs_cannot_keep_a_process_that_has_saved(bench, tmp_path):
    path = tmp_path / "car.json"
    settings = "running.FAREWELL, running.SAME_SIGNAL = 1.0, float('inf')"
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
    settings = "running.FAREWELL, running.SAME_SIGNAL = 600.0, float('inf')"
    with one_node(TAKES_LONG, settings, path) as process:
        await_line(process, "waiting for power/smoothed")
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "closed\n"
        process.send_signal(signal.SIGINT)  # as a launch does when Ctrl-C reached all its nodes
        print("0", file=process.stdin, flush=True)
        assert process.stdout.readline() == "still here\n"
        # One that comes just before the process reads is looked at once the reading is over.
        wait_until(lambda: process.poll() is not None or process.send_signal(signal.SIGTERM))
        assert process.wait() == 0
    assert path.exists()


def test_a_signal_while_the_executor_enters_endpoints_ends_the_node_well(bench, tmp_path):
    """A context that is shut down meanwhile makes the executor abort the process."""
    with one_node("", SIGNALLED, tmp_path / "car.json") as process:
        out, said = process.communicate(timeout=HANG_S)
        assert process.returncode == 0, said
        assert out == "closed\n" and "callbacks" not in out + said
