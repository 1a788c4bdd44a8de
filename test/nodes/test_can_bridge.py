"""The bridge on a real python-can bus in this process: what it publishes, and what it says."""

from collections.abc import Iterator
import itertools

import can
import pytest

from evpinn_ros import topics
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import write_log
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.topics.messages import Level

channels = map("bridge{}".format, itertools.count())


@pytest.fixture
def bus():
    with can.Bus(channel=next(channels), interface="virtual") as sender:
        yield sender


def start(bench, bus, **parameters):
    options = {"interface": "virtual", "channel": bus.channel_info.split()[-1], "bitrate": 0}
    return bench.start(CanBridgeNode, **options, **parameters)


def send(bus, *frames):
    for frame in frames:
        bus.send(
            can.Message(
                arbitration_id=frame.can_id, data=frame.data, is_extended_id=frame.extended
            )
        )


def model_3(doors: bool = False) -> Iterator[CanFrame]:
    """Frames for as long as they are asked for."""
    encoder = Encoder(load_profile("tesla_model_3"))
    for index in itertools.count():
        yield encoder.battery(BatteryReading(0, 350.0 + index % 5, -index % 50))
        yield encoder.speed(SpeedReading(0, index % 20 / 10))
        if doors:  # latches, which a Model S would call voltage and current
            yield CanFrame(0, 0x102, bytes((0x22, 0x90, index % 9, 0x26, 0, 0, 0, 0)))


def drive(bench, bus, frames, condition):
    """Send about a hundred frames a second until something is so."""

    def step():
        send(bus, *itertools.islice(frames, 3))
        return condition()

    bench.pump(step)


@pytest.fixture
def said(bench):
    """The lines that nodes log after their first, which may come before this listens."""
    lines = bench.log_lines()
    return lambda: [line for line in lines if not line.startswith("decoding ")]


@pytest.mark.nightly
def test_a_silent_bus_is_said_once(bench, bus, said):
    node = start(bench, bus)
    bench.listen(topics.SPEED)
    drive(bench, bus, model_3(), lambda: bench.heard[topics.SPEED] and "receiving" in said())
    bench.pump(lambda: said()[-1].startswith("silent"))
    bench.await_reports(node, 3)
    assert said()[-1].startswith("silent") and changes(said())
    assert bench.diagnosis(node)["bus"][1].startswith("silent")
    drive(bench, bus, model_3(), lambda: said()[-1] == "receiving")
    assert changes(said())


def changes(lines):
    """True if each line is another than the one before: a bus falls silent beside busy cores."""
    return all(line != other for line, other in itertools.pairwise(lines))


def test_a_profile_that_contradicts_the_bus_publishes_nothing(bench, bus, said):
    node = start(bench, bus, can_profile="tesla_model_s")
    bench.listen(topics.SPEED, topics.BATTERY)
    frames = model_3(doors=True)
    drive(bench, bus, frames, lambda: any("fits better" in line for line in said()))
    level, text, values = bench.diagnosis(node)["bus"]
    assert level is Level.ERROR and "'tesla_model_3' fits better" in text
    assert int(values["dropped.undecided"]) > 0
    assert not node.published[topics.BATTERY] and not node.published[topics.SPEED]
    assert len([line for line in said() if "contradicts" in line]) == 1


def test_a_log_too_short_to_judge_is_published_at_its_end(bench, tmp_path):
    frames = [CanFrame(i * 10**7, 0x3E9, bytes((8, i, *bytes(6)))) for i in range(20)]
    write_log(tmp_path / "short.log", frames)
    log = {"log_file": str(tmp_path / "short.log"), "log_rate": 0.0}
    bench.start(CanBridgeNode, can_profile="chevrolet_bolt", **log)
    bench.listen(topics.SPEED)
    bench.pump(lambda: len(bench.heard[topics.SPEED]) == 20)


def test_a_profile_that_is_trusted_is_not_judged(bench, bus):
    start(bench, bus, can_profile="tesla_model_s", trust_profile=True)
    bench.listen(topics.BATTERY)
    drive(bench, bus, model_3(doors=True), lambda: bench.heard[topics.BATTERY])


def test_a_right_profile_publishes_from_its_first_frames(bench, bus):
    node = start(bench, bus)
    bench.listen(topics.SPEED, topics.BATTERY)
    frames = model_3()
    send(bus, *itertools.islice(frames, 2))
    bench.pump(lambda: bench.heard[topics.SPEED] and bench.heard[topics.BATTERY])
    assert bench.heard[topics.BATTERY][0].voltage == pytest.approx(350.0)
    drive(bench, bus, frames, lambda: bench.diagnosis(node)["bus"][0] is Level.OK)
