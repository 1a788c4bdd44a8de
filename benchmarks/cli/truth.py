"""`evpinn bench truth`: compares published parameters with those of simulated cars."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Annotated, Any

import typer

from benchmarks.cli.output import AltitudeOption, GradeOption, json_as_it_comes, table_of
from benchmarks.truth import (
    VEHICLES,
    TruthCheck,
    compare,
    summaries,
)
from evpinn_ros.cli.console import progress_bar, say, show
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.core.estimation.parameter_set import UNOBSERVABLE_ABOVE
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import RMS_GRADE

FIRST_SEED = 7000

COLUMNS = (
    ("quantity", "{0.name}"),
    ("s", "{0.seconds}"),
    ("drives", "{0.drives}"),
    ("bias %", "{0.bias_percent:+.2f}"),
    ("median %", "{0.median_percent:.2f}"),
    ("90 % within %", "{0.p90_percent:.2f}"),
    ("sigma %", "{0.std_percent:.2f}"),
    ("95 % covers %", "{0.coverage_percent:.0f}"),
    ("prior share", "{0.prior_share:.2f}"),
)


def truth(
    drives: Annotated[
        int, typer.Option("--drives", "--cars", min=1, help="Drives, each of another car.")
    ] = 24,
    kind: Annotated[DriveKind, typer.Option(help="Kind of road.")] = DriveKind.URBAN,
    from_priors: Annotated[
        bool, typer.Option("--from-priors", help="Draw cars from the priors, to test intervals.")
    ] = False,
    rms_grade: GradeOption = RMS_GRADE,
    altitude: AltitudeOption = False,
    json_file: JsonOption = None,
) -> None:
    """Compare published parameters with the truth of simulated cars.

    Example: evpinn bench truth --drives 50 --from-priors
    """
    seeds = range(FIRST_SEED, FIRST_SEED + drives)
    figures: dict[str, Any] = {}
    road: dict[str, Any] = {"rms_grade": rms_grade, "altitude": altitude}
    with json_as_it_comes(json_file, lambda: figures):
        _compare(figures, compare(kind, VEHICLES, seeds, from_priors=from_priors, **road), drives)


def _compare(figures: dict[str, Any], compared: Iterable[TruthCheck], drives: int) -> None:
    checks: list[TruthCheck] = []
    try:
        with progress_bar("drives", drives, unit="drives") as progress:
            for check in compared:
                checks.append(check)
                progress(check.seed - FIRST_SEED)
    finally:  # Ctrl-C leaves the drives so far
        if checks:
            rows = summaries(checks)
            figures["summaries"] = [asdict(row) for row in rows]
            show(table_of("", rows, COLUMNS))
            figures["unobservable"] = _unobservable(checks)
            say(figures["unobservable"])


def _unobservable(checks: Sequence[TruthCheck]) -> str:
    """Sentence on the number of drives whose C_d was flagged as unobservable at the end."""
    end = max(check.seconds for check in checks)
    shares = [
        check.prior_share for check in checks if check.name == "c_d" and check.seconds == end
    ]
    flagged = sum(share > UNOBSERVABLE_ABOVE for share in shares)
    return f"C_d flagged as unobservable: {flagged} of {len(shares)} drives"
