"""A CAN log played as if it were a bus."""

import threading
from types import SimpleNamespace

import pytest

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import write_log
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes import frame_sources
from evpinn_ros.nodes.frame_sources import LogPlayer

NOW = 1_700_000_000 * 10**9
FRAMES = [CanFrame(NOW + i * 50_000_000, 0x132, bytes([i])) for i in range(20)]


@pytest.fixture
def log(tmp_path):
    write_log(tmp_path / "drive.log", FRAMES)
    return tmp_path / "drive.log"


class FakeTime(threading.Event):
    """A clock that goes on only while somebody waits; it begins at zero."""

    now_s = 0.0

    def wait(self, timeout=None):
        self.now_s += timeout
        return self.is_set()


@pytest.mark.parametrize(("rate", "delay"), [(0.0, 0.0), (5.0, 0.0), (0.5, 3.0)])
def test_frames_keep_their_stamps_and_the_rate(log, rate, delay, monkeypatch):
    time, heard = FakeTime(), []
    clock = SimpleNamespace(monotonic=lambda: time.now_s)
    monkeypatch.setattr(frame_sources, "time", clock)
    player = LogPlayer(log, rate, delay, lambda frame: heard.append((time.now_s, frame)))
    monkeypatch.setattr(player, "_stop", time)
    player.run()
    assert [frame for _, frame in heard] == FRAMES
    due = [delay + (0.05 * i / rate if rate else 0.0) for i in range(len(FRAMES))]
    assert [at for at, _ in heard] == pytest.approx(due)
    assert player.newest_ns == FRAMES[-1].stamp_ns
    assert player.problem is None and player.text.endswith("ended after 20 frames")


def test_it_stops_when_told(log):
    player = LogPlayer(log, 1e-3, 0.0, lambda frame: None)
    thread = threading.Thread(target=player.run)
    thread.start()
    player.stop()
    thread.join()


def test_a_log_that_is_cut_or_is_none_is_told(log):
    log.write_text(log.read_text()[:-5])
    player = LogPlayer(log, 0.0, 0.0, lambda frame: None)
    player.run()
    assert "cut off" in player.problem
    log.write_text("nothing\n")
    player = LogPlayer(log, 0.0, 0.0, lambda frame: None)
    player.run()
    assert str(log) in player.problem
    with pytest.raises(InputError, match=r"nowhere\.log"):
        LogPlayer(log.with_name("nowhere.log"), 0.0, 0.0, lambda frame: None)


def test_a_stamp_beyond_all_time_ends_it(log):
    first = log.read_text().splitlines()[0]
    log.write_text(f"{first}\n(8500000000.0) can0 132#00\n")
    player = LogPlayer(log, 0.5, 0.0, lambda frame: None)
    player.run()
    assert player.problem == f"{log}: frame 2 has an impossible stamp"
