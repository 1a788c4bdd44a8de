"""The table and the picture of docs/project/benchmarks.md: errors by car and method.

Run: python docs/benchmarks_picture.py (`make docs` does), which draws the picture and prints the
table. A test compares the table with the page.
"""

import json
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from evpinn_ros.report.figure import save_figure

ROOT = Path(__file__).resolve().parents[1]
SCORES = ROOT / "docs" / "project" / "unseen.json"
OURS, HOLDS = "this package", "90 %"
MARKS = {
    OURS: ("o", "tab:blue", 90),
    "vehicle file alone": ("s", "tab:orange", 45),
    "energy per km so far": ("^", "tab:gray", 45),
    "least squares, 13 terms": ("D", "tab:green", 35),
}
RIGHT = (85, 95)  # % of intervals that hold: as many as they promise


def cars() -> list[dict[str, str | float]]:
    """The scores of each car, by the title of the column."""
    return list(json.loads(SCORES.read_text(encoding="utf-8"))["cars"])


def table() -> str:
    """The scores as the page shows them; the best error of a car is bold."""
    titles = ("car, log", "drives", OURS, HOLDS, *[name for name in MARKS if name != OURS])
    lines = [titles, ("---",) * len(titles)]
    for car in cars():
        best = min(float(car[name]) for name in MARKS)
        lines.append(
            tuple(
                f"**{car[title]}**" if title in MARKS and car[title] == best else f"{car[title]}"
                for title in titles
            )
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Draw a line of marks for each car."""
    scored = cars()
    figure = Figure(figsize=(9.0, 1.2 + 0.55 * len(scored)), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(scored))[::-1]
    for name, (marker, color, size) in MARKS.items():
        errors = [float(row[name]) for row in scored]
        axes.scatter(errors, place, s=size, c=color, marker=marker, label=name, zorder=3)
    for where, row in zip(place, scored, strict=True):
        right = RIGHT[0] <= float(row[HOLDS]) <= RIGHT[1]
        color = "tab:green" if right else "tab:red"
        text = f"{row[HOLDS]} %"
        axes.annotate(
            text, (1.02, where), xycoords=("axes fraction", "data"), color=color, va="center"
        )
    axes.annotate("90 % intervals\nthat hold", (1.02, 1.02), xycoords="axes fraction")
    axes.set_yticks(place, [f"{row['car, log']}\n{row['drives']} drives" for row in scored])
    axes.set_ylim(-0.6, len(scored) - 0.4)
    axes.set_xscale("log")
    ticks = (3, 5, 10, 20, 50)
    axes.set_xticks(ticks, [f"{tick} %" for tick in ticks])
    axes.minorticks_off()
    axes.grid(axis="x", alpha=0.3)
    axes.set_xlabel("median error of the energy of a drive, battery hidden")
    figure.legend(loc="outside upper left", ncols=len(MARKS), frameon=False)
    save_figure(figure, ROOT / "docs" / "benchmarks.png")
    print(table())


if __name__ == "__main__":
    main()
