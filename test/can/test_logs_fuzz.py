"""Logs of every format that are cut; `test/damage` tries all other damage."""

import can
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import pytest

from test.damage.targets import read_log

pytestmark = pytest.mark.slow

COUNT = 60
FORMATS = [".log", ".log.gz", ".asc", ".asc.gz", ".blf", ".trc", ".csv"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a sound log of each format, and its frames."""
    folder, logs = tmp_path_factory.mktemp("whole"), {}
    for suffix in FORMATS:
        with can.Logger(str(folder / f"log{suffix}")) as writer:
            for index in range(COUNT):
                writer.on_message_received(message(index))
        path = folder / f"log{suffix}"
        logs[suffix] = path.read_bytes(), read_log(path)[0]
    return logs


def message(index):
    return can.Message(
        timestamp=1549819403.0 + index / 100,
        arbitration_id=0x132 if index % 2 else 0x18FF0001,
        is_extended_id=not index % 2,
        is_error_frame=index == 30,
        data=b"" if index == 30 else index.to_bytes(index % 8 + 1, "little"),
    )


@pytest.mark.parametrize("suffix", FORMATS)
@given(data=st.data())
@settings(
    max_examples=20,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_a_log_that_is_cut_gives_all_frames_before_the_cut(tmp_path, whole, suffix, data):
    content, sound = whole[suffix]
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    frames, _ = read_log(path)
    assert frames == sound[: len(frames)]
