"""Damaged logs of every format: all that is read before the damage, its count, and the reason."""

import gzip
import re

import can
from can.io import mf4
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
import pytest

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import LogFile
from evpinn_ros.common.errors import InputError

pytestmark = pytest.mark.slow

COUNT = 60
FORMATS = [".log", ".log.gz", ".asc", ".asc.gz", ".blf", ".trc", ".csv"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a sound log of each format."""
    folder, logs = tmp_path_factory.mktemp("whole"), {}
    for suffix in [*FORMATS, *([".mf4"] if mf4.asammdf else [])]:
        with can.Logger(str(folder / f"log{suffix}")) as writer:
            for index in range(COUNT):
                writer.on_message_received(message(index))
        logs[suffix] = (folder / f"log{suffix}").read_bytes()
    return logs


def message(index):
    return can.Message(
        timestamp=1549819403.0 + index / 100,
        arbitration_id=0x132 if index % 2 else 0x18FF0001,
        is_extended_id=not index % 2,
        is_error_frame=index == 30,
        data=b"" if index == 30 else index.to_bytes(index % 8 + 1, "little"),
    )


def read(path):
    """The frames of a log and its reader; the promise holds whatever is in the file."""
    log, frames = None, []
    try:
        log = LogFile(path)
        for frame in log.frames():
            frames.append(frame)
    except InputError as error:
        assert not frames, "a log that began well ends with its problem, not with an error"
        assert str(path) in str(error) and "\n" not in str(error)
        return [], None
    assert log.count == len(frames) > 0
    if log.problem is not None:
        assert log.problem.startswith(str(path)) and "\n" not in log.problem
        assert re.search(rf"\b{len(frames)} frames", log.problem)
    for frame in frames:
        assert type(frame) is CanFrame and type(frame.stamp_ns) is int
        assert 0 <= frame.can_id < 2 ** (29 if frame.extended else 11)
        assert type(frame.data) is bytes and len(frame.data) <= 64
    return frames, log


def anything_goes(test):
    return settings(
        max_examples=25,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )(test)


@pytest.mark.parametrize("suffix", FORMATS)
@given(data=st.data())
@anything_goes
def test_cut(tmp_path, whole, suffix, data):
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(whole[suffix][: data.draw(st.integers(0, len(whole[suffix])))])
    frames, _ = read(path)
    path.write_bytes(whole[suffix])
    sound, _ = read(path)
    assert frames == sound[: len(frames)]


@pytest.mark.parametrize("suffix", FORMATS)
@given(data=st.data())
@anything_goes
def test_flipped_bits(tmp_path, whole, suffix, data):
    content = bytearray(whole[suffix])
    bits = st.integers(0, 8 * len(content) - 1)
    for bit in data.draw(st.lists(bits, min_size=1, max_size=20)):
        content[bit // 8] ^= 1 << bit % 8
    path = tmp_path / f"flipped{suffix}"
    path.write_bytes(content)
    read(path)


@pytest.mark.parametrize("suffix", FORMATS)
@given(data=st.data())
@anything_goes
def test_random_lines_and_bytes_inside(tmp_path, whole, suffix, data):
    zipped = suffix.endswith(".gz")
    lines = (gzip.decompress(whole[suffix]) if zipped else whole[suffix]).splitlines(True)
    some_text = st.text(max_size=60).map(lambda text: text.encode() + b"\n")
    for line in data.draw(
        st.lists(st.one_of(some_text, st.binary(max_size=60)), min_size=1, max_size=4)
    ):
        lines.insert(data.draw(st.integers(0, len(lines))), line)
    path = tmp_path / f"odd{suffix}"
    content = b"".join(lines)
    path.write_bytes(gzip.compress(content) if zipped else content)
    read(path)


@pytest.mark.parametrize("suffix", FORMATS)
@given(content=st.one_of(st.binary(min_size=1, max_size=300), st.text(min_size=1).map(str.encode)))
@example(content=b"\n")
@anything_goes
def test_no_log_at_all(tmp_path, suffix, content):
    path = tmp_path / f"none{suffix}"
    path.write_bytes(content)
    read(path)


@pytest.mark.skipif(mf4.asammdf is None, reason="without the extra mf4")
@given(data=st.data())
@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_mf4(tmp_path, whole, data):
    """asammdf dies of some of these: a process of its own does, not ours."""
    content = bytearray(whole[".mf4"])
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=20)):
        content[at] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.mf4"
    path.write_bytes(content)
    read(path)
