"""The command as a shell meets it: completion, colours, JSON on stdout, a stop by Ctrl-C."""

import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest
from rosbags.rosbag2 import Reader

from test.waiting import wait_until

ROOT = Path(__file__).parents[2]
VEHICLE = ("--vehicle", "tesla_model_3_lr")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "100", "OMP_NUM_THREADS": "1"}
INTERRUPTED = 130


@pytest.fixture(scope="module")
def evpinn(tmp_path_factory) -> Path:
    """The command as pip installs it, of this checkout."""
    script = tmp_path_factory.mktemp("bin") / "evpinn"
    script.write_text(
        f"#!{sys.executable}\nfrom evpinn_ros.cli.main import main\nmain()\n", encoding="utf-8"
    )
    script.chmod(0o755)
    return script


def bash(script: str, evpinn: Path, home: Path) -> str:
    ended = subprocess.run(
        ["bash", "--noprofile", "--norc", "-c", script],
        env=ENVIRONMENT | {"PATH": f"{evpinn.parent}:{os.environ['PATH']}", "HOME": str(home)},
        capture_output=True,
        text=True,
        timeout=150,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_completion_is_installed_and_completes_in_a_real_bash(evpinn, tmp_path):
    completions = {
        "evpinn re": {"replay", "reproduce", "recover"},
        "evpinn can i": {"inspect"},
        "evpinn replay --withhold": {"--withhold-battery-after"},
        "evpinn replay bag --vehicle rivian": {"rivian_r1s_2022", "rivian_r1t_2022"},
        "evpinn replay bag --mode ": {"hybrid", "paper"},
        "evpinn convert in out --can-profile renault": {"renault_zoe_ph1", "renault_zoe_ph2"},
    }
    lines = ["evpinn --install-completion bash >/dev/null", ". ~/.bashrc"]
    for typed in completions:
        words = typed.split(" ")
        quoted = " ".join(f"'{word}'" for word in words)
        lines += [
            f"COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; COMPREPLY=()",
            "_evpinn_completion evpinn; echo ${COMPREPLY[@]}",
        ]
    offered = bash("\n".join(lines), evpinn, tmp_path).splitlines()
    assert [set(line.split()) for line in offered] == list(completions.values())


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "evpinn_ros", *map(str, arguments)]
    return subprocess.run(
        command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, timeout=150
    )


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """A CSV drive of an hour, more than any test here waits for."""
    path = tmp_path_factory.mktemp("long") / "long.csv"
    rows = (
        f"{0.1 * i:.1f},{10 + i % 100 / 20:.2f},{900 + 300 * (i % 100)}\n" for i in range(36_000)
    )
    path.write_text("t_s,speed_mps,power_w\n" + "".join(rows))
    return path


@pytest.fixture(scope="module")
def short(drive) -> Path:
    """The first minute of it."""
    path = drive.with_name("short.csv")
    path.write_text("".join(drive.read_text().splitlines(keepends=True)[:600]))
    return path


def test_json_goes_to_stdout_alone(short, tmp_path):
    replayed = run("replay", short, "--metrics", "-", "--warm-up", 5, cwd=tmp_path)
    assert json.loads(replayed.stdout)["input"]["samples"] > 500
    assert "Parameters of the car" in replayed.stderr
    bench = run("bench", "breakdown", "--drives", 1, "--seconds", 60, "--json", "-", cwd=tmp_path)
    assert {"air", "tyres"} <= {row["name"] for row in json.loads(bench.stdout)}
    assert "rms error" in bench.stderr
    assert not (tmp_path / "-").exists()


def interrupted(
    *arguments: object, cwd: Path, once, number: int = signal.SIGINT
) -> subprocess.CompletedProcess:
    """A command that is told to stop once it is time: Ctrl-C reaches all its processes."""
    process = subprocess.Popen(
        [sys.executable, "-m", "evpinn_ros", *map(str, arguments)],
        cwd=cwd,
        env=ENVIRONMENT,
        stdout=(cwd / "stdout").open("w"),
        stderr=(cwd / "stderr").open("w"),
        start_new_session=True,
    )
    wait_until(lambda: once() or process.poll() is not None)
    os.kill(-process.pid if number == signal.SIGINT else process.pid, number)
    process.wait(timeout=120)
    with pytest.raises(ProcessLookupError):  # none is left
        os.killpg(process.pid, 0)
    output = ((cwd / name).read_text() for name in ("stdout", "stderr"))
    return subprocess.CompletedProcess(process.args, process.returncode, *output)


def has_data(folder: Path) -> bool:
    """Half a minute of a drive, and more than one chunk, is in the bag."""
    return any(path.stat().st_size > 200_000 for path in folder.glob("*.mcap"))


def read_bag(folder: Path) -> int:
    with Reader(folder) as reader:
        count = sum(1 for _ in reader.messages())
        assert count == reader.message_count
    return count


def assert_stopped(done: subprocess.CompletedProcess, code: int = INTERRUPTED) -> None:
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.strip().splitlines()[-1].startswith("evpinn: stopped: ")


def test_ctrl_c_leaves_what_was_replayed(drive, tmp_path):
    out = tmp_path / "out"
    ended = interrupted(
        *("replay", drive, "--out", out, "--metrics", "m.json", "--state", "s.json"),
        cwd=tmp_path,
        once=lambda: has_data(out),
    )
    assert_stopped(ended)
    metrics = json.loads((tmp_path / "m.json").read_text())
    assert 10 < metrics["input"]["duration_s"] < 3500
    assert json.loads((tmp_path / "s.json").read_text())["learned"]["vehicle"] == "generic"
    assert read_bag(out) > 1000


def test_ctrl_c_leaves_what_was_converted(drive, tmp_path):
    ended = interrupted(
        "convert", drive, "out", cwd=tmp_path, once=lambda: has_data(tmp_path / "out")
    )
    assert_stopped(ended)
    assert 1000 < read_bag(tmp_path / "out") < 4 * 36_000 - 1000


@pytest.mark.ros
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_demo_is_stopped_with_its_nodes(number, tmp_path):
    begins = {
        signal.SIGINT: lambda: (tmp_path / "bag").exists(),  # the nodes start
        signal.SIGTERM: lambda: any(path.stat().st_size > 0 for path in tmp_path.rglob("*.mcap")),
    }
    ended = interrupted(
        "demo", "--out", tmp_path, cwd=tmp_path, once=begins[number], number=number
    )
    assert_stopped(ended, 128 + number)


def test_a_full_disk_is_one_line(on_a_full_disk, short, tmp_path):
    for arguments, left in (
        (("simulate", "full_1", "--duration", 60), "it was removed"),
        (("replay", short, "--out", "full_2"), "the bag is incomplete"),
        (("convert", short, "full_3"), "the bag is incomplete"),
    ):
        ended = on_a_full_disk(8, *arguments, *VEHICLE, cwd=tmp_path)
        assert ended.returncode == 1
        (line,) = ended.stderr.strip().splitlines()
        assert re.search(rf"full_\d: File too large; {left}", line)
    no_room = run("replay", short, *VEHICLE, "--metrics", "/dev/full", cwd=tmp_path)
    assert no_room.returncode == 1
    *said, line = no_room.stderr.strip().splitlines()
    assert line == "evpinn: /dev/full: No space left on device"
    assert all(
        re.search("have power only|s left$|the harder the car brakes", text) for text in said
    ), said
