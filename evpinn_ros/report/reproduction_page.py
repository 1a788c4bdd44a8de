"""The report of an experiment: every table and figure in one HTML file."""

from __future__ import annotations

from html import escape
from pathlib import Path

from evpinn_ros.report.html import embedded, write_page
from evpinn_ros.report.reproduction_figures import reproduction_figures
from evpinn_ros.reproduction.experiment import Outcome
from evpinn_ros.reproduction.tables import Table, all_tables


def write_reproduction(path: Path, outcome: Outcome, command: str, label: str) -> None:
    """Write the report; label says what was run, as in the terminal."""
    figures = [
        f"<h2>{escape(title)}</h2>\n{embedded(figure, title)}"
        for title, figure in reproduction_figures(outcome).items()
    ]
    tables = [_table(table) for table in all_tables(outcome)]
    title = f"EV-PINN on {outcome.vehicle.name}"
    write_page(path, title, command, [f"<p>{escape(label)}</p>", *tables, *figures])


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in table.columns)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in table.rows
    )
    return (
        f"<h2>{escape(table.title)}</h2>\n<div style='overflow-x: auto'><table>"
        f"<tr>{head}</tr>{rows}</table></div>\n<p>{escape(table.note)}</p>"
    )
