"""The commands for recordings as a person meets them: info, recover, convert, replay."""

import json
from pathlib import Path
import re
import subprocess

import pytest
from rosbags.rosbag2 import Reader

from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.sources import open_drive

ROOT = Path(__file__).parents[2]
URBAN = ROOT / "bags" / "urban"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A stranger's CSV of 60 s, km/h, and current negative while it discharges; a broken bag."""
    folder = tmp_path_factory.mktemp("bags")
    lines = ["Time [s];Velocity [km/h];Battery Voltage [V];Battery Current [A];Radio"]
    for i in range(600):
        speed = 20.0 + 20.0 * ((i // 100) % 2 * 2 - 1) * ((i % 100) / 50 - 1)
        rising = 1 if (i // 100) % 2 else -1
        lines.append(f"{0.1 * i:.1f};{speed:.2f};360;{-30.0 - 25.0 * rising};loud")
    (folder / "my.csv").write_text("\n".join(lines) + "\n")
    (file,) = URBAN.glob("*.mcap")
    data = bytearray(file.read_bytes()[:150_000])
    data[60_500:60_900] = bytes(400)  # in a chunk
    (folder / "broken.mcap").write_bytes(data)
    return folder


def assert_fails_in_one_line(done: subprocess.CompletedProcess, *words: str) -> None:
    assert done.returncode == 1 and "Traceback" not in done.stderr
    line = done.stderr.strip().splitlines()[-1]
    for word in words:
        assert word in line


def test_a_strangers_csv_in_two_commands(evpinn, folder):
    ended = evpinn("convert", "my.csv", "my", "--vehicle", "bmw_i3", cwd=folder)
    assert ended.returncode == 0 and ended.stdout.strip() == "my"
    for given in ("km/h, by its name", "negative while it discharges", "not used: Radio"):
        assert given in ended.stderr
    direct = evpinn("replay", "my.csv", "--vehicle", "bmw_i3", "--metrics", "a.json", cwd=folder)
    bag = evpinn("replay", "my", "--vehicle", "bmw_i3", "--metrics", "b.json", cwd=folder)
    assert direct.returncode == bag.returncode == 0, direct.stderr + bag.stderr
    assert "km/h, by its name" in direct.stderr
    first, second = (json.loads((folder / name).read_text()) for name in ("a.json", "b.json"))
    assert first["energy"]["measured_j"] == pytest.approx(second["energy"]["measured_j"])
    assert first["energy"]["measured_j"] == pytest.approx(360 * 30 * 60, rel=0.02)


def test_told_columns_reach_both_commands(evpinn, folder):
    (folder / "odd.csv").write_text("a,b,c\n" + "".join(f"{i},{i},{i}\n" for i in range(20)))
    failed = evpinn("convert", "odd.csv", "odd", cwd=folder)
    assert_fails_in_one_line(failed, "no column of time and speed", "--column time=NAME")
    assert not (folder / "odd").exists()
    given = ("--column", "time=a", "--column", "speed=b:km/h", "--column", "power=c:kW")
    assert evpinn("convert", "odd.csv", "odd", *given, cwd=folder).returncode == 0
    assert evpinn("replay", "odd.csv", *given, cwd=folder).returncode == 0
    read = open_drive(folder / "odd.csv", 1.0, ReadOptions(columns=given[1::2]))
    assert read.rules[1].factor == pytest.approx(1 / 3.6)


def test_start_duration_and_loop(evpinn, folder):
    ended = evpinn(
        *("replay", "my.csv", "--vehicle", "bmw_i3", "--start", 20, "--duration", 30),
        *("--loop", 2, "--metrics", "part.json", "--warm-up", 5, "--out", "parts"),
        cwd=folder,
    )
    assert ended.returncode == 0, ended.stderr
    first, second = json.loads((folder / "part.json").read_text())
    for metrics in (first, second):
        assert metrics["input"]["duration_s"] == pytest.approx(29.9)
    # The second turn knows what the first taught.
    assert second["parameters"]["p_aux"] != first["parameters"]["p_aux"]
    assert sorted(path.name for path in (folder / "parts").iterdir()) == ["001_my", "002_my"]
    ended = evpinn("replay", "my.csv", "--start", 5000, cwd=folder)
    assert_fails_in_one_line(ended, "my.csv", "in that span")


def test_info_of_everything_and_of_one_that_is_bad(evpinn, folder):
    ended = evpinn("info", URBAN, "nowhere", "my.csv", "broken.mcap", "--json", "-", cwd=folder)
    assert ended.returncode == 1 and "nowhere: no such file" in ended.stderr
    bag, table, broken = json.loads(ended.stdout)
    assert bag["usable"]["seconds"] == pytest.approx(360, abs=1)
    assert table["columns"][1]["unit"] == "km/h" and table["usable"]["moving_s"] > 20
    assert "damaged" in broken["notes"][0]
    shown = evpinn("info", URBAN, cwd=folder)
    assert "can be used" in shown.stdout and shown.returncode == 0


def test_recover_then_replay(evpinn, folder):
    ended = evpinn("recover", "broken.mcap", "saved", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    assert "messages saved" in ended.stdout and "a chunk, bytes" in ended.stdout
    assert "damaged" in ended.stdout and "cut" in ended.stdout
    with Reader(folder / "saved") as reader:
        count = reader.message_count
        assert sum(1 for _ in reader.messages()) == count > 3500
    replayed = evpinn("replay", "saved", "--vehicle", "tesla_model_3_lr", cwd=folder)
    progress = re.compile(r"saved: .* s left")  # lines of a replay that takes longer than 10 s
    assert replayed.returncode == 0
    assert all(map(progress.fullmatch, replayed.stderr.splitlines()))
    again = evpinn("recover", "broken.mcap", "saved", cwd=folder)
    assert_fails_in_one_line(again, "saved", "not empty")
    report = json.loads(evpinn("recover", "broken.mcap", "two", "--json", "-", cwd=folder).stdout)
    (file,) = report["files"]
    assert file["messages"] == count and len(file["losses"]) >= 2
