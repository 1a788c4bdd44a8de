"""The report of an experiment: every table and figure in one HTML file."""

from __future__ import annotations

from html import escape
from pathlib import Path

from evpinn_ros.report.html import embedded, table, write_page
from evpinn_ros.report.reproduction_figures import reproduction_figures
from evpinn_ros.reproduction.experiment import Outcome
from evpinn_ros.reproduction.tables import ResultTable, all_tables


def write_reproduction(path: Path, outcome: Outcome, command: str, label: str) -> None:
    """Write the report; label says what was run, as in the terminal."""
    figures = [
        f"<h2>{escape(title)}</h2>\n{embedded(figure, title)}"
        for title, figure in reproduction_figures(outcome).items()
    ]
    tables = [_table(found) for found in all_tables(outcome)]
    title = f"EV-PINN on {outcome.vehicle.name}"
    write_page(path, title, command, [f"<p>{escape(label)}</p>", *tables, *figures])


def _table(found: ResultTable) -> str:
    return (
        f"<h2>{escape(found.title)}</h2>\n{table(found.columns, found.rows)}"
        f"<p>{escape(found.note)}</p>"
    )
