"""A recording that is killed: what of the frames and topics is still there."""

from collections import deque
import itertools
import subprocess
import sys

import can
import pytest

from evpinn_ros import topics
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.writer import Split
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.signals.readings import SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.bus_sources import CanLogSource, open_can_log
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_source
from evpinn_ros.nodes.recorder import FLUSH_PERIOD, RecorderNode
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.messages import stamp_ns
from test.nodes.processes import all_in_one, started
from test.waiting import HANG_S

OTHER_ID = 0x700
SPEEDS = 500


def test_a_kill_costs_only_what_came_since_the_last_flush(bench, can_bus, tmp_path):
    """All that was sent is on the disk while the recorder is alive, and is still read after."""
    assert FLUSH_PERIOD <= 1.0  # as the guides promise
    (bus, options), folder = can_bus, tmp_path / "bag"
    with started(*all_in_one(folder, **options)):
        bench.listen(topics.SPEED)
        last = drive(bus, bench)
        heard = stamp_ns(bench.heard[topics.SPEED][-1])
        file = next(folder.glob("*.mcap"))
        bench.pump(lambda: recorded(file)[0][-1:] == [last] and recorded(file)[1][-1:] >= [heard])

    numbers, stamps = recorded(file)
    assert numbers == list(range(numbers[0], last + 1)) and stamps[-1] >= heard
    again = open_source(file, load_vehicle("tesla_model_3_lr"), ReadOptions("tesla_model_3"))
    assert isinstance(again, CanLogSource)
    assert len(list(again.readings())) >= len(stamps) - 1


def recorded(file):
    """Numbers of the frames, and stamps of the speeds, in a file that may still grow."""
    try:
        frames = open_can_log(file).frames()
    except InputError:  # none yet
        return [], []
    numbers = [int.from_bytes(each.data, "big") for each in frames if each.can_id == OTHER_ID]
    with BagReader(file) as bag:
        stamps = [stamp_ns(record.message) for record in bag.records([topics.SPEED.under()])]
    return numbers, stamps


def drive(bus, bench):
    """Send a speed and a numbered frame again and again, each when the one before has come back.

    Gives the last number.
    """
    encoder, heard = Encoder(load_profile("tesla_model_3")), bench.heard[topics.SPEED]
    numbers = itertools.count()

    def send():
        number = next(numbers)
        speed = encoder.speed(SpeedReading(0, number % 100 / 10))
        for can_id, data in ((speed.can_id, speed.data), (OTHER_ID, number.to_bytes(8, "big"))):
            bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        return number

    bench.pump(lambda: heard or send() < 0)  # a bus and a topic lose what comes before all listen
    for count in range(len(heard), len(heard) + SPEEDS):
        last = send()
        bench.pump(lambda n=count: len(heard) > n)
    return last


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
    done = subprocess.run(
        command, cwd=share_directory(), capture_output=True, text=True, timeout=HANG_S
    )
    assert done.stdout == f"0 recording ended: {folder}: File too large\n", done.stderr
    assert done.stderr.count("recording ended") == 1
    assert len(list(open_can_log(next(folder.glob("*.mcap"))).frames())) >= 500


def test_a_recording_goes_on_in_another_file(bench, tmp_path):
    folder, start = tmp_path / "bag", 1_700_000_000 * 10**9
    frames = deque((start + i * 10**7, CanFrame(0, i, b"12345678")) for i in range(1000))
    split = Split(seconds=3.0)
    node = bench.start(lambda **_: RecorderNode(folder, frames, split, namespace=NAMESPACE))
    bench.pump(lambda: not frames)
    node.close()
    assert sorted(path.name for path in folder.iterdir()) == [
        *(f"bag_{i}.mcap" for i in range(4)),
        "metadata.yaml",
    ]
    ids = [frame.can_id for frame in open_can_log(folder).frames()]
    assert ids == list(range(1000))
