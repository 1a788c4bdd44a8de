"""A recording that is killed: what of the frames and topics is still there."""

import subprocess
import sys

import pytest

from evpinn_ros.common.package_data import share_directory
from evpinn_ros.logs.bus_sources import open_can_log
from test.waiting import HANG_S

FULL_DISK = """
from collections import deque
import os, pathlib, resource, sys, time
import rclpy
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.nodes.recorder import RecorderNode

rclpy.init()
frames = deque()
node = RecorderNode(pathlib.Path(sys.argv[1]), frames)
sys.dont_write_bytecode = True  # a file cut short would be imported by the next process
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
while node.statuses()[0].level == 0:
    if not frames:
        frames.extend((time.time_ns(), CanFrame(0, 1, os.urandom(8))) for _ in range(500))
    rclpy.spin_once(node)
for _ in range(2):
    frames.extend((time.time_ns(), CanFrame(0, 1, b"")) for _ in range(1000))
    while frames:
        rclpy.spin_once(node)
node.close()
print(len(frames), node.statuses()[0].text)
"""


@pytest.mark.nightly
def test_a_full_disk_ends_the_recording_alone(tmp_path):
    # The limit of a file's size fails as a full disk does, in a write of the system's.
    folder = tmp_path / "bag"
    command = [sys.executable, "-c", FULL_DISK, str(folder)]
    ended = subprocess.run(
        command, cwd=share_directory(), capture_output=True, text=True, timeout=HANG_S
    )
    assert ended.stdout == f"0 recording ended: {folder}: File too large\n", ended.stderr
    assert ended.stderr.count("recording ended") == 1
    assert len(list(open_can_log(next(folder.glob("*.mcap"))).frames())) >= 500
