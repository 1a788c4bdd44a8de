import can
from can.io import mf4
import pytest

from evpinn_ros.can import logs
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import LogFile, write_log
from evpinn_ros.common.errors import InputError

START = 1549819403.028902
COUNT = 2000


def messages():
    for index in range(COUNT):
        yield can.Message(
            timestamp=round(START + index * 0.01, 6),
            arbitration_id=0x132 if index % 2 else 0x18FF0001,
            is_extended_id=not index % 2,
            data=index.to_bytes(6, "little"),
        )


def write(path):
    writer = can.Logger(str(path))
    for message in messages():
        writer.on_message_received(message)
    writer.stop()
    return path


def check(frames, milliseconds=False):
    for index, frame in enumerate(frames):
        assert frame.can_id == (0x132 if index % 2 else 0x18FF0001)
        assert frame.extended == (not index % 2)
        assert frame.data == index.to_bytes(6, "little")
        if not milliseconds:
            assert frame.stamp_ns == 1549819403028902000 + index * 10_000_000


needs_asammdf = pytest.mark.skipif(mf4.asammdf is None, reason="without the extra mf4")
MF4 = pytest.param(".mf4", marks=needs_asammdf)


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".asc", ".blf", ".trc", ".csv", MF4])
def test_every_format(tmp_path, suffix):
    log = LogFile(write(tmp_path / f"drive{suffix}"))
    frames = list(log.frames())
    assert len(frames) == log.count == COUNT
    assert log.problem is None and not log.skipped
    check(frames, milliseconds=suffix == ".asc")
    if suffix == ".asc":
        # The format tells the start to the second at best; times within it are exact.
        assert abs(frames[0].stamp_ns - 1549819403028902000) < 10**9
        assert frames[-1].stamp_ns - frames[0].stamp_ns == (COUNT - 1) * 10_000_000


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv"])
@pytest.mark.parametrize("end", [1000, logs.END])
def test_the_ends_of_a_log_tell_how_long_it_is(tmp_path, suffix, end, monkeypatch):
    monkeypatch.setattr(logs, "END", end)
    log = LogFile(write(tmp_path / f"drive{suffix}"))
    assert log.seconds == pytest.approx((COUNT - 1) * 0.01, abs=2e-3)
    assert log.count == 0 and log.problem is None and not log.skipped
    whole = log.path.read_bytes()
    log.path.write_bytes(whole[: int(0.6 * len(whole))])
    if suffix != ".blf":  # whose header tells the end, wherever it is cut
        assert LogFile(log.path).seconds == pytest.approx(0.6 * COUNT * 0.01, rel=0.05)
    log.path.write_bytes(b"\x00no log\n" * 100)
    assert LogFile(log.path).seconds is None


@needs_asammdf
def test_truncated_mf4_says_so(tmp_path):
    whole = write(tmp_path / "drive.mf4").read_bytes()
    (tmp_path / "cut.mf4").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.mf4: broken after 0 frames"):
        list(LogFile(tmp_path / "cut.mf4").frames())


def test_broken_line_in_the_middle(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 132#00\n(1.1) can0 132#01\n\x00\xff~~\n(1.2) can0 132#02\n")
    log = LogFile(path)
    assert len(list(log.frames())) == 2
    assert log.problem.startswith(f"{path}:3: broken after 2 frames: ")


def test_other_frames_are_skipped_and_counted(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 132#R\n(1.1) can0 20000080#0000000000000000\n(1.2) can0 132#01\n")
    log = LogFile(path)
    assert [frame.data for frame in log.frames()] == [b"\x01"]
    assert log.skipped == {"remote_frame": 1, "error_frame": 1}


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_an_id_of_two_buses_is_read_from_one(tmp_path, suffix):
    path = tmp_path / f"both{suffix}"
    with can.Logger(str(path)) as writer:
        for index, (channel, can_id) in enumerate([(1, 0x1DB), (2, 0x1DB), (2, 0x284)] * 3):
            writer.on_message_received(
                can.Message(
                    timestamp=START + index,
                    arbitration_id=can_id,
                    is_extended_id=False,
                    data=bytes([channel]),
                    channel=channel,
                )
            )
    log = LogFile(path)
    assert {(frame.can_id, frame.data) for frame in log.frames()} == {
        (0x1DB, b"\x01"),
        (0x284, b"\x02"),
    }
    assert log.count == 6 and log.skipped == {"other_bus": 3}


def test_reader_of_frames_may_fail_by_itself(tmp_path):
    log = LogFile(write(tmp_path / "drive.log"))
    with pytest.raises(ZeroDivisionError):
        for _ in log.frames():
            raise ZeroDivisionError
    assert log.problem is None


def test_written_log_reads_back(tmp_path):
    frames = [
        CanFrame(1549819403028902000, 0x132, bytes(range(8))),
        CanFrame(1549819403028903000, 0x18FF0001, b"", extended=True),
        CanFrame(1549819403028904000, 0x132, bytes(range(16))),
    ]
    path = tmp_path / "drive.log"
    assert write_log(path, frames) == 3
    assert list(LogFile(path).frames()) == frames
    assert path.read_text().startswith("(1549819403.028902) can0 132#0001020304050607\n")


def test_frames_that_no_bus_can_carry_are_skipped_and_counted(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 932#01\n(1.1) can0 132#02\n")
    log = LogFile(path)
    assert [frame.data for frame in log.frames()] == [b"\x02"]
    assert log.skipped == {"impossible_frame": 1}
