"""Files that are no drive, whoever opens them: refused in one line that names the file."""

import pytest

from evpinn_ros.can.logs import LogFile
from evpinn_ros.common.errors import InputError
from evpinn_ros.logs.contents import contents
from evpinn_ros.logs.sources import open_drive


def log(path):
    return list(LogFile(path).frames())


def table(path):
    return open_drive(path, 350.0)


WRONG = [
    (log, "a.log", None, "No such file or directory"),
    (log, "a.log", b"", "the file is empty"),
    (log, "a.log", b"this is a letter\n", "is no line of a CAN log"),
    (log, "a.blf", b"LOGG", "broken after 0 frames"),
    (log, "a.asc", b"dear reader\n", "no CAN frame in it"),
    (log, "a.csv", b"t_s,speed_mps\n0,1\n", "is no line of a CAN log"),
    (log, "a.log.gz", b"not gzip", "broken after 0 frames"),
    (log, "a.txt", b"x", "not a CAN log"),
    (log, "a.gz", b"x", "not a CAN log"),
    (table, "a.csv", None, "No such file"),
    (table, "a.csv", b"", "the file is empty"),
    (
        table,
        "a.csv",
        b'current;"VALUE";"UNITS";"PID"',
        "no column of time and speed; there are none",
    ),
    (
        table,
        "a.csv",
        b"row,speed_mps,power_w\n1,2,3\n",
        "no column of time; there are row, speed_mps",
    ),
    (
        table,
        "a.csv",
        b"a;b;c\n1;2;3\n",
        "time and speed; .* say --column time=NAME --column speed=NAME",
    ),
    (
        table,
        "a.csv",
        b"t_s,speed_mps,voltage_v\n1,2,3\n",
        "only a column of voltage, and none of power",
    ),
    (
        table,
        "a.csv",
        b"t_s,speed_mps,power_w,power_w\n1,2,3,3\n",
        "'power_w' is there twice",
    ),
    (table, "a.csv", b"\xff\xfe\x00t_s", "no column of time and speed"),
    (table, "a.csv.gz", b"t_s,speed_mps,power_w\n", "Not a gzipped file"),
    (contents, "nowhere.mcap", None, "no such file"),
    (contents, "a.mcap", b"", "empty"),
    (contents, "a.csv", b"x,y\n1,2\n", "no column of time and speed"),
    (contents, "a.log", b"", "empty"),
    (contents, "a.dat", b"hello", r"neither a bag, a CAN log \(.*\) nor a table \(.csv, .*\)"),
    (contents, "a.txt", b"hello", "no column of time"),
]


@pytest.mark.parametrize(("read", "name", "content", "reason"), WRONG)
def test_a_wrong_file_is_refused_in_one_line(tmp_path, read, name, content, reason):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=reason) as caught:
        read(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value) and "\n" not in str(caught.value)
