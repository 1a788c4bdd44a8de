"""The command as a person meets it: results, one-line errors, exit codes."""

import json
import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

from evpinn_ros.core.estimation.state_file import StateClaim

ROOT = Path(__file__).parents[2]
METRIC_KEYS = {
    "input": {"path", "duration_s", "samples", "dropped"},
    "power": {"lag_s", "rmse_w", "mae_w", "r2", "coverage_90", "floor_w"},
    "power_now": {"rmse_w", "mae_w", "r2", "coverage_90"},
    "energy": {"measured_j", "predicted_j", "rknn_j", "error_percent", "rknn_error_percent"},
    "updates": {"count", "accepted", "rejected", "p50_ms", "p99_ms"},
    "replay": {"wall_s", "realtime_factor", "peak_rss_mb"},
}


@pytest.fixture(scope="module")
def folder(evpinn, tmp_path_factory) -> Path:
    """A simulated drive of 45 s as bag and as CAN log, and the same drive without a battery."""
    folder = tmp_path_factory.mktemp("cli")
    ended = evpinn(
        *("simulate", "drive", "--duration", 45, "--seed", 5, "--can-log", "drive.log"), cwd=folder
    )
    assert ended.returncode == 0, ended.stderr
    (folder / "speed.csv").write_text(
        "t_s,speed_mps,power_w\n" + "".join(f"{0.1 * i:.1f},{0.05 * i:.2f},\n" for i in range(100))
    )
    return folder


def assert_fails_in_one_line(done: subprocess.CompletedProcess, *words: str) -> None:
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    (line,) = done.stderr.strip().splitlines()
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    "command", [("demo",), ("run", "--vehicle", "tesla_model_3_lr"), ("watch",)], ids=" ".join
)
def test_without_ros_the_commands_that_need_it_fail_in_one_line(tmp_path, command):
    script = (
        "import sys; sys.modules['rclpy'] = None; from evpinn_ros.cli.main import main; main()"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script, *command],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert_fails_in_one_line(ended, "rclpy is not installed", "evpinn_ros[ros]")
    assert not list(tmp_path.iterdir())


def test_wrong_usage_is_exit_code_2(evpinn, tmp_path):
    assert evpinn("replay", "--no-such-option", cwd=tmp_path).returncode == 2
    assert evpinn("replay", "bag", "--mode", "psychic", cwd=tmp_path).returncode == 2


def test_replay_metrics_keep_the_contract(evpinn, folder):
    ended = evpinn(
        *("replay", "drive", "--vehicle", "tesla_model_3_lr", "--metrics", "found.json"),
        *("--warm-up", 10, "--withhold-battery-after", 30, "--out", "learned"),
        *("--report", "report.html", "--units", "us", "--state", "state.json"),
        cwd=folder,
    )
    assert ended.returncode == 0, ended.stderr
    # No progress bar in a pipe; a slip of the pen in its name is answered with the right one.
    anew = "evpinn: state.json does not exist yet: the car starts from its vehicle file\n"
    assert ended.stderr == anew
    assert "true value" in ended.stdout and "baseline" in ended.stdout
    metrics = json.loads((folder / "found.json").read_text())
    for section, keys in METRIC_KEYS.items():
        assert set(metrics[section]) == keys
    assert set(metrics["withheld"]) == {"from_s", "power", "power_now", "energy"}
    assert set(metrics["parameters"]) == {"eta", "mu", "mass", "c_rr", "c_d", "p_aux"}
    keys = {"value", "std", "prior_share", "lower", "upper", "state"}
    assert all(set(estimate) == keys for estimate in metrics["parameters"].values())
    assert metrics["withheld"]["power"]["rmse_w"] > 0
    report = (folder / "report.html").read_text()
    assert 'data-plot="power"' in report and "speed, mph" in report
    assert (folder / "learned" / "metadata.yaml").is_file()
    assert (
        json.loads((folder / "state.json").read_text())["learned"]["vehicle"] == "tesla_model_3_lr"
    )


def test_state_is_taken_up_and_another_car_refuses_it(evpinn, folder):
    replay = ("replay", "drive", "--state", "kept.json", "--metrics", "m.json", "--warm-up", 5)
    first = evpinn(*replay, "--vehicle", "tesla_model_3_lr", cwd=folder)
    assert first.returncode == 0, first.stderr
    before = json.loads((folder / "m.json").read_text())["power"]["rmse_w"]
    second = evpinn(*replay, "--vehicle", "tesla_model_3_lr", cwd=folder)
    assert second.returncode == 0, second.stderr
    assert json.loads((folder / "m.json").read_text())["power"]["rmse_w"] < before
    other = evpinn(*replay, "--vehicle", "nissan_leaf", cwd=folder)
    assert_fails_in_one_line(other, "kept.json", "nissan_leaf")


def test_a_bad_input_does_not_cost_the_drives_beside_it(evpinn, folder):
    (folder / "wrong.csv").write_text("t_s,speed_mps,power_w\n0,,700\n")
    inputs = ("drive", "wrong.csv", "speed.csv")
    ended = evpinn("replay", *inputs, "--metrics", "kept_metrics.json", cwd=folder)
    assert ended.returncode == 1 and "Traceback" not in ended.stderr
    (line,) = [line for line in ended.stderr.splitlines() if "not replayed: " in line]
    assert "wrong.csv" in line and "all 2" in ended.stdout
    kept = json.loads((folder / "kept_metrics.json").read_text())
    assert [drive["input"]["path"] for drive in kept] == ["drive", "speed.csv"]
    both = evpinn("replay", "wrong.csv", "wrong.csv", cwd=folder)
    assert_fails_in_one_line(both, "wrong.csv")


@pytest.mark.parametrize("command", [("info", "drive"), ("vehicles", "search", "e208")])
def test_miles_in_place_of_kilometres(evpinn, folder, command):
    shown = (
        evpinn(*command, cwd=folder).stdout,
        evpinn(*command, "--units", "us", cwd=folder).stdout,
    )
    assert "km" in shown[0] and "km" not in shown[1] and re.search(r"\bmi\b", shown[1])


def test_one_output_that_cannot_be_written_does_not_cost_the_others(evpinn, folder):
    (folder / "a_file").write_text("")
    ended = evpinn(
        *("replay", "speed.csv", "--metrics", "a_file/m.json", "--state", "saved.json"), cwd=folder
    )
    assert ended.returncode == 1
    assert "Traceback" not in ended.stderr
    assert "a_file/m.json" in ended.stderr.strip().splitlines()[-1]
    assert (folder / "saved.json").is_file()


def test_a_state_into_which_another_process_learns_is_refused(evpinn, folder):
    path = folder / "busy.json"
    path.write_text("of the other")
    with StateClaim(path):
        ended = evpinn("replay", "speed.csv", "--state", "busy.json", cwd=folder)
        assert_fails_in_one_line(ended, "busy.json: another evpinn learns into this file")
    assert path.read_text() == "of the other"


def test_the_state_is_written_before_all_that_can_be_made_again(folder):
    """On a disk that was full behind the report, what was learned was lost."""
    pipe, state = folder / "metrics.pipe", folder / "first.json"
    os.mkfifo(pipe)
    command = [sys.executable, "-m", "evpinn_ros", "replay", "drive", "--metrics", pipe.name]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [*command, "--state", state.name], cwd=folder, env=environment, stdout=subprocess.DEVNULL
    ) as process:
        with pipe.open() as metrics:  # opens once the command writes there
            learned = state.is_file()
            assert json.load(metrics)["mode"] == "hybrid"
        assert process.wait(timeout=120) == 0
    assert learned


def test_check_params_knows_the_three_kinds(evpinn, tmp_path):
    for path, kind in (
        (ROOT / "config" / "evpinn.param.yaml", "parameter file"),
        (ROOT / "config" / "vehicles" / "generic.yaml", "vehicle file"),
        (ROOT / "config" / "can" / "nissan_leaf.yaml", "CAN profile"),
        (ROOT / "config" / "can" / "bmw_i3.yaml", "CAN profile"),
    ):
        ended = evpinn("check-params", path, cwd=tmp_path)
        assert (ended.returncode, kind in ended.stdout) == (0, True), ended.stderr
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("/**/estimator:\n  ros__parameters:\n    smoothing_lag: .nan\n")
    assert_fails_in_one_line(evpinn("check-params", wrong, cwd=tmp_path), "wrong.yaml:3", "lag")


def test_parameter_file_reaches_the_cores(evpinn, folder):
    (folder / "paper.yaml").write_text("/**/estimator:\n  ros__parameters:\n    mode: paper\n")
    ended = evpinn(
        "replay", "speed.csv", "--params", "paper.yaml", "--metrics", "p.json", cwd=folder
    )
    assert ended.returncode == 0, ended.stderr
    assert json.loads((folder / "p.json").read_text())["mode"] == "paper"


def test_vehicles_are_listed_found_and_shown(evpinn, folder):
    ended = evpinn("vehicles", "search", "model", "3", "--json", "-", cwd=folder)
    by_name = {line["vehicle"]: line for line in json.loads(ended.stdout)}
    assert by_name["tesla_model_3_lr"]["from"] == "file"
    assert by_name["tesla_model_3_rwd_2022"]["from"] == "certified"
    assert by_name["tesla_model_3_rwd_2022"]["mass_kg"] == 1928
    rated = by_name["tesla_model_3_rwd_2024"]
    assert rated["battery_kwh"] == pytest.approx(57.0)
    # 554 km of range by the WLTP, and 10 % +- 10 % more than rated.
    assert rated["kwh_per_100_km"] == pytest.approx(1.1 * 57.0 / 5.54, rel=0.1)
    listed = evpinn("vehicles", cwd=folder)
    assert listed.returncode == 0 and len(listed.stdout.splitlines()) > 80
    shown = evpinn("vehicles", "show", "ioniq 5 rwd", cwd=folder)
    (folder / "mine.yaml").write_text(shown.stdout)
    checked = evpinn("check-params", "mine.yaml", cwd=folder)
    assert checked.stdout == "mine.yaml: a valid vehicle file\n"
    assert_fails_in_one_line(evpinn("vehicles", "search", "zeppelin", cwd=folder), "zeppelin")
    assert_fails_in_one_line(evpinn("vehicles", "show", "model 3", cwd=folder), "model_3_rwd_2022")


def test_several_inputs_give_drives_and_a_folder_though_they_are_one_drive(evpinn, tmp_path):
    row = "{},10,350,20\n"
    for name, begin in (("a", 0), ("b", 103)):
        lines = [row.format(1_700_000_000 + begin + second) for second in range(100)]
        (tmp_path / f"{name}.csv").write_text(
            "time,speed_mps,voltage_v,current_a\n" + "".join(lines)
        )
    ended = evpinn("replay", "a.csv", "b.csv", "--metrics", "m.json", "--out", "o", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert len(json.loads((tmp_path / "m.json").read_text())) == 1
    assert [path.name for path in (tmp_path / "o").iterdir()] == ["001_a"]


def test_files_of_one_app_are_explained_once_and_their_pace_is_that_between_pauses(
    evpinn, tmp_path
):
    """Reasons hold figures of each file, here the medians of its temperature.

    The third is of another app: its voltages are in mV.
    """
    apps = (("a", 75, " (V)", 1), ("b", 80, " (V)", 1), ("c", 75, "", 1000))
    for name, celsius, unit, factor in apps:
        (tmp_path / f"{name}.csv").write_text(
            f"time (s),Speed (km/h),Voltage{unit},Current (A),Ambient\n"
            + "".join(
                f"{5 * i + 2000 * (i > 60)},{i % 90},"
                f"{(360 - i % 7) * factor},{i % 50 - 9},{celsius}\n"
                for i in range(120)
            )
        )
    names = ("a.csv", "b.csv", "c.csv")
    said = evpinn("replay", *names, "--vehicle", "bmw_i3", "--whole", cwd=tmp_path).stderr
    assert (said.count("too hot for °C"), said.count("1 file like it")) == (2, 1)
    assert (
        "speed: 120 readings, one every 5.0 s, longest gap 2005.00 s"
        in evpinn("info", "a.csv", cwd=tmp_path).stdout
    )
