"""`evpinn bench online`: the learner and its peers on the same samples of recorded drives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
import time
from typing import Annotated, Any

from rich.box import MARKDOWN, SIMPLE_HEAD
import typer

from benchmarks.cli.output import names_in
from benchmarks.logs import Log, find_logs
from benchmarks.online import METHODS, OnlineBenchmark, Run
from benchmarks.scores import Score, log_scores, total_scores
from evpinn_ros.cli.console import note, progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption, complete_vehicle
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.drives.sources import open_source
from evpinn_ros.replays.run import PROGRESS_STEP, WARM_UP, has_battery
from evpinn_ros.vehicle.files import load_vehicle

HEADERS = (
    *("RMSE\nW", "MAE\nW", "energy\n%", "worst\n5 min %", "in band\n%"),
    *("now:\nRMSE W", "MAE\nW", "in band\n%", "us"),
)
MARKDOWN_WIDTH = 200


def online(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH[=VEHICLE[,PROFILE]]...",
            help="CSV drives, bags, CAN logs, or folders searched for them; whose car they are, "
            "and their CAN profile if it is not the vehicle's own.",
        ),
    ],
    vehicle: Annotated[
        str,
        typer.Option(
            help="Vehicle of the paths that name none, or the path of its file.",
            autocompletion=complete_vehicle,
        ),
    ] = "generic",
    methods: Annotated[
        str,
        typer.Option(
            help=f"Methods, by comma: {', '.join(METHODS)}. Default: all.", show_default=False
        ),
    ] = ",".join(METHODS),
    warm_up: Annotated[float, typer.Option(min=0.0, help="Not scored at the start, s.")] = WARM_UP,
    json_file: JsonOption = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Tables as Markdown.")] = False,
) -> None:
    """Hold the learner against its peers: predict, score, then learn.

    Every log starts from the priors of its vehicle. Energy is the error over the whole log, and
    the worst over any five minutes, in percent of all that went in and out; `now` the prediction
    of the newest moment; `us` the processor's microseconds per sample, for paper and hybrid with
    all that a node does. What cannot be scored is named and left out, and the exit code is 1.

    Example: evpinn bench online bags/urban --methods null,ekf5,hybrid
    """
    limit_blas_threads()
    names = _chosen(methods)
    found: dict[str, list[dict[str, Any]]] = {"logs": [], "failed": []}
    try:
        for log in _logs(paths, vehicle, found["failed"]):
            try:
                run, problem = _run(log, names)
                _refuse_empty(log, run, warm_up)
            except InputError as error:
                _fail(found["failed"], str(log.path), str(error))
                continue
            if problem is not None:
                _fail(found["failed"], str(log.path), problem)
            scores = log_scores(run, names, warm_up)
            found["logs"].append(_entry(log, run, scores))
            _show(f"{log.path}: {run.drive.duration:.0f} s, {log.vehicle}", scores, markdown)
    finally:  # Ctrl-C leaves the logs so far
        _report(found, warm_up, markdown, json_file)
    if found["failed"]:
        raise typer.Exit(1)


def _report(
    found: dict[str, list[dict[str, Any]]], warm_up: float, markdown: bool, json_file: Path | None
) -> None:
    total = total_scores([log["methods"] for log in found["logs"]])
    if len(found["logs"]) > 1:
        title = f"All {len(found['logs'])} logs by samples; errors of energy without their sign"
        _show(title, total, markdown)
    if json_file is not None:
        write_json(json_file, {"warm_up_s": warm_up, **found, "total": total})


def _chosen(methods: str) -> list[str]:
    names = names_in(methods)
    unknown = [name for name in names if name not in METHODS]
    if unknown or not names:
        raise InputError(f"no method '{', '.join(unknown)}'; known are {', '.join(METHODS)}")
    return names


def _logs(paths: Sequence[str], vehicle: str, failed: list[dict[str, Any]]) -> Iterator[Log]:
    for path in paths:
        try:
            yield from find_logs(path, vehicle)
        except InputError as error:
            _fail(failed, path, str(error))


def _run(log: Log, names: Sequence[str]) -> tuple[Run, str | None]:
    """Run a log through the methods; with what of it could not be read, if anything."""
    car = load_vehicle(log.vehicle)
    source = open_source(log.path, car, log.can_profile)
    # Time of the processor: what else the machine does is not a method's.
    benchmark = OnlineBenchmark(car, names, time.thread_time)
    reported = 0.0
    with progress_bar(log.path.name, total=source.seconds) as progress:
        for reading in source.readings():
            done = benchmark.add_reading(reading)
            if done - reported >= PROGRESS_STEP:
                progress(done)
                reported = done
    return benchmark.finish(), source.problem


def _refuse_empty(log: Log, run: Run, warm_up: float) -> None:
    """Raise InputError when there is nothing to score."""
    if run.moments == 0:
        raise InputError(f"{log.path}: holds no vehicle/speed, nothing can be predicted")
    if not has_battery(run.drive):
        raise InputError(f"{log.path}: no battery voltage and current, nothing can be scored")
    if run.drive.duration <= warm_up:
        raise InputError(
            f"{log.path}: {run.drive.duration:.0f} s long, shorter than the --warm-up"
        )


def _fail(failed: list[dict[str, Any]], path: str, reason: str) -> None:
    note(f"evpinn: {reason}")
    failed.append({"path": path, "reason": reason})


def _entry(log: Log, run: Run, scores: Mapping[str, Score]) -> dict[str, Any]:
    return {
        "path": str(log.path),
        "vehicle": log.vehicle,
        "duration_s": run.drive.duration,
        "stream_us_per_sample": 1e6 * run.stream_s / run.moments,
        "methods": scores,
    }


def _show(title: str, scores: Mapping[str, Score], markdown: bool) -> None:
    """The scores of one log, or of all, a row for each method."""
    headers = [each.replace("\n", " ") if markdown else each for each in HEADERS]
    table = PlainTable(
        title,
        ("method", *headers),
        [(name, *_row(score)) for name, score in scores.items()],
        unbroken=("method",),
        box=MARKDOWN if markdown else SIMPLE_HEAD,
    )
    # Markdown is for a file: no line of it is folded, however narrow the terminal.
    show(table, at_least=MARKDOWN_WIDTH if markdown else 0)


def _row(score: Score) -> list[str]:
    now = score["now"]
    return [
        _number(score["rmse_w"]),
        _number(score["mae_w"]),
        _number(score["energy_error_percent"], "+.2f"),
        _number(score["worst_5min_percent"], ".1f"),
        _number(score["coverage_90"], ".1%"),
        _number(now["rmse_w"]),
        _number(now["mae_w"]),
        _number(now["coverage_90"], ".1%"),
        _number(score["us_per_sample"]),
    ]


def _number(value: float | None, form: str = ".0f") -> str:
    return "-" if value is None else format(value, form).rstrip("%")
