"""What a table costs: memory and the processor, however it is made."""

import gzip
from itertools import islice
import re
import subprocess
import sys
import tracemalloc
import zipfile

import numpy as np
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.opener import LONGEST_LINE
from evpinn_ros.logs import clock_start
from evpinn_ros.logs.sources import open_drive

SHEET = (
    '<?xml version="1.0"?><worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/'
    'main"><sheetData>{}</sheetData></worksheet>'
)


def test_tables_of_nothing_are_refused_at_once(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    bombs = {
        "columns.csv.gz": b",".join([b"a"] * 600_000),
        "row.csv.gz": b'time,speed,power\n"' + b"x" * (LONGEST_LINE + 9),
        "quote.csv.gz": b"time,speed,power\n" + b'"a\n' * 200_000,
        "lines.csv.gz": b'time,speed,power\n"' + b"x,1,2\n" * 3_000_000,
        "blank.csv.gz": b"time,speed,power\n" + b"\n" * 200_000,
    }
    for name, data in bombs.items():
        (tmp_path / name).write_bytes(gzip.compress(data, 1))
        with pytest.raises(InputError, match=name):
            open_drive(tmp_path / name)
    book = openpyxl.Workbook()
    book.save(tmp_path / "good.xlsx")
    cells = "".join(f'<row r="{i}"><c r="A{i}"/></row>' for i in range(1, 100_000))
    with (
        zipfile.ZipFile(tmp_path / "good.xlsx") as good,
        zipfile.ZipFile(tmp_path / "bad.xlsx", "w", zipfile.ZIP_DEFLATED) as bad,
    ):
        for part in good.namelist():
            sheet = part.startswith("xl/worksheets/")
            bad.writestr(part, SHEET.format(cells) if sheet else good.read(part))
    with pytest.raises(InputError, match="rows are empty"):
        open_drive(tmp_path / "bad.xlsx")


MEASURED = """
import re, sys
from evpinn_ros.cli.main import main
command, *paths = sys.argv[1:]
for path in paths:
    sys.argv[1:] = [command, path]
    try:
        main()
    except SystemExit as end:
        peak = re.search("VmHWM:\\s*(\\d+)", open("/proc/self/status").read())
        print(end.code, int(peak[1]) / 1024)
"""

BOMBS = {
    "columns": b",".join([b"a"] * 1_000_000),
    "endless_row": b'time,speed,power\n"' + b"x" * 60_000_000,
    "open_quotes": b"time,speed,power\n" + b'"a\n' * 2_000_000,
}


@pytest.mark.slow
@pytest.mark.parametrize("command", ["info", "replay"])
def test_a_bomb_costs_no_command_200_mb(tmp_path, command):
    paths = [tmp_path / "empty.csv.gz"]
    paths[0].write_bytes(gzip.compress(b"time,speed,power\n"))
    for name, data in BOMBS.items():
        paths.append(tmp_path / f"{name}.csv.gz")
        paths[-1].write_bytes(gzip.compress(data, 9))
    assert all(path.stat().st_size < 70_000 for path in paths)
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, command, *paths], capture_output=True, text=True
    )
    refusals = done.stderr.splitlines()
    assert len(refusals) == len(paths)
    assert all(path.name in said for path, said in zip(paths, refusals, strict=True))
    for line in done.stdout.splitlines()[1:]:
        code, megabytes = line.split()
        assert code == "1" and float(megabytes) < 200.0, done.stdout


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_numbers_as_large_as_floats_can_be_are_refused_in_one_line(tmp_path):
    """numpy writes a warning of two lines to the terminal where a mean of them overflows."""
    path = tmp_path / "huge.csv"
    path.write_text("t_s,speed_mps,power_w\n" + "1e308,1,2\n" * 300)
    with pytest.raises(InputError, match="1e308"):
        list(open_drive(path).readings())


def test_a_long_comment_costs_no_square_of_its_length(tmp_path, monkeypatch):
    """The expression for the start of a clock takes the square of the text that it is given."""
    search, lengths = re.search, []

    def recorded(pattern, text, flags=0):
        if pattern == clock_start.STARTED:
            lengths.append(len(text))
        return search(pattern, text, flags)

    monkeypatch.setattr(re, "search", recorded)
    path = tmp_path / "spaces.csv"
    path.write_text("# start" + " " * 100_000 + "\nt_s,speed_mps,power_w\n0,1,2\n1,2,3\n")
    assert len(list(open_drive(path).readings())) == 4
    assert max(lengths) == clock_start.LONGEST_COMMENT


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("order", ["newest first", "in no order"])
def test_a_table_not_oldest_first_is_not_held_as_text(tmp_path, order):
    rows = np.arange(200_000, 0, -1)
    if order == "in no order":
        np.random.default_rng(1).shuffle(rows)
    path = tmp_path / "drive.csv"
    with path.open("w") as file:
        file.write("Timestamp,Speed (km/h),Voltage (V),Current (A),Note\n")
        for i in rows.tolist():
            file.write(f"{1_700_000_000 + i},{i % 90},360,{i % 50},{i:060d}\n")
    drive = open_drive(path)
    tracemalloc.start()
    stamps = [reading.stamp_ns for reading in islice(drive.readings(), 10)]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert stamps == sorted(stamps) and stamps[0] == 1_700_000_001 * 10**9
    assert peak < 3 * path.stat().st_size


def test_a_table_is_looked_at_without_importing_what_reads_buses(tmp_path):
    """Half a second of `evpinn info drive.csv`, and of all that a table goes through."""
    (tmp_path / "drive.csv").write_text("t_s,speed_mps,power_w\n0,1,2\n1,2,3\n")
    code = (
        "import sys; from evpinn_ros.cli.main import main\n"
        "sys.argv = ['evpinn', 'info', 'drive.csv']\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print(sorted({'can', 'rosbags', 'cantools', 'torch', 'pandas'} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "2 readings" in done.stdout and done.stdout.strip().endswith("[]"), done.stdout
