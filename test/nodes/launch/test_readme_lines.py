"""A newcomer's run of each line of README and ROS guide that begins with `ros2`, as written."""

from itertools import chain
from pathlib import Path
import re

import pytest

from evpinn_ros.nodes import factory
from evpinn_ros.nodes.typed import TYPED
from evpinn_ros.topics import POWER_MEASURED, POWER_SMOOTHED, topic_of

ROOT = Path(__file__).resolve().parents[3]
PAGES = {page: (ROOT / page).read_text() for page in ("README.md", "docs/guides/ros.md")}
LINES = {page: re.findall(r"^ros2 (.+)$", text, re.M) for page, text in PAGES.items()}
UP = {  # what the nodes of a line say when they are up
    "evpinn.launch.py": "waiting for vehicle/speed",
    "replay.launch.py": "measuring",
    "eco_speed_planner.launch.py": "<- picked",
    "estimator": "waiting for vehicle/speed",
}


STRUCK = re.compile(  # by Ctrl-C, while rclpy of `ros2 topic echo` makes a task
    r"Exception ignored in: <function Future.__del__ at 0x\w+>\nTraceback .*\n"
    r"(?:  .*\n)+AttributeError: 'Task' object has no attribute '_exception'\n"
)


@pytest.mark.parametrize("line", dict.fromkeys(chain(*LINES.values())))
def test_a_line_of_a_page_works(ros2, bench, line, monkeypatch, tmp_path):
    words = line.split()
    source = ros2.folder / "src" / "evpinn_ros"  # from the workspace that the guide builds
    if not source.exists():
        source.parent.mkdir()
        source.symlink_to(ROOT)
    end = tmp_path / "end"
    monkeypatch.setitem(ros2.environment, "STAND_IN_END", str(end))
    if "/typed/" in line:  # `test_launch` hears them, where their package is built
        assert words[:2] == ["topic", "echo"] and words[2] in {t.under() for t in TYPED.values()}
        return
    if words[:2] == ["topic", "echo"]:
        node = bench.node.create_publisher(_type(words[2]), words[2], 10)
        # By itself and with time to look around, for a daemon would stay behind.
        with ros2.running(*words, "--no-daemon", "--spin-time", "5") as echo:
            echo.codes, echo.theirs = {0, 2, 130}, STRUCK  # its own, at Ctrl-C
            bench.pump(lambda: node.publish(_type(words[2])()) or "position" in echo.output)
        return
    line = next(line for name, line in UP.items() if name in words)
    measured, smoothed = bench.hear(POWER_MEASURED), bench.hear(POWER_SMOOTHED)
    with ros2.running(*words) as running:
        bench.pump(lambda: line in running.output)
        if "replay.launch.py" in words:  # it plays the inputs alone, and ends with the bag
            bench.pump(lambda: measured and smoothed)
            end.touch()
            bench.pump(lambda: running.process.poll() is not None)
            assert smoothed[0].header.stamp.sec > 10**9


def _type(full_name):
    return factory.message_class(topic_of(full_name).type_name)
