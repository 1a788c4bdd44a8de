"""`evpinn bench truth`: how true the published parameters are, on simulated cars."""

from __future__ import annotations

from typing import Annotated

from rich.table import Table
import typer

from evpinn_ros.bench.truth import (
    VEHICLES,
    Summary,
    compare,
    false_alarms,
    load_steps,
    summaries,
)
from evpinn_ros.cli.console import results
from evpinn_ros.simulation.drive import DriveKind

FIRST_SEED = 7000
IN_TIME, NEAR = 90.0, 25.0  # s of motion and kg within which a change of load is to be told


def truth(
    drives: Annotated[int, typer.Option(min=1, help="Simulated drives.")] = 24,
    kind: Annotated[DriveKind, typer.Option(help="Where to drive.")] = DriveKind.URBAN,
    from_priors: Annotated[
        bool, typer.Option(help="Draw cars from the priors: are the intervals true?")
    ] = False,
    load: Annotated[bool, typer.Option(help="Also change the load at a stop, by 150 kg.")] = False,
    hours: Annotated[
        int, typer.Option(min=0, help="Hours without a change of load, to count false alarms.")
    ] = 0,
) -> None:
    """Hold the published parameters against the truth of simulated cars.

    Example: evpinn bench truth --drives 50 --from-priors
    """
    seeds = range(FIRST_SEED, FIRST_SEED + drives)
    found = compare(kind, VEHICLES, seeds, from_priors=from_priors)
    results.print(_table(summaries(found)))
    if load:
        steps = list(load_steps(VEHICLES, seeds))
        in_time = sum(step.detected_after <= IN_TIME for step in steps)
        near = sum(abs(step.error) <= NEAR for step in steps)
        results.print(
            f"Load: {in_time} of {len(steps)} found within {IN_TIME:.0f} s of motion, "
            f"{near} within {NEAR:.0f} kg"
        )
    if hours:
        quiet = list(false_alarms(kind, VEHICLES, range(FIRST_SEED, FIRST_SEED + hours)))
        alarms, withdrawn = sum(one[1] for one in quiet), sum(one[2] for one in quiet)
        results.print(f"False alarms in {hours} h: {alarms}, withdrawn {withdrawn}")


def _table(rows: list[Summary]) -> Table:
    """Errors and coverage of each quantity at each time."""
    table = Table("quantity", "s", "drives", "bias %", "median %", "90 % within %", "sigma %")
    table.add_column("95 % covers %")
    table.add_column("prior share")
    for row in rows:
        table.add_row(
            row.name,
            str(row.seconds),
            str(row.drives),
            f"{row.bias_percent:+.2f}",
            f"{row.median_percent:.2f}",
            f"{row.p90_percent:.2f}",
            f"{row.std_percent:.2f}",
            f"{row.coverage_percent:.0f}",
            f"{row.prior_share:.2f}",
        )
    return table
