"""The picture of docs/project/benchmarks.md: errors by car and method, from the table beside it.

Run: python docs/benchmarks_picture.py (`make docs` does)
"""

from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from evpinn_ros.report.figure import save_figure

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "project" / "benchmarks.md"
HEADING = "## In two minutes"
OURS, HOLDS = "this package", "90 %"
MARKS = {
    OURS: ("o", "tab:blue", 90),
    "vehicle file alone": ("s", "tab:orange", 45),
    "energy per km so far": ("^", "tab:gray", 45),
    "least squares, 13 terms": ("D", "tab:green", 35),
}
RIGHT = (85, 95)  # % of intervals that hold: as many as they promise


def rows(page: str) -> list[dict[str, str]]:
    """Rows of the first table below the heading, each cell by the title of its column."""
    lines = page.partition(HEADING)[2].splitlines()
    begin = next(i for i, line in enumerate(lines) if line.startswith("|"))
    table = [line for line in lines[begin:] if line.startswith("|") or not line.strip()]
    cells = [
        [cell.strip().strip("*") for cell in line.strip("|").split("|")]
        for line in table[: table.index("")]
    ]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def main() -> None:
    """Draw a line of marks for each car."""
    found = rows(PAGE.read_text(encoding="utf-8"))
    figure = Figure(figsize=(9.0, 1.2 + 0.55 * len(found)), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(found))[::-1]
    for name, (marker, color, size) in MARKS.items():
        errors = [float(row[name]) for row in found]
        axes.scatter(errors, place, s=size, c=color, marker=marker, label=name, zorder=3)
    for where, row in zip(place, found, strict=True):
        right = RIGHT[0] <= float(row[HOLDS]) <= RIGHT[1]
        color = "tab:green" if right else "tab:red"
        text = f"{row[HOLDS]} %"
        axes.annotate(
            text, (1.02, where), xycoords=("axes fraction", "data"), color=color, va="center"
        )
    axes.annotate("90 % intervals\nthat hold", (1.02, 1.02), xycoords="axes fraction")
    axes.set_yticks(place, [f"{row['car, log']}\n{row['drives']} drives" for row in found])
    axes.set_ylim(-0.6, len(found) - 0.4)
    axes.set_xscale("log")
    ticks = (3, 5, 10, 20, 50)
    axes.set_xticks(ticks, [f"{tick} %" for tick in ticks])
    axes.minorticks_off()
    axes.grid(axis="x", alpha=0.3)
    axes.set_xlabel("median error of the energy of a drive, battery hidden")
    figure.legend(loc="outside upper left", ncols=len(MARKS), frameon=False)
    save_figure(figure, ROOT / "docs" / "benchmarks.png")


if __name__ == "__main__":
    main()
