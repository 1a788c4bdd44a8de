from datetime import datetime

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


ASC = "date {date}\nbase hex  timestamps {kind}\nno internal events logged\n"


def asc(path, times, date="Tue Mar 5 07:08:09.000 am 2024", kind="absolute"):
    lines = [f"{time:.6f} 1  132             Rx   d 2 93 88\n" for time in times]
    path.write_text(ASC.format(date=date, kind=kind) + "".join(lines))
    return path


BEGAN = datetime(2024, 3, 5, 7, 8, 9).timestamp()


@pytest.mark.parametrize(
    ("times", "options", "begin"),
    [
        ([-2.5, -1.0, 0.0, 3.0], {}, BEGAN - 2.5),
        ([25690.5, 25692.0, 25693.0, 25696.0], {}, BEGAN + 1.5),  # of the day
        ([300000.5, 300002.0, 300003.0, 300006.0], {}, BEGAN),  # since the computer started
        ([0.0, 1.5, 1.0, 3.0], {"kind": "relative"}, BEGAN),
        ([0.0, 1.5, 2.5, 5.5], {"date": "Die Mär 5 07:08:09.000 2024"}, BEGAN),
        ([0.0, 1.5, 2.5, 5.5], {"date": "mar. mars 5 07:08:09 2024"}, BEGAN),
        ([0.0, 1.5, 2.5, 5.5], {"date": "Kedd szept 5 07:08:09 2024"}, 0.0),  # no date is lost
        ([-2.5, -1.0, 0.0, 3.0], {"date": "unknown"}, 0.0),
    ],
)
def test_times_of_an_asc_run_from_its_first_frame(tmp_path, times, options, begin):
    log = LogFile(asc(tmp_path / "a.asc", times, **options))
    stamps = [frame.stamp_ns / 1e9 for frame in log.frames()]
    assert stamps == pytest.approx([begin, begin + 1.5, begin + 2.5, begin + 5.5], abs=1e-5)


def test_times_since_the_line_before_are_summed(tmp_path):
    path = tmp_path / "a.log"
    steps = [0.0, *[0.001, 0.099] * 50]
    path.write_text("".join(f"(000.{1000 * s:03.0f}000) can0 132#9388\n" for s in steps))
    log = LogFile(path)
    assert log.seconds is None
    stamps = [frame.stamp_ns / 1e9 for frame in log.frames()]
    assert stamps[-1] == pytest.approx(5.0) and stamps == sorted(stamps)


def two_buses(path, same):
    """The same ids on two buses, with the same data or with others."""
    with path.open("w") as log:
        for k in range(400):
            for can_id in range(0x130, 0x138):
                log.write(f"({1000 + 0.1 * k:.6f}) can0 {can_id:03X}#{k:04X}\n")
                log.write(f"({1000 + 0.1 * k:.6f}) can1 {can_id:03X}#{k if same else 7 * k:04X}\n")
    return path


def test_buses_of_two_cars_are_refused_or_chosen(tmp_path):
    path = two_buses(tmp_path / "two.log", same=False)
    with pytest.raises(InputError, match=r"buses can0 and can1 send .* say --car can0 or"):
        list(LogFile(path).frames())
    second = [frame.data for frame in LogFile(path, "can1").frames()]
    assert len(second) == 3200 and second[8] == (7).to_bytes(2, "big")
    mirrored = LogFile(two_buses(tmp_path / "one.log", same=True))
    assert len(list(mirrored.frames())) == 3200 and mirrored.skipped == {"other_bus": 3200}
