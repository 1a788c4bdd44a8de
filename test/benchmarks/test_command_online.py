"""`evpinn bench online` as a person meets it."""

from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
import json
from pathlib import Path
import re
from typing import NamedTuple
from unittest.mock import patch

import pytest

from evpinn_ros.cli.main import main

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parents[2]
SCORE = {"samples", "rmse_w", "mae_w", "coverage_90"}
KEYS = SCORE | {
    *("energy_error_percent", "worst_5min_percent", "measured_j", "predicted_j"),
    *("now", "us_per_sample"),
}
URBAN = ROOT / "bags" / "urban"
NAMES = ["null", "prior", "ekf5_fast"]


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def bench(*arguments) -> Done:
    """`evpinn bench` in this process: a new one takes seconds to load torch."""
    out, err = StringIO(), StringIO()
    with (
        patch("sys.argv", ["evpinn", "bench", *map(str, arguments)]),
        redirect_stdout(out),
        redirect_stderr(err),
        pytest.raises(SystemExit) as end,
    ):
        main()
    return Done(int(end.value.code or 0), out.getvalue(), err.getvalue())


def test_help_lists_the_benchmarks():
    done = bench("--help")
    assert done.returncode == 0
    assert "online" in done.stdout
    done = bench("online", "--help")
    assert "Example: evpinn bench online" in done.stdout


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, Done]:
    """A run over the bundled drive, three logs that are none, and one that is too short."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "silent.csv").write_text(
        "t_s,speed_mps,power_w\n" + "".join(f"{0.1 * i:.1f},{0.05 * i:.2f},\n" for i in range(100))
    )
    (folder / "short.csv").write_text(
        "t_s,speed_mps,power_w\n" + "".join(f"{0.1 * i:.1f},1,500\n" for i in range(50))
    )
    (folder / "broken.mcap").write_bytes(b"no bag")
    logs = [folder / name for name in ("silent.csv", "broken.mcap", "nowhere", "short.csv")]
    logs = [*logs, f"{URBAN}=tesla_model_3_lr"]
    done = bench(
        "online", *logs, "--methods", ",".join(NAMES), "--json", folder / "out" / "found.json"
    )
    return folder, done


def test_json_keeps_its_keys(finished):
    folder, _ = finished
    found = json.loads((folder / "out" / "found.json").read_text())
    assert set(found) == {"warm_up_s", "logs", "failed", "total"}
    (log,) = found["logs"]
    keys = {"path", "vehicle", "duration_s", "stream_us_per_sample", "methods"}
    assert set(log) == keys
    assert log["vehicle"] == "tesla_model_3_lr"
    assert list(log["methods"]) == list(found["total"]) == NAMES
    for score in (*log["methods"].values(), *found["total"].values()):
        assert set(score) == KEYS
        assert set(score["now"]) == SCORE
    rmse = {name: score["rmse_w"] for name, score in log["methods"].items()}
    assert rmse["null"] < rmse["ekf5_fast"] < rmse["prior"]


def test_bad_logs_are_named_and_stop_nothing(finished):
    folder, done = finished
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    progress = re.compile(r"s left$")  # of a run that takes longer than 10 s
    lines = [line for line in done.stderr.strip().splitlines() if not progress.search(line)]
    reasons = {"silent.csv": "no battery", "broken.mcap": "", "nowhere": "no such file"}
    reasons["short.csv"] = "--warm-up"
    assert len(lines) == len(reasons)
    for name, reason in reasons.items():
        assert any(name in line and reason in line for line in lines), name
    failed = json.loads((folder / "out" / "found.json").read_text())["failed"]
    assert [Path(each["path"]).name for each in failed] == list(reasons)


def test_the_table_fits_a_narrow_terminal(finished):
    _, done = finished
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [row[0] for row in rows if row and row[0] in NAMES] == NAMES
    assert "…" not in done.stdout


def test_markdown_rows_are_whole_lines():
    done = bench(
        *("online", URBAN, "--vehicle", "tesla_model_3_lr", "--methods", "null,split"),
        "--markdown",
    )
    assert done.returncode == 0, done.stderr
    rows = [line for line in done.stdout.splitlines() if line.startswith("|")]
    assert len(rows) == 4  # header, rule, two methods
    assert {row.count("|") for row in rows} == {11}


def test_an_unknown_method_is_said_before_anything_runs():
    done = bench("online", URBAN, "--methods", "null,magic")
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert "magic" in line and "hybrid" in line
    assert done.stdout == ""
