"""The report of an experiment: every table and figure in one HTML file."""

from __future__ import annotations

from pathlib import Path

from evpinn_ros.report.html import write_page
from evpinn_ros.report.reproduction_figures import reproduction_pictures
from evpinn_ros.reproduction.experiment import Outcome
from evpinn_ros.reproduction.tables import all_tables
from evpinn_ros.reproduction.verdict import CRITERIA, verdict

SHORT = 11  # characters of a cell that stays in one line: `random 20 %`


def write_reproduction(path: Path, outcome: Outcome, command: str, label: str) -> None:
    """Write the report; label says what was run, as in the terminal."""
    write_page(
        path,
        "reproduction.html.j2",
        title=f"EV-PINN on {outcome.vehicle.name}",
        command=command,
        label=label,
        findings=verdict(outcome),
        criteria=CRITERIA,
        tables=[table._replace(rows=_whole(table.rows)) for table in all_tables(outcome)],
        pictures=reproduction_pictures(outcome),
    )


def _whole(rows: list[list[str]]) -> list[list[str]]:
    """Cells whose short texts do not break, however narrow the page."""
    return [
        [x.replace(" ", "\N{NO-BREAK SPACE}") if len(x) <= SHORT else x for x in row]
        for row in rows
    ]
