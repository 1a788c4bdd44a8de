"""What works without any extra, and what a command says whose extra is missing."""

import json
from pathlib import Path
import subprocess
import sys

import pytest

from evpinn_ros.common.optional import EXTRA_OF, optional_imports
from evpinn_ros.common.package_data import share_directory

BAG = str(share_directory() / "bags" / "urban")
OF_TESLA = "--vehicle", "tesla_model_3_lr"
SHORT = "--duration", "20", *OF_TESLA
ABSENT = sorted(EXTRA_OF.keys() - {"rclpy"})
# Runs command after command, and writes the exit code of each and what it said to stderr.
COMMANDS = f"""
from contextlib import redirect_stderr
import io, json, sys
sys.modules.update(dict.fromkeys({ABSENT}))
from evpinn_ros.cli.main import main
results = []
for command in json.loads(sys.argv[1]):
    sys.argv = ["evpinn", *command]
    with redirect_stderr(io.StringIO()) as said:
        try:
            main()
        except SystemExit as end:
            results.append((end.code or 0, said.getvalue()))
open("results.json", "w").write(json.dumps(results))
"""


def run_without_extras(folder: Path, *commands: tuple[str, ...]) -> list[tuple[int, str]]:
    """Exit code and stderr of each command, in a Python that lacks all optional packages."""
    (folder / "drive.csv").write_text("t_s,speed_mps,power_w\n0,0,500\n1,1,900\n2,2,1500\n")
    words = [sys.executable, "-c", COMMANDS, json.dumps(commands)]
    ended = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return [(code, said) for code, said in json.loads((folder / "results.json").read_text())]


@pytest.mark.slow
def test_bags_are_read_replayed_and_converted_without_any_extra(tmp_path):
    results = run_without_extras(
        tmp_path,
        ("info", BAG),
        ("replay", BAG, *SHORT, "--out", "replayed", "--metrics", "metrics.json"),
        ("compare", BAG, BAG, "--duration", "60", *OF_TESLA),
        ("convert", BAG, "converted"),
        ("simulate", "simulated", "--duration", "20", *OF_TESLA),
        ("vehicles",),
        ("check-params", str(share_directory() / "config" / "vehicles" / "generic.yaml")),
        *((name, "--help") for name in ("forecast", "run", "demo", "fleet", "reproduce", "view")),
    )
    assert {code for code, _ in results} == {0}, results
    assert json.loads((tmp_path / "metrics.json").read_text())["energy"]["predicted_j"] > 0
    assert (tmp_path / "replayed").is_dir() and (tmp_path / "converted").is_dir()


@pytest.mark.slow
def test_a_command_whose_extra_is_missing_says_at_once_how_to_install_it(tmp_path):
    extras = {
        ("info", "drive.csv"): "tables",
        ("replay", "drive.csv"): "tables",
        ("convert", "drive.csv", "out"): "tables",
        ("forecast", "drive.csv", *OF_TESLA): "tables",
        ("forecast", "drive.csv", "--report", "report.html"): "report",
        ("replay", BAG, "--report", "report.html"): "report",
        ("compare", BAG, BAG, "--report", "report.html"): "report",
        ("run", *OF_TESLA, "--report", "report.html"): "report",
        ("reproduce", BAG, *OF_TESLA, "--out", "out"): "report",
        ("fleet", BAG, "--out", "out"): "report",
        ("mqtt", *OF_TESLA): "mqtt",
        ("vss", *OF_TESLA): "vss",
    }
    results = run_without_extras(tmp_path, *extras)
    for (command, extra), (code, said) in zip(extras.items(), results, strict=True):
        assert code == 1 and said.count("\n") == 1, (command, said)
        assert said.endswith(f" is not installed: pip install 'evpinn_ros[{extra}]'\n"), said
    assert {path.name for path in tmp_path.iterdir()} == {"drive.csv", "results.json"}


def test_from_python_too_a_missing_extra_is_named(tmp_path):
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({ABSENT}))\n"
        "import evpinn_ros as ev; ev.Estimator().parameters"
    )
    words = [sys.executable, "-c", code]
    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.stderr.endswith("pandas is not installed: pip install 'evpinn_ros[tables]'\n")


def test_a_missing_package_of_no_extra_is_no_wrong_input():
    with pytest.raises(ModuleNotFoundError), optional_imports():
        import no_such_package  # noqa: F401
